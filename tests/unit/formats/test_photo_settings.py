"""Settings of photos, from their EXIF data."""

from __future__ import annotations

import math
import struct
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from panoexec.formats.photo_settings import PhotoExif, differences, read_settings
from panoexec.sim.photos.jpeg import PhotoMetadata, jpeg_bytes

PHOTO = jpeg_bytes(
    np.zeros((20, 30, 3), dtype=np.uint8),
    PhotoMetadata(
        time_utc_s=1.7e9,
        exposure_s=0.002,
        focal_length_mm=35.0,
        equivalent_focal_length_mm=52.0,
        q_wxyz=(1.0, 0.0, 0.0, 0.0),
        f_number=4.0,
        iso=400,
        manual_white_balance=True,
    ),
)
SETTINGS = PhotoExif(
    exposure_s=0.002, f_number=4.0, iso=400, white_balance="manual", focal_length_mm=35.0, width_px=30, height_px=20
)


def test_what_a_photo_was_taken_with(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(PHOTO)
    assert read_settings(tmp_path / "a.jpg") == SETTINGS


def test_a_file_that_is_no_jpeg_or_is_not_there_has_none(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"<html>")
    assert read_settings(tmp_path / "a.jpg") is None
    assert read_settings(tmp_path / "b.jpg") is None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(at=st.integers(2, 400), garbage=st.binary(max_size=40), end=st.integers(0, len(PHOTO)))
def test_damage_is_read_as_settings_that_are_not_told(tmp_path: Path, at: int, garbage: bytes, end: int) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes((PHOTO[:at] + garbage + PHOTO[at + len(garbage) :])[:end])
    found = read_settings(path)
    assert found is None or isinstance(found, PhotoExif)
    numbers = [value for value in astuple(found) if isinstance(value, float)] if found else []
    assert all(math.isfinite(value) for value in numbers)  # they become JSON


def test_a_setting_that_is_zero_by_zero_is_not_told(tmp_path: Path) -> None:
    rational = struct.pack(">II", 1, 500)
    assert PHOTO.count(rational) == 1
    (tmp_path / "a.jpg").write_bytes(PHOTO.replace(rational, bytes(8)))
    assert read_settings(tmp_path / "a.jpg") == replace(SETTINGS, exposure_s=None)


def test_differences_are_named_and_roundings_are_none() -> None:
    assert differences(SETTINGS, replace(SETTINGS, exposure_s=0.00201, focal_length_mm=35.1)) == ()
    other = replace(
        SETTINGS, exposure_s=0.001, f_number=5.6, iso=200, white_balance="auto", focal_length_mm=50.0, width_px=60
    )
    assert differences(SETTINGS, other) == (
        "exposure 0.002 s → 0.001 s",
        "aperture 4 → 5.6",
        "ISO 400 → 200",
        "focal length 35 mm → 50 mm",
        "white balance manual → auto",
        "size 30×20 → 60×20",
    )
    assert differences(SETTINGS, PhotoExif()) == ()
