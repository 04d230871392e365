"""`geo.txt`, and copies with XMP inside."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import PIL.Image
import pytest

from panoexec.errors import UsageError
from panoexec.exports.model import ExportSet, ExportShot
from panoexec.exports.odm import geo_text, write_embedded
from panoexec.optics import Camera


def exports(*shots: ExportShot) -> ExportSet:
    return ExportSet(title="t", camera=Camera.from_fov(60, 45), shots=shots)


SHOT = ExportShot(
    index=0,
    row=0,
    q_wxyz=(1.0, 0.0, 0.0, 0.0),
    target_pitch_deg=0.0,
    target_yaw_deg=0.0,
    file_name="images/a.jpg",
    latitude_deg=47.5,
    longitude_deg=8.25,
    altitude_m=530.0,
)


def test_positions_are_longitude_latitude_altitude() -> None:
    unknown = replace(SHOT, file_name="images/b.jpg", latitude_deg=float("nan"))
    flat = replace(SHOT, file_name="images/c.jpg", altitude_m=float("nan"))
    spaced = replace(SHOT, file_name="images/d e.jpg")
    assert geo_text(exports(SHOT, unknown, flat, spaced)).splitlines() == [
        "EPSG:4326",
        "a.jpg 8.250000000 47.500000000 530.000",
        "c.jpg 8.250000000 47.500000000",
    ]
    assert geo_text(exports(unknown)) == ""


def test_copies_carry_the_attitude_and_the_same_picture(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    buffer = io.BytesIO()
    PIL.Image.new("RGB", (32, 24), (10, 200, 30)).save(buffer, "JPEG")
    (tmp_path / "images" / "a.jpg").write_bytes(buffer.getvalue())
    gone, broken = (replace(SHOT, index=k, file_name=f"images/{k}.jpg") for k in (1, 2))
    (tmp_path / "images" / "2.jpg").write_bytes(b"no photo")
    written, problems = write_embedded(exports(SHOT, gone, broken), tmp_path, tmp_path / "out")
    assert written == [tmp_path / "out" / "a.jpg"]
    assert set(problems) == {"images/1.jpg", "images/2.jpg"}
    copy = written[0].read_bytes()
    assert b"GimbalYawDegree" in copy
    assert copy.endswith(buffer.getvalue()[-200:])
    assert (tmp_path / "images" / "a.jpg").read_bytes() == buffer.getvalue()
    with pytest.raises(UsageError, match="another one"):
        write_embedded(exports(SHOT), tmp_path, tmp_path / "images")
