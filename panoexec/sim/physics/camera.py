"""Model of the camera: shutter timing, rejected commands, image count, storage. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from panoexec.sim.config import CameraConfig
from panoexec.sim.physics.gimbal import Angles
from panoexec.sim.physics.world import Timeline, seeded


class Refusal(Enum):
    """Reason for rejecting a photo command."""

    BUSY = auto()
    STORAGE_FULL = auto()
    FAULT = auto()


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """A photo.

    Attributes:
        index: the camera's image index.
        start_s, end_s: opening and closing of the shutter, simulated time.
        truth: true camera attitudes from the opening to the closing of the shutter, evenly spaced.
        estimate: the gimbal controller's estimate at the opening.
        measured: the attitude that was reported to the camera.
    """

    index: int
    start_s: float
    end_s: float
    truth: tuple[Angles, ...]
    estimate: Angles
    measured: Angles


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalState:
    """The gimbal at one moment: true attitude, the controller's estimate, the reported measurement."""

    truth: Angles
    estimate: Angles
    measured: Angles


class CameraModel:
    """A camera on a timeline.

    Attributes:
        storage_full: the card is full, independent of the photos (fault).
        images: number of photos taken.
    """

    def __init__(
        self,
        config: CameraConfig,
        timeline: Timeline,
        *,
        look: Callable[[], GimbalState],
        on_exposed: Callable[[Exposure], None],
        time_resolution_s: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Create a camera that is ready.

        Args:
            config: its parameters.
            timeline: the simulation's timeline.
            look: returns the gimbal's state at the current time.
            on_exposed: receives each photo.
            time_resolution_s: a command that is early by at most this time is accepted.
            seed: of the shutter's irregularity.
        """
        self.config = config
        self._time_resolution_s = time_resolution_s
        self._timeline = timeline
        self._look = look
        self._on_exposed = on_exposed
        self._ready_s = 0.0
        self._busy = False
        self._queued = 0
        self._index = config.index_start - 1
        self._random = seeded(seed, "shutter")
        self.storage_full = False
        self.images = 0

    @property
    def is_busy(self) -> bool:
        """Whether a photo is being taken."""
        return self._busy

    @property
    def available_mib(self) -> float:
        """Free space on the card, MiB."""
        if self.storage_full:
            return 0.0
        return max(0.0, self.config.storage_mib - self.images * self.config.image_mib)

    @property
    def wait_s(self) -> float:
        """Time until the next photo can be taken, seconds."""
        return max(0.0, self._ready_s - self._timeline.now_s)

    def shoot(self) -> Refusal | None:
        """Start a photo, or queue it; None if accepted, else the reason."""
        if self.available_mib < self.config.image_mib:
            return Refusal.STORAGE_FULL
        if self._busy or self.wait_s > self._time_resolution_s + 1e-9:
            if self._queued >= self.config.queue:
                return Refusal.BUSY
            self._queued += 1
            if self._queued == 1:
                self._timeline.after(self._until_free_s, self._from_queue)
            return None
        self._begin()
        return None

    @property
    def _until_free_s(self) -> float:
        """When to look at the queue again."""
        return max(self.wait_s, 0.01)

    def _from_queue(self) -> None:
        if self._busy or self.wait_s > self._time_resolution_s + 1e-9:
            self._timeline.after(self._until_free_s, self._from_queue)
            return
        self._queued -= 1
        self._begin()
        if self._queued:
            self._timeline.after(self._until_free_s, self._from_queue)

    def _begin(self) -> None:
        self._busy = True
        self._ready_s = self._timeline.now_s + self.config.interval_s
        jitter_s = self.config.latency_jitter_s * self._random.random() if self.config.latency_jitter_s else 0.0
        self._timeline.after(self.config.latency_s + jitter_s, self._open)

    def restart(self) -> None:
        """Forget the images' numbers, as a camera does that restarts."""
        self._index = self.config.index_start - 1

    def _open(self) -> None:
        start, first = self._timeline.now_s, self._look()
        steps = max(1, round(self.config.exposure_s / 0.005))
        samples = [first.truth]
        for step in range(1, steps + 1):
            self._timeline.at(start + self.config.exposure_s * step / steps, lambda: samples.append(self._look().truth))
        self._timeline.at(start + self.config.exposure_s, lambda: self._close(start, first, samples))

    def _close(self, start_s: float, first: GimbalState, samples: list[Angles]) -> None:
        self._busy = False
        self._index += 1
        index = self._index
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
