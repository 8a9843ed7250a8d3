"""The page's server over the loopback: who is let in, what is answered, and to how many."""

from __future__ import annotations

import errno
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote

import filelock
import pytest
from opened import TOKEN, Client, running

from bayestissue.base.errors import InputError
from bayestissue.commands import live
from bayestissue.studies.bench import server
from bayestissue.studies.bench.server import HOST
from bayestissue.studies.bench.views import DatasetView, Decisions, DropsView, one_line


class Pretended(DropsView):
    """A view of nothing that remembers what it was asked."""

    def __init__(self) -> None:
        self.version, self.acted = 3, list[tuple[str, dict[str, Any]]]()

    def state(self, since: int) -> dict[str, Any]:
        return {"version": self.version, "since": since}

    def drop(self, impact: str) -> dict[str, Any]:
        if impact != "a/b ü":
            raise KeyError(impact)
        return {"impact": impact}

    def act(self, action: str, content: dict[str, Any]) -> None:
        if action == "choose":
            raise InputError.stated("none-left", "page")
        self.acted.append((action, {"reason": content["reason"]}))
        self.version += 1


@pytest.fixture
def view() -> Pretended:
    return Pretended()


@pytest.fixture
def client(view: Pretended) -> Iterator[Client]:
    yield from running(view)


