from __future__ import annotations

import dataclasses
import json

import pytest

from panoexec.lens.distortion import Distortion
from panoexec.optics import Camera

_X5S = Camera(
    name="x5s",
    sensor_width_mm=17.3,
    sensor_height_mm=13.0,
    image_width_px=5280,
    image_height_px=3956,
    focal_length_mm=45.0,
    calibrated_focal_length_mm=46.0,
)
_KNOWN = dataclasses.replace(
    _X5S, distortion=Distortion(k1=-0.05, p1=0.001), principal_point_px=(2660.0, 1960.0), fov_margin=0.01
)


def test_the_calibrated_focal_length_decides_the_field_of_view() -> None:
    assert _X5S.half_width == 17.3 / 92
    assert _X5S.hfov_deg < _X5S.with_lens("nominal").hfov_deg
    assert _X5S.with_lens("nominal").half_width == 17.3 / 90
    assert (_X5S.lens_used, _X5S.with_lens("nominal").lens_used) == ("calibrated", "nominal")


def test_nothing_of_the_calibration_counts_for_the_nominal_lens() -> None:
    nominal, plain = _KNOWN.with_lens("nominal"), dataclasses.replace(_X5S, calibrated_focal_length_mm=None)
    assert plain.lens_used == "nominal"
    for name in ("half_width", "half_height", "image_area", "hfov_deg", "sides"):
        assert getattr(nominal, name) == getattr(plain, name)
    assert nominal.distortion_used is None


def test_the_margin_shrinks_the_frame_and_enlarges_the_image_that_overlaps_are_shares_of() -> None:
    surer = dataclasses.replace(_KNOWN, fov_margin=0.0)
    assert _KNOWN.half_width == pytest.approx(surer.half_width * 0.99)
    assert _KNOWN.half_height == pytest.approx(surer.half_height * 0.99)
    assert _KNOWN.image_area == pytest.approx(surer.image_area * 1.01**2)


def test_a_portrait_camera_sees_the_same_turned() -> None:
    turned = _KNOWN.rotated()
    assert turned.half_width == pytest.approx(_KNOWN.half_height, rel=1e-6)
    assert turned.half_height == pytest.approx(_KNOWN.half_width, rel=1e-6)
    assert turned.image_area == pytest.approx(_KNOWN.image_area, rel=1e-9)
    assert turned.principal_point_px == (3956 - 1960, 2660)
    for _ in range(3):
        turned = turned.rotated()
    assert turned == _KNOWN


def test_a_camera_survives_json() -> None:
    assert Camera.from_plain(json.loads(json.dumps(dataclasses.asdict(_KNOWN)))) == _KNOWN
