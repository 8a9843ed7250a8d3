"""A page in headless Chromium, by its own protocol: no driver, no network."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.request import urlopen

from websocket import create_connection

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
OPTIONS = "--headless --no-sandbox --disable-gpu --hide-scrollbars --remote-debugging-port=0"
_SECONDS = 120
# Whether all figures of a page are drawn.
DRAWN = "[...document.querySelectorAll('.chart')].every(chart => chart.querySelector('svg.marks, canvas'))"
# The figures of the first screen that are shown, and how far a word of them, or of the screen, is cut.
SHOWN = "[...document.querySelectorAll('.first .drawing')].filter(place => place.clientWidth)"
BOTTOMS = f"{SHOWN}.map(place => place.querySelector('.marks').getBoundingClientRect().bottom)"
WORDS = "header *, .first :is(h2, p, label, legend, figcaption, summary)"
CUT = """[...document.querySelectorAll('.first svg.marks')].filter(svg => svg.clientWidth).flatMap(svg => {
  const whole = svg.getBoundingClientRect();
  const seen = [...svg.querySelectorAll('text:not([opacity="0"])')];
  return seen.map(text => text.getBoundingClientRect()).flatMap(box =>
    [whole.left - box.left, box.right - whole.right, whole.top - box.top, box.bottom - whole.bottom]);
}).concat([...document.querySelectorAll('WORDS')].filter(one => one.clientWidth).flatMap(one =>
  [one.getBoundingClientRect().right - innerWidth, one.scrollWidth - one.clientWidth - 1]))"""
CUT = CUT.replace("WORDS", WORDS)
_PRESSED = {"button", "link", "radio", "DisclosureTriangle", "combobox", "textbox", "checkbox"}
_CODES = {"Tab": 9, "Enter": 13, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}


class Browser:
    """One tab; with the block it ends."""

    def __enter__(self) -> Browser:
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        own = ["--remote-allow-origins=*", f"--user-data-dir={self._folder.name}", "about:blank"]
        self._process = subprocess.Popen(  # noqa: S603 - the browser of this machine
            [str(CHROMIUM), *OPTIONS.split(), *own], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        port = Path(self._folder.name) / "DevToolsActivePort"
        self._wait(lambda: port.is_file() and port.read_text().count("\n") > 0)
        address = f"http://127.0.0.1:{port.read_text().splitlines()[0]}/json"
        with urlopen(address) as answer:
            tab = next(tab for tab in json.load(answer) if tab["type"] == "page")
        self._socket = create_connection(tab["webSocketDebuggerUrl"], timeout=_SECONDS)
        self._count = 0
        self.errors: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait()
        self._folder.cleanup()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The result of one command of the protocol."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == self._count:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        if event["method"] == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(event["params"]["exceptionDetails"]))
        if event["method"] == "Log.entryAdded" and event["params"]["entry"]["source"] == "security":
            self.errors.append(event["params"]["entry"]["text"])
        if event["method"] == "Network.requestWillBeSent":
            self.requests.append(event["params"]["request"]["url"])

    def open(
        self,
        page: Path | str,
        width: int = 1280,
        *,
        height: int = 900,
        scripts: bool = True,
        hash: str = "",  # noqa: A002
    ) -> None:
        """Open a file, which has no network, or the address of a server."""
        url = page if isinstance(page, str) else page.as_uri() + hash
        # Whatever a file asks for beside itself is refused, and told.
        blocked = [] if isinstance(page, str) else ["http://*", "https://*"]
        self.call("Network.setBlockedURLs", urls=blocked)
        self.errors.clear()
        self.requests.clear()
        self.call("Emulation.setScriptExecutionDisabled", value=not scripts)
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=url)
        self._wait(
            lambda: self.js("location.protocol") != "about:" and self.js("document.readyState") == "complete"
        )

    def js(self, expression: str) -> Any:
        """The value of an expression in the page."""
        result = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until an expression is true."""
        self._wait(lambda: self.js(expression), expression)

    def read(self, page: Path) -> None:
        """Open a page wide and narrow: figures are drawn, none is wider than the screen, nothing fails."""
        for width in (1280, 500):
            self.open(page, width)
            self.until(DRAWN)
            self._require_sound(width)

    def _require_sound(self, width: int) -> None:
        assert self.js("document.documentElement.scrollWidth") <= width
        assert self.errors == []
        assert not [url for url in self.requests if url.startswith("http")]

    def see_first(self, page: Path, figures: int) -> None:
        """Open a page at three widths: its first screen has so many figures, none to be scrolled to.

        No word is cut, nothing fails, and all that can be pressed has a name for who can't see it.
        """
        for width in (400, 768, 1280):
            self.open(page, width, height=800)
            self.until(f"{SHOWN}.every(place => place.querySelector('svg.marks, canvas'))")
            bottoms = self.js(BOTTOMS)
            assert len(bottoms) == figures
            assert max(bottoms, default=0) <= 800, width
            assert max(self.js(CUT)) < 1, width
            self._require_sound(width)
        nodes = self.call("Accessibility.getFullAXTree")["nodes"]
        pressed = [one for one in nodes if one.get("role", {}).get("value") in _PRESSED]
        assert pressed
        assert [one for one in pressed if not one.get("name", {}).get("value")] == []

    def type(self, text: str) -> None:
        """Type into what has the focus."""
        self.call("Input.insertText", text=text)

    def tab_to(self, expression: str, *, back: bool = False) -> None:
        """Press Tab until what has the focus, ``document.activeElement``, meets an expression."""
        for _ in range(200):
            self.key("Tab", shift=back)
            if self.js(expression):
                return
        raise AssertionError(f"can't be reached by Tab: {expression}")

    def key(self, key: str, *, shift: bool = False) -> None:
        for kind in ("keyDown", "keyUp"):
            letter = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
            text = {"text": letter} if letter and kind == "keyDown" else {}
            code = _CODES.get(key) or ord(key.upper())
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                windowsVirtualKeyCode=code,
                modifiers=8 * shift,
                **text,
            )

    def click(self, x: float, y: float) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            pressed = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **pressed)

    def picture(self) -> bytes:
        """What is seen of the page, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def figure_saved(self, folder: Path, name: str, kind: str) -> bytes:
        """What a figure's menu saves as "SVG" or "PNG", or its button as "CSV", into a new ``folder``."""
        folder.mkdir()
        figure = f"document.querySelector('[data-name={name}]')"
        controls = f"[...{figure}.querySelectorAll('button, .vega-actions a')]"
        control = f"{controls}.find(one => one.textContent.includes('{kind}'))"
        if kind != "CSV":
            # The image is made when the link is pressed.
            self.js(f"{control}.dispatchEvent(new Event('mousedown'))")
            self.until(f"/^(data|blob):/.test({control}.href)")
        return self.downloaded(folder, f"{control}.click()")

    def downloaded(self, folder: Path, trigger: str) -> bytes:
        """The file that an expression makes the page save, of which ``folder`` holds no other."""
        self.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
        self.js(trigger)

        def whole() -> list[Path]:
            return [path for path in folder.iterdir() if path.suffix != ".crdownload"]

        self._wait(whole, trigger)
        return whole()[0].read_bytes()

    def pdf(self) -> bytes:
        """The page as it is printed."""
        return base64.b64decode(self.call("Page.printToPDF")["data"])

    @staticmethod
    def _wait(met: Any, what: str = "the browser") -> None:
        end = time.monotonic() + _SECONDS
        while not met():
            assert time.monotonic() < end, f"waited too long for {what}"
            time.sleep(0.05)
