"""The simulated camera behind PTP: its shutter in simulated time, and its card, on which the rendered photos appear."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.camera_component import apply_drift_fault, gimbal_state
from panoexec.sim.photos.exposure import Settings, metered
from panoexec.sim.physics.camera import CameraModel, Exposure, Refusal
from panoexec.sim.physics.gimbal import GimbalPhysics
from panoexec.sim.physics.world import SimClock, Timeline
from panoexec.sim.tethered import responder as codes
from panoexec.sim.tethered.card import Card
from panoexec.sim.tethered.ptp import Answer, Told
from panoexec.sim.tethered.responder import Responder, usual_properties

_ANSWERS: Final = {
    Refusal.BUSY: Answer.DEVICE_BUSY,
    Refusal.STORAGE_FULL: Answer.STORE_FULL,
    Refusal.FAULT: Answer.ACCESS_DENIED,
}


class TetheredShutter:
    """Takes photos for PTP's InitiateCapture.

    Attributes:
        responder: answers PTP operations.
        tell: sends a PTP event; set by whoever serves the camera.
        model: shutter and storage.
    """

    def __init__(
        self,
        config: SimConfig,
        *,
        clock: SimClock,
        timeline: Timeline,
        physics: GimbalPhysics,
        faults: Faults,
        develop: Callable[[Exposure, Settings], str],
    ) -> None:
        self._config = config.camera
        self._clock = clock
        self._timeline = timeline
        self._physics = physics
        self._faults = faults
        self._develop = develop
        self._exposed_at: dict[str, tuple[Exposure, float]] = {}
        self._card = Card(size_bytes=round(config.camera.storage_mib) << 20)
        self.tell: Callable[..., None] = lambda *_: None
        self.model = CameraModel(
            config.camera,
            timeline,
            look=lambda: gimbal_state(physics, timeline.now_s),
            on_exposed=self._exposed,
            seed=config.seed,
        )
        optics = config.camera.optics
        self.responder = Responder(
            card=self._card,
            shoot=self._shoot,
            free_images=lambda: int(self.model.available_mib // config.camera.image_mib),
            properties={one.code: one for one in usual_properties(optics.focal_length_mm)},
            model=optics.name,
        )

    def _shoot(self) -> Answer:
        self._faults.photo_commanded(self._timeline.now_s)
        if self._faults.photo("photo-lost"):
            return Answer.OK  # it says so, and takes none
        if self._faults.photo("photo-refused"):
            return _ANSWERS[Refusal.FAULT]
        refusal = self.model.shoot()
        if refusal is not None:
            return _ANSWERS[refusal]
        apply_drift_fault(self._faults, self._physics)
        return Answer.OK

    def _exposed(self, exposure: Exposure) -> None:
        path = unquote(urlsplit(self._develop(exposure, self._settings(exposure))).path)
        self._exposed_at[path] = (exposure, self._clock.utc(exposure.start_s))

    def _settings(self, exposure: Exposure) -> Settings:
        """What the settings are; a camera that is not set by hand meters every photo by itself."""
        value = {code: one.value for code, one in self.responder.properties.items()}
        settings = Settings(
            exposure_s=value[codes.SHUTTER] / 1e4,
            f_number=value[codes.APERTURE] / 100,
            iso=value[codes.ISO],
            manual_white_balance=value[codes.WHITE_BALANCE] != codes.usual_properties(1.0)[1].value,
        )
        if value[codes.PROGRAM] == codes.MANUAL:
            return settings
        return metered(settings, exposure.estimate.pitch_deg)

    @property
    def hold_s(self) -> float:
        """Simulated time at which the next photo is on the card, and that must not pass before it was rendered."""
        return min((one.end_s + self._config.report_s for one, _ in self._exposed_at.values()), default=math.inf)

    def written(self, path: str) -> None:
        """A photo was rendered: it appears on the card, at the earliest when the camera has stored it."""
        found = self._exposed_at.pop(path, None)
        if found is not None:
            exposure, utc_s = found
            at_s = max(self._timeline.now_s, exposure.end_s + self._config.report_s)
            self._timeline.at(at_s, lambda: self._store(Path(path), utc_s))

    def _store(self, path: Path, utc_s: float) -> None:
        added = self._card.add_file(path, name=path.name, time_s=utc_s)
        if not self._faults.photo("capture-lost"):
            self.tell(Told.OBJECT_ADDED, added.handle)
        self.tell(Told.CAPTURE_COMPLETE)
