"""A camera that obeys the protocol of `panoexec.devices` and can misbehave in every way that hardware does."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from panoexec.clock import Clock
from panoexec.devices import (
    CaptureEvidence,
    EvidenceLevel,
    RecalledPhoto,
    RecalledPhotos,
)
from panoexec.errors import DeviceError


@dataclass
class TakenPhoto:
    """What the camera really did."""

    index: int
    triggered_s: float
    exposed_s: float
    ended_s: float


@dataclass
class FakeCapture:
    camera: FakeCamera
    commanded_s: float
    acknowledged_s: float
    index: int
    level: EvidenceLevel
    proof_s: float

    async def evidence(self, at_least: EvidenceLevel, timeout_s: float) -> CaptureEvidence:
        clock = self.camera.clock
        proven = self.level >= at_least and self.proof_s <= self.commanded_s + timeout_s
        until = self.proof_s if proven else self.commanded_s + timeout_s
        if at_least > EvidenceLevel.ACKNOWLEDGED:
            await clock.sleep(until - clock.monotonic())
        if clock.monotonic() + 1e-9 < self.proof_s:
            least = min(self.level, EvidenceLevel.ACKNOWLEDGED)
            return CaptureEvidence(level=least, received_s=self.commanded_s)
        has_file = self.level >= EvidenceLevel.CAPTURE_MESSAGE
        return CaptureEvidence(
            level=self.level,
            received_s=self.proof_s,
            image_index=self.index,
            file_url=f"IMG_{self.index // self.camera.photos_a_name:04d}.jpg" if has_file else "",
            time_utc_s=clock.time(),
            exposed_s=self.camera.photos[self.index].exposed_s if self.camera.dates else math.nan,
            exposed_error_s=0.02 if self.camera.dates else math.nan,
            opened_s=self._opened_s(),
            reported_s=math.nan if math.isnan(self.camera.stamps_s) else self.proof_s,
            contradiction=self.camera.contradictions.get(self.index, ""),
        )

    def _opened_s(self) -> tuple[float, float]:
        if math.isnan(self.camera.stamps_s):
            return math.nan, math.nan
        stamp_s = self.camera.photos[self.index].exposed_s + self.camera.stamps_s
        return stamp_s - 0.004, stamp_s + 0.002


@dataclass
class FakeCamera:
    """Takes photos in virtual time and keeps the truth about them."""

    clock: Clock
    latency_s: float = 0.05
    exposure_s: float = 0.02
    proof_after_s: float = 0.1
    level: EvidenceLevel = EvidenceLevel.CAPTURE_MESSAGE
    storage_free_images: float = math.inf
    # faults
    refusals: int = 0
    lost_commands: int = 0
    lost_proofs: int = 0
    remembers: bool = False
    """Whether it tells its photos again, with their times."""
    counts: bool = False
    """Whether it tells how many it has taken."""
    memory_fails: int = 0
    photos_a_name: int = 1
    """How many of its photos in a row have one file name."""
    dates: bool = False
    """Whether its reports tell when it exposed."""
    contradictions: dict[int, str] = field(default_factory=dict)
    """Why a photo may be another one, by index."""
    stamps_s: float = math.nan
    """How long after the opening of its shutter it stamps a photo, if round trips bound its stamps."""
    # what happened
    photos: list[TakenPhoto] = field(default_factory=list)

    @property
    def image_count(self) -> int:
        return len(self.photos) if self.counts else -1

    @property
    def reports_photos(self) -> bool:
        return self.dates

    async def recall(self) -> RecalledPhotos:
        await self.clock.sleep(0.02)
        if self.memory_fails > 0:
            self.memory_fails -= 1
            raise DeviceError("the camera did not answer")
        photos = [self._recalled(photo) for photo in self.photos[-4:]] if self.remembers else []
        return RecalledPhotos(photos=tuple(photos), image_count=self.image_count)

    def _recalled(self, photo: TakenPhoto) -> RecalledPhoto:
        evidence = CaptureEvidence(
            level=self.level,
            received_s=self.clock.monotonic(),
            image_index=photo.index,
            file_url=f"IMG_{photo.index:04d}.jpg" if self.level >= EvidenceLevel.CAPTURE_MESSAGE else "",
        )
        ago_s = self.clock.monotonic() - photo.exposed_s
        return RecalledPhoto(evidence=evidence, exposed_utc_s=self.clock.time() - ago_s)

    async def trigger(self) -> FakeCapture:
        commanded_s = self.clock.monotonic()
        await self.clock.sleep(0.01)
        if self.refusals > 0:
            self.refusals -= 1
            raise DeviceError("the camera refused to take a photo")
        if self.storage_free_images < 1:
            raise DeviceError("the camera's storage is full")
        if self.lost_commands > 0:
            self.lost_commands -= 1
            await self.clock.sleep(2.0)
            raise DeviceError("the camera did not answer")
        self.storage_free_images -= 1
        exposed_s = commanded_s + self.latency_s
        photo = TakenPhoto(len(self.photos), commanded_s, exposed_s, exposed_s + self.exposure_s)
        self.photos.append(photo)
        level = self.level
        if self.lost_proofs > 0:
            self.lost_proofs -= 1
            level = EvidenceLevel.ACKNOWLEDGED
        answers = level > EvidenceLevel.COMMANDED
        return FakeCapture(
            camera=self,
            commanded_s=commanded_s,
            acknowledged_s=self.clock.monotonic() if answers else math.nan,
            index=photo.index,
            level=level,
            proof_s=photo.ended_s + self.proof_after_s,
        )
