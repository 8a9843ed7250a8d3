"""A finished run and the dataset that it is of; and any view on a server of its own."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any

from bayestissue.recordings.dataset import read_dataset
from bayestissue.recordings.dataset.left_out import FILE
from bayestissue.studies.bench.server import HOST, application, configured
from make_fit_run import drops, make_fit_run

TOKEN = "a-token-of-this-test"  # noqa: S105 - of nothing


def run_and_dataset(folder: Path) -> tuple[Path, Path]:
    """A run whose ``run.json`` says that it is of a dataset beside it, of the same impacts."""
    run, dataset = make_fit_run(folder / "run", two_sides=True), folder / "set"
    drops()[0].write(dataset)
    about = json.loads((run / "run.json").read_text())
    about |= {"dataset_folder": "../set", "whole_hash": read_dataset(dataset).whole_hash}
    (run / "run.json").write_text(json.dumps(about))
    return run, dataset


def contents(*folders: Path) -> dict[Path, bytes]:
    """Of all files but the table of what is left out."""
    files = (path for folder in folders for path in folder.rglob("*") if path.name != FILE)
    return {path: path.read_bytes() for path in files if path.is_file()}


@contextmanager
def served(view: Any) -> Iterator[int]:
    """The port of this machine at which a view is served."""
    with socket.socket() as listener:
        listener.bind((HOST, 0))
        listener.listen()
        port = listener.getsockname()[1]
        server = configured(application(view, port, TOKEN))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield port
        finally:
            server.should_exit = True
            thread.join()


def address(port: int, path: str = "", token: str = TOKEN) -> str:
    return f"http://{HOST}:{port}/{path}{'&' if '?' in path else '?'}token={token}"


class Client:
    """A browser's part of a connection."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.cookie = f"bayestissue-{port}={TOKEN}"
        self.opened = ExitStack()

    def ask(
        self, path: str, method: str = "GET", body: str | None = None, **headers: str | None
    ) -> HTTPResponse:
        sent = {"Host": f"{HOST}:{self.port}", "Cookie": self.cookie} | headers
        connection = self.opened.enter_context(closing(HTTPConnection(HOST, self.port, timeout=20)))
        connection.putrequest(method, path, skip_host=True)
        if body is not None:
            connection.putheader("Content-Length", str(len(body.encode())))
        for name, value in sent.items():
            if value is not None:
                connection.putheader(name, value)
        connection.endheaders(body.encode() if body is not None else None)
        return self.opened.enter_context(closing(connection.getresponse()))

    def post(self, action: str, body: str, **headers: str | None) -> HTTPResponse:
        return self.ask(f"/act/{action}", "POST", body, **{"Origin": f"http://{HOST}:{self.port}", **headers})


def running(view: Any) -> Iterator[Client]:
    with served(view) as port, (client := Client(port)).opened:
        yield client
