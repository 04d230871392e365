"""Triggers of a tethered camera, and which photo each of them took, whatever hangs or is lost."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable

import structlog

from panoexec.adapters.camera.capture import Capture, Report, Source
from panoexec.adapters.camera.tethered.child import CallFailedError, CameraProcess
from panoexec.adapters.camera.tethered.holder import CameraHolder
from panoexec.adapters.camera.tethered.patience import Patience
from panoexec.adapters.camera.tethered.photos import Photo, PhotoBook
from panoexec.clock import Clock, SystemClock, VehicleClock, work
from panoexec.devices import CaptureEvidence, EvidenceLevel, PendingCapture
from panoexec.errors import DeviceError, LinkError

_log = structlog.get_logger(__name__)


class Triggers:
    """Sends triggers one at a time, and gives each its photo.

    Attributes:
        book: the photos in the camera, and whose they are.
    """

    def __init__(
        self,
        holder: CameraHolder,
        *,
        clock: Clock,
        patience: Patience,
        want: Callable[[Photo, Capture], None],
    ) -> None:
        """Create it.

        Args:
            holder: of the camera.
            clock: of the mission.
            patience: how long things are waited for.
            want: fetches the file of a photo.
        """
        self.book = PhotoBook(patience.late_s)
        self._holder = holder
        self._clock = clock
        self._patience = patience
        self._want = want
        self._numbers = 0
        self._triggering = asyncio.Lock()
        self._listing = asyncio.Lock()
        self._news = asyncio.Event()
        self._awaiting: asyncio.Task[None] | None = None

    async def close(self) -> None:
        """End what waits."""
        if self._awaiting is not None:
            self._awaiting.cancel()
            await asyncio.gather(self._awaiting, return_exceptions=True)

    def opened(self, files: list[tuple[str, str]], *, again: bool) -> None:
        """The camera was opened, and has these files."""
        now_s = self._clock.monotonic()
        if again:
            self.book.postpone(now_s + self._patience.late_s)
            self._matched(self.book.seen(files, now_s), now_s)
        else:
            self.book.baseline(files)

    def added(self, files: list[tuple[str, str]]) -> None:
        """The camera told new files."""
        now_s = self._clock.monotonic()
        self._matched(self.book.seen(files, now_s), now_s)

    async def trigger(self) -> PendingCapture:
        """See `Camera.trigger`; not before it is settled what earlier triggers brought."""
        async with self._triggering:
            await self._settle()
            process = await self._holder.ready()
            self._numbers += 1
            capture = Capture(self._numbers, clock=self._clock, poll=self._poll, must_report=True)
            capture.commanded(self._clock.monotonic())
            self.book.sent(capture)
            asked_s = time.monotonic()
            try:
                with work(self._clock):
                    answer = await process.call("trigger", self._patience.call_s)
            except CallFailedError as error:
                self.book.refused(capture)
                raise DeviceError(self._holder.explained(error)) from error
            except LinkError as error:
                return await self._hung(process, capture, str(error))
            except asyncio.CancelledError:
                self.book.gave_up(capture, self._clock.monotonic() + self._patience.late_s)
                raise
            if isinstance(self._clock, SystemClock):
                capture.commanded(capture.commanded_s + (answer["sent"] - asked_s) * self._clock.speedup)
            capture.acknowledged(self._clock.monotonic())
            if isinstance(self._clock, VehicleClock):
                self._awaiting = asyncio.create_task(self._await_photo(capture), name="photo of the tethered camera")
            return capture

    async def _await_photo(self, capture: Capture) -> None:
        """Have a simulated vehicle not run ahead of the photo's event, which takes real time to arrive."""
        with work(self._clock):
            end_s = time.monotonic() + self._patience.missing_s
            while capture in self.book.waiting and time.monotonic() < end_s:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(self._patience.look_s):
                        await self._news.wait()
                self._news.clear()

    async def _hung(self, process: CameraProcess, capture: Capture, why: str) -> PendingCapture:
        """A trigger without an answer: whether it took a photo shows what the camera lists once it answers again."""
        _log.warning("trigger without an answer", number=capture.number, reason=why)
        self._holder.drop(process, why)
        with contextlib.suppress(LinkError):
            await self._holder.ready()
            await self._settle_one(capture)
        if capture.known.level >= EvidenceLevel.CAPTURE_MESSAGE:
            return capture
        self.book.gave_up(capture, self._clock.monotonic() + self._patience.late_s)
        raise LinkError(f"the camera did not carry out the trigger, or did not tell: {why}")

    async def _settle(self) -> None:
        """Wait until no earlier trigger can still bring a photo."""
        clock, patience = self._clock, self._patience
        while self.book.waiting or self.book.doubt_until_s(clock.monotonic()) > clock.monotonic():
            await self._holder.ready()
            age_s = max((clock.monotonic() - one.commanded_s for one in self.book.waiting), default=0.0)
            if age_s >= patience.missing_s:
                await self.look()
            for capture in self.book.waiting:
                if age_s > patience.late_s:
                    self.book.gave_up(capture, -math.inf)
            if self.book.waiting or self.book.doubt_until_s(clock.monotonic()) > clock.monotonic():
                await clock.sleep(patience.look_s)

    async def _settle_one(self, capture: Capture) -> None:
        """Wait for the photo of a trigger that was not answered."""
        deadline_s = self._clock.monotonic() + self._patience.late_s / 4
        while capture in self.book.waiting and self._clock.monotonic() < deadline_s:
            await self._clock.sleep(self._patience.look_s)  # its event may come now
        if capture in self.book.waiting:
            await self.look()

    async def look(self) -> None:
        """List the camera, and match what is new; an event may have been lost."""
        async with self._listing:
            with work(self._clock), contextlib.suppress(DeviceError):
                files = await self._holder.call("list", self._patience.list_s)
                now_s = self._clock.monotonic()
                self._matched(self.book.seen([(folder, name) for folder, name in files], now_s), now_s)

    async def _poll(self, capture: Capture) -> None:
        """See `Capture`: the photo's event may have been lost."""
        if capture in self.book.waiting and self._clock.monotonic() - capture.commanded_s >= self._patience.missing_s:
            await self.look()

    def _matched(self, found: list[tuple[Photo, Capture]], now_s: float) -> None:
        self._news.set()
        for photo, capture in found:
            evidence = CaptureEvidence(
                level=EvidenceLevel.CAPTURE_MESSAGE, received_s=now_s, reported_s=now_s, file_url=photo.url
            )
            capture.add(Report(source=Source.CAPTURED, evidence=evidence))
            self._want(photo, capture)
