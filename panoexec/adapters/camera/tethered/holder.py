"""Holds a tethered camera: opens it, and opens it anew in another process when it was unplugged, restarted or hung."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final

import structlog

from panoexec.adapters.camera.tethered.child import CallFailedError, CameraProcess
from panoexec.adapters.camera.tethered.errors import explained
from panoexec.adapters.camera.tethered.patience import Patience
from panoexec.errors import DeviceError, LinkError

_AGAIN_S: Final = (0.2, 0.5, 1.0, 2.0)
"""Pauses before the camera is opened anew; the last one repeats."""
_SILENT_S: Final = 6.0
"""A process that says nothing for so long hangs."""
_WATCH_S: Final = 1.0

_log = structlog.get_logger(__name__)


class CameraHolder:
    """One camera; `run` it in a task.

    Attributes:
        opened: set while the camera is open.
        about: `model`, `port`, `serial` and `library` of the camera that was opened last; empty before.
        restarts: how often it had to be opened anew.
    """

    def __init__(
        self,
        port: str,
        model: str,
        *,
        patience: Patience,
        on_event: Callable[[dict[str, Any]], None],
        on_opened: Callable[[list[tuple[str, str]], list[dict[str, Any]], bool], None],
        prepare: Callable[[Callable[..., Awaitable[Any]]], Awaitable[None]],
    ) -> None:
        """Create it.

        Args:
            port: `usb:…`, `ptpip:HOST`, or "" for the only camera on USB.
            model: as libgphoto2 names it, or a part of it; "" for any.
            patience: time limits.
            on_event: called with each event of the camera.
            on_opened: called with its files, its cards, and whether it was open before.
            prepare: awaited before it counts as open, with what asks its process.
        """
        self.opened = asyncio.Event()
        self.about: dict[str, Any] = {}
        self.restarts = -1
        self._port, self._model = port, model
        self._patience = patience
        self._on_event = on_event
        self._on_opened = on_opened
        self._prepare = prepare
        self._process: CameraProcess | None = None
        self._problem = "it was not looked for yet"

    @property
    def problem(self) -> str:
        """Why the camera is not open; "" if it is."""
        return "" if self.opened.is_set() else self._problem

    @property
    def process_id(self) -> int:
        """Of the process that holds the camera; 0 without one."""
        return 0 if self._process is None else self._process.pid

    async def run(self) -> None:
        """Hold it for ever."""
        failures = 0
        while True:
            process = self._process = CameraProcess(self._on_event)
            try:
                await process.start()
                told = await process.call("open", self._patience.open_s, port=self._port, model=self._model)
                await self._prepare(process.call)
                self._note_opened(told)
                failures = 0
                await _watch(process)
                why = process.why_gone
            except CallFailedError as error:
                why = self.explained(error)
            except DeviceError as error:
                why = str(error)
            was_open = self.opened.is_set()
            self.opened.clear()
            if why != self._problem or was_open:
                _log.warning("camera not ready", reason=why)
            self._problem = why
            await process.stop()
            await asyncio.sleep(_AGAIN_S[min(failures, len(_AGAIN_S) - 1)])
            failures += 1

    def _note_opened(self, told: dict[str, Any]) -> None:
        self.about = {key: told[key] for key in ("model", "port", "serial", "library")}
        self.restarts += 1
        files = [(folder, name) for folder, name in told["files"]]
        self._on_opened(files, told["storage"], self.restarts > 0)
        _log.info("camera opened", **self.about, files=len(files), again=self.restarts)
        self.opened.set()

    def explained(self, error: CallFailedError) -> str:
        """What a user is told of a refused call."""
        return explained(error.kind, str(error), port=self._port, model=self._model, code=error.code)

    async def close(self) -> None:
        """Close the camera, once `run` was cancelled."""
        if self._process is not None:
            await self._process.stop()

    async def call(self, do: str, timeout_s: float, **fields: object) -> Any:
        """Ask the process of the camera; see `CameraProcess.call`."""
        if self._process is None or not self.opened.is_set():
            raise LinkError(f"the camera is not there: {self._problem}")
        return await self._process.call(do, timeout_s, **fields)

    async def ready(self) -> CameraProcess:
        """The process, once the camera is open.

        Raises:
            LinkError: it is not opened in time; says why.
        """
        if not self.opened.is_set():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._patience.back_s):
                    await self.opened.wait()
        if not self.opened.is_set() or self._process is None:
            raise LinkError(f"the camera is not there: {self._problem}")
        return self._process

    def drop(self, process: CameraProcess, why: str) -> None:
        """Kill a process that did not answer, so that the camera is opened anew."""
        process.kill(why)
        if process is self._process:
            self.opened.clear()


async def _watch(process: CameraProcess) -> None:
    """Return when the process is gone; kills it when it says nothing any more."""
    while not process.gone.is_set():
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_WATCH_S):
                await process.gone.wait()
        silent_s = time.monotonic() - process.heard_s
        if not (process.gone.is_set() or process.is_asked) and silent_s > _SILENT_S:
            process.kill("the camera does not answer any more")
