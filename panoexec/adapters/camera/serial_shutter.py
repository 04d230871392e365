"""A cable release on a serial port: a pulse on RTS or DTR through an opto-coupler, or bytes to an adapter.

The cable has no return channel. If the camera's hot-shoe is wired to the autopilot's feedback pin, CAMERA_FEEDBACK is
the evidence of the photos.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Protocol, Self, TypeAlias

import serial
import structlog

from panoexec.adapters.camera.camera_kind import CameraKind, OpenCamera
from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.capture_matching import CaptureMatcher
from panoexec.adapters.camera.capture_messages import feedback_report
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import Handler, MavMessage
from panoexec.adapters.link.worker_calls import WorkerCalls
from panoexec.clock import Clock
from panoexec.devices import EvidenceLevel, PendingCapture
from panoexec.errors import LinkError
from panoexec.inputs.vehicle_sections import CameraSection

Line: TypeAlias = Literal["rts", "dtr", "bytes"]

_CLOSE_S: Final = 2.0
_WRITE_S: Final = 2.0
_FEEDBACK_PIN: Final = "CAM1_FEEDBAK_PIN"

_log = structlog.get_logger(__name__)


class FeedbackSource(Protocol):
    """Source of CAMERA_FEEDBACK: a `MavsdkLink`."""

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        """Call `handler` in another thread with each message; returns a function that unsubscribes it."""
        ...

    def post(self, callback: Callable[..., None], *args: object) -> None:
        """Call `callback` on the event loop."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialShutterFound:
    """What is known of a cable release; implements `CameraFound`.

    Attributes:
        label: its port and line.
        is_two_way, may_tell_files, image_width_px, image_height_px: nothing comes back over the cable.
        why: there is no choice.
    """

    label: str
    is_two_way: bool = False
    why: str = ""
    may_tell_files: bool = False
    image_width_px: int = 0
    image_height_px: int = 0


