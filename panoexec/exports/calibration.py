"""What flights tell of a gimbal: measured attitudes compared with those that the content of the photos implies.

Each tied photo has an estimated attitude (docs/content.md). Its difference from the measured one, about the gimbal's
axes, is the measurement's own error; its mean over a flight is the bias, its standard deviation the spread. Ties tell
nothing about what all photos share about the vertical, so the bias of yaw is left out, and its spread contains the
drift of the heading during the flight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from panoexec.angles import rotation_from_quaternion, wrap_180, yaw_pitch_roll

LEAST_PHOTOS: Final = 6
"""Fewer tied photos tell nothing about spread."""
_SIGMAS: Final = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisFigures:
    """One axis of the gimbal, degrees.

    Attributes:
        bias_deg: mean of measured minus true; NaN for yaw.
        spread_deg: standard deviation about it.
        pointing_deg: largest error of an accepted photo as measured, measured minus target.
        tolerance_deg: what contains pointing and measurement together: the largest pointing error plus bias plus three
            times the spread.
    """

    bias_deg: float
    spread_deg: float
    pointing_deg: float
    tolerance_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """The figures of one or several missions."""

    missions: int
    photos: int
    axes: Mapping[str, AxisFigures]


def calibrate(documents: Sequence[Mapping[str, Any]]) -> Calibration | None:
    """Compare measured and refined attitudes; None with fewer than `LEAST_PHOTOS` tied photos.

    Args:
        documents: manifests.
    """
    errors: list[list[float]] = []
    pointing: list[list[float]] = []
    for document in documents:
        own: list[list[float]] = []
        for shot in document["shots"]:
            number, refined = shot.get("accepted_attempt"), shot.get("refined")
            if number is None or not refined:
                continue
            attempt = next(a for a in shot["attempts"] if a["number"] == number)
            measured, told = attempt.get("measured"), attempt.get("error_deg")
            if not measured or not told:
                continue
            angles = [yaw_pitch_roll(rotation_from_quaternion(pose["quaternion"])) for pose in (measured, refined)]
            yaw, pitch, roll = (float(wrap_180(a - b)) for a, b in zip(*angles, strict=True))
            own.append([pitch, roll, yaw])
            pointing.append([float(told[axis]) for axis in ("pitch", "roll", "yaw")])
        if own:
            # the heading's constant error is another one in every flight
            shared = np.array([0.0, 0.0, float(np.mean([row[2] for row in own]))])
            errors += (np.array(own) - shared).tolist()
    if len(errors) < LEAST_PHOTOS:
        return None
    values, pointed = np.array(errors), np.abs(np.array(pointing)).max(axis=0)
    bias, spread = values.mean(axis=0), values.std(axis=0, ddof=1)
    axes = {}
    for place, axis in enumerate(("pitch", "roll", "yaw")):
        known = math.nan if axis == "yaw" else float(bias[place])
        share = 0.0 if axis == "yaw" else abs(known)
        axes[axis] = AxisFigures(
            bias_deg=known,
            spread_deg=float(spread[place]),
            pointing_deg=float(pointed[place]),
            tolerance_deg=float(pointed[place]) + share + _SIGMAS * float(spread[place]),
        )
    return Calibration(missions=len(documents), photos=len(errors), axes=axes)
