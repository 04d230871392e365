"""The parent's end of the process that holds a tethered camera: bounded calls, and a kill when one hangs."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any, Final

import structlog

from panoexec.errors import DeviceError, LinkError

_MODULE: Final = "panoexec.adapters.camera.tethered.process"
_LINE_BYTES: Final = 1 << 24
"""Longest line: the listing of a card with 100,000 files."""
_END_S: Final = 1.0

_log = structlog.get_logger(__name__)


class CallFailedError(DeviceError):
    """The camera, or libgphoto2, refused a call.

    Attributes:
        kind: see `library.CameraError`.
        code: libgphoto2's result code.
    """

    def __init__(self, kind: str, text: str, code: int = 0) -> None:
        super().__init__(text)
        self.kind = kind
        self.code = code


class CameraProcess:
    """One process, for one opening of the camera. Once it is gone, it stays gone.

    Attributes:
        heard_s: time.monotonic of its last line.
        gone: set when it has ended.
        why_gone: what ended it, for people.
    """

    def __init__(self, on_event: Callable[[dict[str, Any]], None]) -> None:
        self.heard_s = time.monotonic()
        self.gone = asyncio.Event()
        self.why_gone = ""
        self._on_event = on_event
        self._process: asyncio.subprocess.Process | None = None
        self._answers: dict[int, asyncio.Future[Any]] = {}
        self._numbers = 0
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def pid(self) -> int:
        """Process id, 0 before the start."""
        return 0 if self._process is None else self._process.pid

    @property
    def is_asked(self) -> bool:
        """Whether a call waits for its answer."""
        return bool(self._answers)

    async def start(self) -> None:
        """Start it.

        Raises:
            LinkError: the interpreter cannot be started.
        """
        try:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                _MODULE,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                limit=_LINE_BYTES,
            )
        except OSError as error:
            raise LinkError(f"the process for the camera cannot be started: {error.strerror}") from error
        self._tasks = [
            asyncio.create_task(self._read(), name="tethered camera"),
            asyncio.create_task(self._read_errors(), name="tethered camera errors"),
        ]

    async def call(self, do: str, timeout_s: float, **fields: object) -> Any:
        """Have something done.

        Args:
            do: what, see `process`.
            timeout_s: real seconds, after which the process is killed.
            fields: of the request.

        Raises:
            CallFailedError: refused.
            LinkError: the process or the camera is gone, or hangs and was killed.
        """
        process = self._process
        if process is None or process.stdin is None or self.gone.is_set() or process.stdin.is_closing():
            raise LinkError(self.why_gone or "the camera is gone")
        self._numbers += 1
        number = self._numbers
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        process.stdin.write(json.dumps({"id": number, "do": do, **fields}).encode() + b"\n")
        try:
            async with asyncio.timeout(timeout_s):
                return await answer
        except TimeoutError:
            self.kill(f"the camera did not answer within {timeout_s:g} s ({do})")
            raise LinkError(self.why_gone) from None
        finally:
            self._answers.pop(number, None)

    def kill(self, why: str) -> None:
        """End it at once; what it was doing is settled by what the camera lists afterwards."""
        self._fail(why)
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()

    async def stop(self) -> None:
        """Let it close the camera, and kill it if that takes too long."""
        process = self._process
        if process is None:
            return
        if process.stdin is not None:
            process.stdin.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_END_S):
                await process.wait()
        self.kill("closed")
        await process.wait()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        # asyncio warns of a transport that is collected before it was closed
        transport = getattr(process, "_transport", None)
        if transport is not None:
            transport.close()

    async def _read(self) -> None:
        assert self._process is not None
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            self.heard_s = time.monotonic()
            try:
                document = json.loads(line)
            except ValueError:
                _log.warning("unexpected output of the camera's process", line=line[:200])
                continue
            self._take(document)
        code = await self._process.wait()
        self._fail(f"the process of the camera ended (exit code {code})")

    def _take(self, document: dict[str, Any]) -> None:
        if "event" in document:
            if document["event"] == "lost":
                self._fail(str(document["text"]))
            else:
                self._on_event(document)
            return
        answer = self._answers.get(document["id"])
        if answer is None or answer.done():
            return
        if "error" not in document:
            answer.set_result(document["ok"])
        elif document["error"] == "lost":
            answer.set_exception(LinkError(document["text"]))
        else:
            answer.set_exception(CallFailedError(document["error"], document["text"], document["code"]))

    async def _read_errors(self) -> None:
        assert self._process is not None
        assert self._process.stderr is not None
        while line := await self._process.stderr.readline():
            _log.debug("camera process", line=line.decode(errors="replace").rstrip()[:300])

    def _fail(self, why: str) -> None:
        if self.gone.is_set():
            return
        self.why_gone = why
        self.gone.set()
        for answer in self._answers.values():
            if not answer.done():
                answer.set_exception(LinkError(why))