class SerialShutter:
    """Implements `OpenCamera`; an async context manager. The port heals: after a failure it is opened anew."""

    def __init__(
        self,
        port: str,
        *,
        clock: Clock,
        line: Line = "rts",
        payload: bytes = b"",
        pulse_s: float = 0.1,
        inverted: bool = False,
        baud: int = 9600,
        feedback: FeedbackSource | None = None,
        feedback_pin: bool = True,
        is_wired: Callable[[], Awaitable[bool]] | None = None,
    ) -> None:
        """Create it; entering the context opens the port.

        Args:
            port: the serial device, preferably by its /dev/serial/by-id name.
            clock: of the mission.
            line: the line, or `bytes`, that closes the contact.
            payload: bytes to send, for `line = "bytes"`.
            pulse_s: how long the line is held, real seconds.
            inverted: the contact is closed while the line is low. Linux raises RTS and DTR briefly when a port is
                opened, which does not trigger an inverted release.
            baud: bits a second, for bytes.
            feedback: where CAMERA_FEEDBACK comes from, if the hot-shoe is wired to the autopilot.
            feedback_pin: whether CAMERA_FEEDBACK means the pin's signal.
            is_wired: asks the autopilot whether a hot-shoe is wired to it; None if it cannot be asked.
        """
        self._port = port
        self._clock = clock
        self._line = line
        self._payload = payload
        self._pulse_s = pulse_s
        self._inverted = inverted
        self._baud = baud
        self._feedback = feedback
        self._feedback_pin = feedback_pin
        self._is_wired = is_wired
        self._serial: serial.Serial | None = None
        self._calls = WorkerCalls("serial shutter", threads=1)
        self._matcher = CaptureMatcher()
        self._numbers = 0
        self._off: list[Callable[[], None]] = []

    @property
    def storage_free_images(self) -> float:
        """Always infinity: unknown over a cable."""
        return math.inf

    @property
    def is_present(self) -> bool:
        """See `OpenCamera.is_present`; an open port is all that can be seen of a cable."""
        return True

    @property
    def age_s(self) -> float:
        """See `OpenCamera.age_s`."""
        return math.inf

    async def __aenter__(self) -> Self:
        """Open the port.

        Raises:
            LinkError: it cannot be opened.
        """
        try:
            await self._calls.run(self._open)
        except BaseException:
            self._calls.stop()
            raise
        if self._feedback is not None:
            self._off.append(self._feedback.on("CAMERA_FEEDBACK", self._photo_reported))
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Open the contact and close the port; waits for the end of a running pulse."""
        for off in self._off:
            off()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_CLOSE_S + self._pulse_s):
                await self._calls.run(self._close)
        self._calls.stop()

    async def discover(self, timeout_s: float = 15.0) -> SerialShutterFound:  # noqa: ARG002  (nothing to wait for)
        """See `OpenCamera.discover`; an open port is all that there is to find."""
        return SerialShutterFound(label=f"a cable release on {self._port} ({self._line})")

    async def best_evidence(self) -> EvidenceLevel:
        """See `OpenCamera.best_evidence`."""
        wired = self._is_wired is not None and await self._is_wired()
        return EvidenceLevel.FEEDBACK_PIN if wired else EvidenceLevel.COMMANDED

    async def trigger(self) -> PendingCapture:
        """See `Camera.trigger`; returns when the contact is closed or the bytes are sent.

        Raises:
            LinkError: the port failed.
        """
        self._numbers += 1
        capture = Capture(self._numbers, clock=self._clock, final=self._feedback is None)
        capture.commanded(self._clock.monotonic())
        self._matcher.enter(capture)
        loop = asyncio.get_running_loop()
        closed: asyncio.Future[None] = loop.create_future()

        def fire() -> None:
            port = self._open()
            capture.commanded(self._clock.monotonic())
            try:
                self._start(port)
                with contextlib.suppress(RuntimeError):  # the loop was closed: no task waits any more
                    loop.call_soon_threadsafe(_settle, closed)
                self._end(port)
            except (OSError, serial.SerialException) as error:
                self._drop()
                raise LinkError(f"serial shutter {self._port}: {_reason(error)}") from error

        pulse = self._calls.submit(fire)
        pulse.add_done_callback(_log_failure)  # the waiting task may be cancelled
        await asyncio.wait({pulse, closed}, return_when=asyncio.FIRST_COMPLETED)
        if not closed.done():
            self._matcher.withdraw(capture)
            pulse.result()
        return capture

    # --- in the worker thread

    def _open(self) -> serial.Serial:
        if self._serial is not None:
            return self._serial
        port = serial.Serial()
        port.port, port.baudrate, port.write_timeout = self._port, self._baud, _WRITE_S
        port.rts = port.dtr = self._inverted
        try:
            port.open()
        except (OSError, serial.SerialException) as error:
            raise LinkError(f"serial shutter {self._port}: {_reason(error)}") from error
        self._serial = port
        return port

    def _start(self, port: serial.Serial) -> None:
        if self._line == "bytes":
            port.write(self._payload)
            port.flush()
        else:
            self._set(port, closed=True)

    def _end(self, port: serial.Serial) -> None:
        if self._line != "bytes":
            time.sleep(self._pulse_s)
            self._set(port, closed=False)

    def _set(self, port: serial.Serial, *, closed: bool) -> None:
        level = closed != self._inverted
        if self._line == "rts":
            port.rts = level
        else:
            port.dtr = level

    def _drop(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            with contextlib.suppress(OSError, serial.SerialException):
                port.close()

    def _close(self) -> None:
        if self._serial is not None and self._line != "bytes":
            with contextlib.suppress(OSError, serial.SerialException):
                self._set(self._serial, closed=False)
        self._drop()

    # --- reports

    def _photo_reported(self, message: MavMessage) -> None:
        if self._feedback is not None:
            self._feedback.post(self._take_report, message)

    def _take_report(self, message: MavMessage) -> None:
        self._matcher.report(feedback_report(message, pin=self._feedback_pin))


def _settle(closed: asyncio.Future[None]) -> None:
    if not closed.done():
        closed.set_result(None)


def _log_failure(pulse: asyncio.Future[None]) -> None:
    if not pulse.cancelled() and (error := pulse.exception()) is not None:
        _log.warning("shutter pulse failed", error=str(error))


def _reason(error: Exception) -> str:
    strerror = getattr(error, "strerror", None)
    return str(strerror or error)


def _open(section: CameraSection, link: MavsdkLink, spool: Path | None) -> AbstractAsyncContextManager[OpenCamera]:
    del spool  # nothing comes over its link but messages

    async def is_wired() -> bool:
        return link.is_ardupilot and (await link.requests.parameter(_FEEDBACK_PIN) or -1) > 0

    assert section.serial_port is not None
    return SerialShutter(
        section.serial_port,
        clock=link.clock,
        line=section.serial_line,
        payload=(section.serial_bytes or "").encode(),
        pulse_s=section.pulse_s,
        feedback=link,
        is_wired=is_wired,
    )


KIND: Final = CameraKind(open=_open, settings="[camera] serial_port; systemd/serial.conf for the service")
