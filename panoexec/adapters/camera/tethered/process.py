"""The process that holds a tethered camera: `python -m panoexec.adapters.camera.tethered.process`.

It reads one JSON object a line from standard input (`{"id", "do", …}`) and writes one a line: an answer (`{"id", "ok"}`
or `{"id", "error", "text"}`), or an event of the camera (`{"event", …}`). It exits when its input ends or its parent
does, and when the camera is gone. Nothing of libgphoto2 runs anywhere else, so a USB call that hangs holds nobody but
this process, which can be killed.

A trigger comes first: it is carried out between two parts of a file that is being fetched.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import select
import signal
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from panoexec.adapters.camera.tethered.libgphoto2 import CameraError, Library, guard_standard_input

_PR_SET_PDEATHSIG: Final = 1
_POLL_MS: Final = 1
"""How long libgphoto2 looks for an event."""
_BUSY_S: Final = 0.004
"""Pause between two looks while a photo is expected."""
_IDLE_S: Final = 0.25
_EXPECTED_S: Final = 40.0
"""How long after a trigger its photo may come."""
_ALIVE_S: Final = 1.0
"""Interval of the events `alive`."""


class Process:
    """The loop of the process."""

    def __init__(self) -> None:
        self._library = Library()
        self._is_open = False
        self._pending = b""
        self._waiting: deque[dict[str, Any]] = deque()
        self._fetching: tuple[int, Iterator[dict[str, Any] | None]] | None = None
        self._expected_until_s = 0.0
        self._alive_s = 0.0
        self._ended = False

    def run(self) -> None:
        """Serve until the input ends or the camera is gone."""
        while not self._ended:
            self._read_input(self._pause_s())
            try:
                self._turn()
            except CameraError as error:
                _write({"event": "lost", "text": str(error)})
                break
        self._library.close()

    def _turn(self) -> None:
        while self._waiting:
            self._serve(self._waiting.popleft())
        if not self._is_open:
            return
        if self._fetching is not None:
            self._go_on_fetching()
        now_s = time.monotonic()
        for _ in range(32):
            event = self._library.event(_POLL_MS)
            if event is None:
                break
            if event["event"] == "complete":
                self._expected_until_s = min(self._expected_until_s, now_s + 2.0)
            if event["event"] != "other":
                _write(event)
        if now_s - self._alive_s > _ALIVE_S and self._fetching is None:
            self._alive_s = now_s
            _write({"event": "alive", "storage": self._library.storage()})

    def _pause_s(self) -> float:
        if self._waiting or self._fetching is not None:
            return 0.0
        return _BUSY_S if time.monotonic() < self._expected_until_s else _IDLE_S

    def _read_input(self, wait_s: float) -> None:
        if not select.select([_IN], [], [], wait_s)[0]:
            return
        data = os.read(_IN, 1 << 16)
        if not data:
            self._ended = True
            return
        *lines, self._pending = (self._pending + data).split(b"\n")
        requests = [json.loads(line) for line in lines if line.strip()]
        urgent = [one for one in requests if one["do"] == "trigger"]
        self._waiting.extendleft(reversed(urgent))
        self._waiting.extend(one for one in requests if one["do"] != "trigger")

    def _serve(self, request: dict[str, Any]) -> None:
        number = request["id"]
        if request["do"] == "fetch" and self._fetching is not None:
            self._finish_fetching()
        try:
            if request["do"] == "fetch":
                steps = self._library.fetch(request["folder"], request["name"], Path(request["to"]))
                self._fetching = (number, steps)
                return
            _write({"id": number, "ok": self._do(request)})
        except CameraError as error:
            _write({"id": number, "error": error.kind, "text": str(error), "code": error.code})
            if error.kind == "lost":
                raise

    def _do(self, request: dict[str, Any]) -> Any:
        library, what = self._library, request["do"]
        if what == "open":
            about = library.open(request["port"], request["model"])
            self._is_open = True
            self._alive_s = time.monotonic()
            return about | {"storage": library.storage(), "files": library.files()}
        if what == "trigger":
            self._expected_until_s = time.monotonic() + _EXPECTED_S
            return {"sent": library.trigger()}
        if what == "list":
            self._finish_fetching()  # which does not survive the camera's being opened again
            return library.files_anew()
        if what == "read":
            return library.read(request["names"])
        if what == "set":
            return library.set(request["name"], request["value"])
        raise CameraError("setting", f"unknown request {what}")

    def _go_on_fetching(self) -> None:
        assert self._fetching is not None
        number, steps = self._fetching
        try:
            result = next(steps)
        except CameraError as error:
            self._fetching = None
            _write({"id": number, "error": error.kind, "text": str(error), "code": error.code})
            if error.kind == "lost":
                raise
            return
        if result is not None:
            self._fetching = None
            _write({"id": number, "ok": result})

    def _finish_fetching(self) -> None:
        while self._fetching is not None:
            self._go_on_fetching()


def _write(document: dict[str, Any]) -> None:
    data = json.dumps(document).encode() + b"\n"
    while data:
        data = data[os.write(_OUT, data) :]


_IN, _OUT = 0, 1


def main() -> None:
    """Run the process."""
    global _IN, _OUT
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides when to end
    # libgphoto2's drivers print, and close file descriptor 0: nothing but ours may be on our pipes
    _IN, _OUT = os.dup(0), os.dup(1)
    os.dup2(2, 1)
    os.close(0)
    guard_standard_input()
    with contextlib.suppress(BrokenPipeError):
        Process().run()
    sys.stdout.flush()


if __name__ == "__main__":
    main()