def test_the_first_address_has_the_token_and_the_cookie_then_does(client: Client) -> None:
    page = client.ask(f"/?token={TOKEN}", Cookie=None)
    assert page.status == 200
    cookie = page.headers["set-cookie"]
    assert cookie == f"{client.cookie}; Path=/; HttpOnly; SameSite=Strict"
    assert page.headers["content-security-policy"].startswith("default-src 'self'")
    named = re.findall(r'(?:src|href)="([^"]+)"', page.read().decode())
    assert sorted(named) == ["data:,", "page.css", "page.js"]
    for name in named[1:]:
        asset = client.ask(f"/{name}")
        assert asset.status == 200
        # Nothing from anywhere else, and nothing that is made of text.
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)|innerHTML|eval\(", asset.read().decode())
    assert json.loads(client.ask("/state?since=2").read()) == {"version": 3, "since": 2}
    assert json.loads(client.ask(f"/drop?impact={quote('a/b ü')}").read()) == {"impact": "a/b ü"}


@pytest.mark.parametrize("path", ["/state", "/", "/page.js", "/events", "/drop?impact=a"])
def test_others_are_refused(client: Client, path: str) -> None:
    for headers in (
        {"Cookie": None},
        {"Cookie": f"bayestissue-1={TOKEN}"},
        {"Cookie": f"bayestissue-{client.port}=another"},
        {"Host": "evil.example"},
        {"Host": "127.0.0.1:1"},
        {"Host": None},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
    ):
        answer = client.ask(path, **headers)
        assert answer.status in (400, 403)
        assert b"version" not in answer.read()


def test_a_decision_comes_from_this_page_alone(client: Client, view: Pretended) -> None:
    body = json.dumps({"reason": "x"})
    for headers in ({"Origin": None}, {"Origin": "http://evil.example"}, {"Cookie": None}, {"Host": "evil"}):
        assert client.post("decide", body, **headers).status == 403
    assert client.ask("/act/decide?token=" + TOKEN, "POST", body, Cookie=None).status == 403
    assert view.acted == []
    assert client.post("decide", body).status == 204
    assert view.acted == [("decide", {"reason": "x"})]
    for wrong, status in (("not JSON", 400), ("[]", 400), ("{}", 400), (f'"{"x" * 20_000}"', 413)):
        assert client.post("decide", wrong).status == status
    refused = client.post("choose", body)
    assert (refused.status, b"expected" in refused.read()) == (422, True)
    assert client.ask("/act/decide", "DELETE", Origin=f"http://{HOST}:{client.port}").status == 405


@pytest.mark.parametrize(
    "path",
    ["/../dataset.toml", "/page/../../server.py", "/%2e%2e/%2e%2e/etc/passwd", "/watch.json", "//etc/passwd"],
)
def test_there_is_no_file_but_the_page(client: Client, path: str) -> None:
    assert client.ask(path).status == 404


def test_two_pages_hear_the_bell_at_once(client: Client, view: Pretended) -> None:
    bells = [client.ask("/events") for _ in range(2)]
    assert [bell.readline() for bell in bells] == [b"data: 3\n"] * 2
    client.post("decide", json.dumps({"reason": "x"}))
    for bell in bells:
        assert bell.readline() == b"\n"
        assert bell.readline() == b"data: 4\n"
        bell.close()


def test_a_page_of_a_thousand_changes_holds_no_more_than_one_of_a_few(client, view) -> None:
    before = threading.active_count()
    bell = client.ask("/events")
    for _ in range(1000):
        view.version += 1
    time.sleep(0.5)
    bell.close()
    assert threading.active_count() <= before + 1


def test_what_is_typed_becomes_one_line() -> None:
    assert one_line(" a\r\nb\x1b[31m\u202ec ") == "a b [31m c"
    assert len(one_line("x" * 1000)) == 200


def test_what_is_no_request_is_refused_and_the_page_goes_on(capfd, client) -> None:
    assert client.post("decide", "[" * 9_900).status == 400
    assert client.post("decide", f'{{"reason": {"[" * 4_000 + "]" * 4_000}}}').status in (204, 400)
    assert client.ask(f"/state?since={'9' * 5_000}").status == 200
    with socket.create_connection((HOST, client.port)) as leaves:
        headers = (
            f"Host: {HOST}:{client.port}\r\nCookie: {client.cookie}\r\nOrigin: http://{HOST}:{client.port}"
        )
        leaves.sendall(f"POST /act/decide HTTP/1.1\r\n{headers}\r\nContent-Length: 900\r\n\r\n{{".encode())
        time.sleep(0.3)
    time.sleep(0.3)
    assert client.ask("/state").status == 200
    assert capfd.readouterr().err == ""


def test_connections_that_ask_for_nothing_do_not_keep_others_out(client, monkeypatch) -> None:
    with ExitStack() as idle:
        sockets = [idle.enter_context(socket.create_connection((HOST, client.port))) for _ in range(80)]
        # Half a request is none either.
        sockets[-1].sendall(b"GET / HTTP/1.1\r\n")
        time.sleep(0.5)
        assert client.ask("/state").status == 200
        assert client.post("decide", json.dumps({"reason": "x"})).status == 204
    monkeypatch.setattr("bayestissue.studies.bench.server._PATIENCE_S", 0.2)
    with socket.create_connection((HOST, client.port), timeout=20) as silent:
        assert silent.recv(1) == b"", "it is closed after a while"


@pytest.mark.parametrize("why", ["beside", "within", "in use"])
def test_a_dataset_that_cannot_be_written_is_opened_to_look_at(tmp_path, monkeypatch, why) -> None:
    served_views: list[tuple[Path, str]] = []
    monkeypatch.setattr("bayestissue.studies.bench.views.DatasetView", lambda *args: args)
    monkeypatch.setattr("bayestissue.studies.bench.server.serve", lambda view, *_: served_views.append(view))
    (tmp_path / "dataset.toml").write_text("")
    # As who stands in it calls it.
    monkeypatch.chdir(tmp_path)

    def refuse(*_: object, **__: object) -> None:
        if why == "in use":
            (tmp_path.parent / f".{tmp_path.name}.lock").write_text("process 1")
            raise filelock.Timeout("lock")
        raise OSError(errno.EROFS, "Read-only file system")

    if why == "within":
        monkeypatch.setattr(live.os, "access", lambda *_: False)
    else:
        monkeypatch.setattr(filelock.FileLock, "acquire", refuse)
    if why == "in use":
        with pytest.raises(InputError, match="no other command"):
            live.open_(Path(), None, 0)
        return
    live.open_(Path(), None, 0)
    assert [bool(words) for _, words in served_views] == [True]


def test_a_view_of_what_cannot_be_written_refuses_decisions(tmp_path: Path) -> None:
    view = DatasetView.__new__(DatasetView)
    view.why_not, view._decisions = "to look at only", Decisions(tmp_path, ["a", "b"])
    with pytest.raises(InputError, match="can be changed"):
        view.act("decide", {"impact": "a", "reason": "x"})
    assert not list(tmp_path.iterdir())


def test_what_lacks_the_packages_of_a_page_names_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "find_spec", lambda name: None)
    without = " `bayestissue watch --plain` needs none."
    for name, other in (("bayestissue open", ""), ("bayestissue watch", without)):
        with pytest.raises(InputError) as raised:
            server.require_server(name, other)
        assert str(raised.value).startswith(name)
        assert ("--plain" in str(raised.value)) == bool(other)
