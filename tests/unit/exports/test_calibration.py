"""Bias and spread of a gimbal are found from measured and refined attitudes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.exports.calibration import calibrate


def manifest(seed: int, *, count: int = 40, bias: tuple[float, float] = (0.2, -0.05), spread: float = 0.03) -> Any:
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-0.6, 0.6)
    shots = []
    for k in range(count):
        yaw, pitch = float(rng.uniform(-180, 180)), float(rng.uniform(-80, 20))
        off = [bias[0] + rng.normal(0, spread), bias[1] + rng.normal(0, spread), heading + rng.normal(0, spread)]
        measured = rotation(yaw + off[2], pitch + off[0], off[1])

        def pose(matrix: Any) -> dict[str, Any]:
            return {"quaternion": quaternion_from_rotation(matrix).tolist()}

        attempt = {"number": 1, "measured": pose(measured), "error_deg": {"pitch": 0.05, "roll": -0.02, "yaw": 0.1}}
        shots.append({"index": k, "accepted_attempt": 1, "refined": pose(rotation(yaw, pitch)), "attempts": [attempt]})
    shots.append({"index": count, "accepted_attempt": None, "refined": None, "attempts": []})
    return {"shots": shots}


def test_bias_and_spread_are_found() -> None:
    found = calibrate([manifest(1), manifest(2)])
    assert found is not None
    assert found.photos == 80
    assert found.axes["pitch"].bias_deg == pytest.approx(0.2, abs=0.02)
    assert found.axes["roll"].bias_deg == pytest.approx(-0.05, abs=0.02)
    assert math.isnan(found.axes["yaw"].bias_deg), "what all photos share about the vertical leaves no trace"
    for axis in ("pitch", "roll", "yaw"):
        assert found.axes[axis].spread_deg == pytest.approx(0.03, abs=0.01)
    pitch = found.axes["pitch"]
    assert pitch.tolerance_deg == pytest.approx(0.05 + abs(pitch.bias_deg) + 3 * pitch.spread_deg)


def test_too_few_photos_tell_nothing() -> None:
    assert calibrate([manifest(1, count=4)]) is None
    assert calibrate([]) is None
