"""The camera's behaviour: when it opens the shutter, when it refuses, what it counts, when its card is full. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from panoexec.sim.config import CameraConfig
from panoexec.sim.physics.gimbal import Angles
from panoexec.sim.physics.world import Timeline


class Refusal(Enum):
    """Why a photo is not taken."""

    BUSY = auto()
    STORAGE_FULL = auto()
    FAULT = auto()


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """A photo as it was taken.

    Attributes:
        index: the camera's running number.
        start_s, end_s: when the shutter was open, simulated time.
        truth: true camera attitudes from the opening to the closing of the shutter, evenly spaced.
        estimate: what the gimbal believed at the opening.
        measured: what the camera was told of its attitude.
    """

    index: int
    start_s: float
    end_s: float
    truth: tuple[Angles, ...]
    estimate: Angles
    measured: Angles


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """The gimbal at one moment: true, as its controller believes, as it reports."""

    truth: Angles
    estimate: Angles
    measured: Angles


class CameraModel:
    """A camera on a timeline.

    Attributes:
        storage_full: the card has no room, whatever was written (fault).
        images: how many photos were taken.
    """

    def __init__(
        self,
        config: CameraConfig,
        timeline: Timeline,
        *,
        look: Callable[[], Look],
        on_exposed: Callable[[Exposure], None],
        grain_s: float = 0.0,
    ) -> None:
        """A camera that is ready.

        Args:
            config: its figures.
            timeline: when it lives.
            look: where it looks now.
            on_exposed: gets each photo.
            grain_s: a command that comes too early by this much is taken for one in time.
        """
        self.config = config
        self._grain_s = grain_s
        self._timeline = timeline
        self._look = look
        self._on_exposed = on_exposed
        self._ready_s = 0.0
        self._busy = False
        self.storage_full = False
        self.images = 0

    @property
    def is_busy(self) -> bool:
        """Whether a photo is under way."""
        return self._busy

    @property
    def available_mib(self) -> float:
        """Room on the card."""
        if self.storage_full:
            return 0.0
        return max(0.0, self.config.storage_mib - self.images * self.config.image_mib)

    @property
    def wait_s(self) -> float:
        """How long until it takes the next photo."""
        return max(0.0, self._ready_s - self._timeline.now_s)

    def shoot(self) -> Refusal | None:
        """Take a photo; None if it will, else why not."""
        if self._busy or self.wait_s > self._grain_s + 1e-9:
            return Refusal.BUSY
        if self.available_mib < self.config.image_mib:
            return Refusal.STORAGE_FULL
        self._busy = True
        self._ready_s = self._timeline.now_s + self.config.interval_s
        self._timeline.after(self.config.latency_s, self._open)
        return None

    def _open(self) -> None:
        start, first = self._timeline.now_s, self._look()
        steps = max(1, round(self.config.exposure_s / 0.005))
        samples = [first.truth]
        for step in range(1, steps + 1):
            self._timeline.at(start + self.config.exposure_s * step / steps, lambda: samples.append(self._look().truth))
        self._timeline.at(start + self.config.exposure_s, lambda: self._close(start, first, samples))

    def _close(self, start_s: float, first: Look, samples: list[Angles]) -> None:
        self._busy = False
        index = self.config.index_start + self.images
        self.images += 1
        self._on_exposed(
            Exposure(
                index=index,
                start_s=start_s,
                end_s=self._timeline.now_s,
                truth=tuple(samples),
                estimate=first.estimate,
                measured=first.measured,
            )
        )
