"""Faults of photos and of what is told about them: spoiled pictures and files, wrong files, wrong attitudes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from panoexec.angles import rotation, yaw_pitch_roll
from panoexec.sim.faults import Faults
from panoexec.sim.photos.darkroom import ExposedPhoto
from panoexec.sim.physics.camera import Exposure
from panoexec.sim.physics.gimbal import Angles

_SPOILING = ("photo-black", "photo-dark", "photo-blur", "photo-defocus", "photo-truncated", "photo-damaged")


class PhotoMixer:
    """Stands between camera and darkroom.

    Args:
        faults: that are active.
        develop: has a photo rendered.
    """

    def __init__(self, faults: Faults, develop: Callable[[ExposedPhoto], None]) -> None:
        self._faults = faults
        self._develop = develop
        self._held: list[tuple[int, ExposedPhoto]] = []
        self._any = False

    def turned(self, exposure: Exposure) -> Exposure:
        """The exposure with the attitude that the camera really has, if the gimbal lies about it."""
        if not self._faults.photo("attitude-lie"):
            return exposure
        rng = self._faults.generator("attitude-lie")
        axis = np.array([rng.gauss(0, 1) for _ in range(3)])
        x, y, z = axis / np.linalg.norm(axis)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle = math.radians(self._faults.size("attitude-lie"))
        turn = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross

        def moved(angles: Angles) -> Angles:
            yaw, pitch, roll = yaw_pitch_roll(turn @ rotation(angles.yaw_deg, angles.pitch_deg, angles.roll_deg))
            return Angles(yaw_deg=float(yaw), roll_deg=float(roll), pitch_deg=float(pitch))

        return replace(exposure, truth=tuple(moved(angles) for angles in exposure.truth))

    def names(self) -> list[str]:
        """The faults that strike the photo that was just exposed, for the truth file."""
        names = (*_SPOILING, "photo-swapped", "photo-stale", "attitude-lie")
        return [name for name in names if self._faults.photo(name)]

    def develop(self, photo: ExposedPhoto) -> None:
        """Have a photo rendered, spoiled as the faults say."""
        faults = self._faults
        spoils = tuple(
            (name, faults.size(name), faults.generator(name).randrange(1 << 30))
            for name in _SPOILING
            if faults.photo(name)
        )
        photo = replace(photo, spoils=spoils, is_stale=self._any and faults.photo("photo-stale"))
        self._any = True
        for number, (left, held) in enumerate(self._held):
            self._held[number] = (left - 1, held)
        if self._held and self._held[0][0] <= 0:
            _, earlier = self._held.pop(0)
            self._develop(replace(photo, path=earlier.path))
            self._develop(replace(earlier, path=photo.path))
            return
        if faults.photo("photo-swapped"):
            self._held.append((max(1, round(faults.size("photo-swapped"))), photo))
            return
        self._develop(photo)

    def flush(self) -> None:
        """No photo is to come: those that wait for one to be swapped with are rendered as they are."""
        held, self._held = self._held, []
        for _, photo in held:
            self._develop(photo)
