"""A headless Chromium, spoken to over a pipe (the DevTools protocol): what a page does in a real browser.

Every wait is for an event or a condition of the page, under one generous limit; nothing depends on how fast it comes.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

LIMIT_S = 180.0
SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_WEBGL = ("--disable-gpu", "--disable-3d-apis")
NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def chromium() -> str | None:
    """The browser's program, if one is installed."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One browser with one page; a context manager."""

    def __init__(self, profile: Path, *, webgl: bool = True) -> None:
        # the protocol's pipe: the browser reads from descriptor 3 and writes to 4
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        program = chromium()
        assert program is not None
        flags = [
            "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run", "--disable-extensions",
            "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
            "--remote-debugging-pipe", f"--user-data-dir={profile}",
            *(SOFTWARE_WEBGL if webgl else NO_WEBGL),
            "about:blank",
        ]  # fmt: skip
        # a shell puts the ends where they belong; they may have any numbers here
        moves = f'exec 3<&{to_read} 4>&{to_write}; exec "$@"'
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", moves, "browser", program, *flags], pass_fds=(to_read, to_write),
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_read)
        os.close(to_write)
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        self.events: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(10)
        os.close(self._write)
        os.close(self._read)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Ask something and return the answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._write, data) :]
        deadline = time.monotonic() + LIMIT_S
        while True:
            answer = self._message(deadline, method)
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self.events.append(answer)

    def _message(self, deadline: float, waiting_for: str) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(0.0, deadline - time.monotonic()))
            assert ready, f"the browser did not answer {waiting_for} in {LIMIT_S} s"
            chunk = os.read(self._read, 1 << 20)
            assert chunk, f"the browser ended while it was asked for {waiting_for}"
            self._buffer += chunk
        line, self._buffer = self._buffer.split(b"\0", 1)
        return dict(json.loads(line))

    def show(self, *, width: int, height: int = 900, dark: bool = False, phone: bool = False) -> None:
        """Set the window's size and the colour scheme."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, path: Path) -> None:
        """Open a file and return when its scripts have run."""
        self.events.clear()
        self.call("Page.navigate", url=path.absolute().as_uri())
        self.until("document.readyState === 'complete' && document.documentElement.dataset.ready === 'yes'")

    def visit(self, url: str) -> None:
        """Open an address and return when its scripts say that the page is ready."""
        # from elsewhere, so that it is loaded anew, and no question is put to the page that was there before
        for address in ("about:blank", url):
            self.events.clear()
            self.call("Page.navigate", url=address)
            self._await("Page.loadEventFired")
        self.until("document.documentElement.dataset.ready === 'yes'")

    def _await(self, method: str) -> None:
        deadline = time.monotonic() + LIMIT_S
        while not any(event.get("method") == method for event in self.events):
            self.events.append(self._message(deadline, method))

    def click(self, selector: str) -> None:
        """Click the middle of an element, as a mouse does: what lies above it gets the click.

        A page that heard nothing for a while, on a busy machine, obeys no click: that is waited for.
        """
        self.until("document.documentElement.dataset.lost !== 'yes'")
        x, y = self.middle(selector)
        self.mouse("mousePressed", x, y, buttons=1)
        self.mouse("mouseReleased", x, y)

    def middle(self, selector: str) -> tuple[float, float]:
        """Of an element that is scrolled into the view, in the window."""
        found = f"document.querySelector({json.dumps(selector)})"
        self.until(f"{found} !== null && {found}.getClientRects().length > 0")
        self.value(f"{found}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
        box = self.value(
            f"(({{x, y, width, height}}) => [x + width / 2, y + height / 2])({found}.getBoundingClientRect())"
        )
        return float(box[0]), float(box[1])

    def drag(self, start: tuple[float, float], end: tuple[float, float], *, steps: int = 8) -> None:
        """Press, move in steps, release."""
        self.mouse("mousePressed", *start, buttons=1)
        for k in range(1, steps + 1):
            x, y = (a + (b - a) * k / steps for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, buttons=1)
        self.mouse("mouseReleased", *end)

    def key(self, text: str) -> None:
        """Press a key and let it go."""
        named = {"Escape": 27, "Enter": 13, "Tab": 9}
        more: dict[str, Any] = {"windowsVirtualKeyCode": named[text]} if text in named else {"text": text}
        if text == "Enter":
            more["text"] = "\r"
        self.call("Input.dispatchKeyEvent", type="keyDown", key=text, **more)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=text, **{k: v for k, v in more.items() if k != "text"})

    def value(self, expression: str) -> Any:
        """What an expression is in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, condition: str) -> Any:
        """Return an expression's value once it is true."""
        deadline = time.monotonic() + LIMIT_S
        # the page tells it after one of its frames; asked again until then
        # what throws because something is not there yet is not true yet
        asked = f"new Promise((r) => setTimeout(() => {{ try {{ r({condition}); }} catch {{ r(false); }} }}, 30))"
        while True:
            try:
                if value := self.value(asked):
                    return value
            except AssertionError:
                if time.monotonic() > deadline:
                    raise
            if time.monotonic() > deadline:
                page = str(self.value("document.body.innerText"))[:400]
                raise AssertionError(f"never true: {condition}; {self.problems()}; the page: {page!r}")

    def mouse(self, kind: str, x: float, y: float, *, buttons: int = 0) -> None:
        """`mousePressed`, `mouseMoved` or `mouseReleased` at a point of the window."""
        button = "left" if kind != "mouseMoved" or buttons else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=buttons, clickCount=1)

    def screenshot(self, path: Path, *, whole: bool = True) -> None:
        """A PNG of the page."""
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def problems(self) -> list[str]:
        """What the console holds of errors and warnings, and exceptions that nobody caught."""
        found = []
        for event in self.events:
            params = event.get("params", {})
            match event.get("method"):
                case "Runtime.exceptionThrown":
                    details = params["exceptionDetails"]
                    found.append(str(details.get("exception", {}).get("description", details["text"])))
                case "Runtime.consoleAPICalled" if params["type"] in {"error", "warning", "assert"}:
                    found.append(" ".join(str(arg.get("value", "")) for arg in params["args"]))
                case "Log.entryAdded" if params["entry"]["level"] in {"error", "warning"}:
                    found.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        return found

    def requests(self) -> list[str]:
        """Every address that the page asked for."""
        return [e["params"]["request"]["url"] for e in self.events if e.get("method") == "Network.requestWillBeSent"]
