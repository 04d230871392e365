from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import PIL.ExifTags
import PIL.Image
import pytest

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.devices import Quaternion
from panoexec.errors import UsageError
from panoexec.formats.photo_settings import read_settings
from panoexec.formats.xmp import Position
from panoexec.sim.photos.jpeg import PhotoMetadata, jpeg_bytes, padded, write_jpeg

IMAGE = np.random.default_rng(1).integers(0, 255, (40, 60, 3)).astype(np.uint8)
DJI = "{http://www.dji.com/drone-dji/1.0/}"


def quaternion(yaw: float, pitch: float, roll: float = 0.0) -> Quaternion:
    w, x, y, z = quaternion_from_rotation(rotation(yaw, pitch, roll)).tolist()
    return w, x, y, z


def metadata(**changes: object) -> PhotoMetadata:
    values: dict[str, object] = {
        "time_utc_s": 1790000000.1234,
        "exposure_s": 1 / 800,
        "focal_length_mm": 15.0,
        "equivalent_focal_length_mm": 30.02,
        "q_wxyz": quaternion(-30.0, -45.0),
        "position": Position(latitude_deg=-35.3632621, longitude_deg=149.1652374, altitude_m=614.25),
        "flight_yaw_deg": 12.5,
    }
    return PhotoMetadata(**{**values, **changes})  # type: ignore[arg-type]


def read_exif(path: Path) -> tuple[PIL.Image.Exif, dict[int, object], dict[int, object]]:
    with PIL.Image.open(path) as picture:
        exif = picture.getexif()
        return exif, exif.get_ifd(PIL.ExifTags.IFD.Exif), exif.get_ifd(PIL.ExifTags.IFD.GPSInfo)


def read_xmp(path: Path) -> dict[str, str]:
    data = path.read_bytes()
    start = data.index(b"<x:xmpmeta")
    text = data[start : data.index(b"</x:xmpmeta>") + 12].decode()
    description = ET.fromstring(text).find(".//{http://www.w3.org/1999/02/22-rdf-syntax-ns#}Description")
    assert description is not None
    return dict(description.attrib)


def test_exif_contains_time_camera_and_position(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    assert write_jpeg(path, IMAGE, metadata()) == path.stat().st_size
    exif, details, gps = read_exif(path)
    base, g = PIL.ExifTags.Base, PIL.ExifTags.GPS
    assert exif[base.Make] == "panoexec"
    assert details[base.DateTimeOriginal] == "2026:09:21 14:13:20"
    assert details[base.SubsecTimeOriginal] == "123"
    assert details[base.OffsetTimeOriginal] == "+00:00"
    assert float(details[base.ExposureTime]) == pytest.approx(1 / 800)  # type: ignore[arg-type]
    assert float(details[base.FocalLength]) == 15.0  # type: ignore[arg-type]
    assert details[base.FocalLengthIn35mmFilm] == 30
    assert (details[base.ExifImageWidth], details[base.ExifImageHeight]) == (60, 40)
    assert (gps[g.GPSLatitudeRef], gps[g.GPSLongitudeRef]) == ("S", "E")
    d, m, s = (float(part) for part in gps[g.GPSLatitude])  # type: ignore[attr-defined]
    assert d + m / 60 + s / 3600 == pytest.approx(35.3632621, abs=1e-8)
    assert float(gps[g.GPSAltitude]) == pytest.approx(614.25)  # type: ignore[arg-type]
    assert float(gps[g.GPSImgDirection]) == pytest.approx(330.0)  # type: ignore[arg-type]
    assert gps[g.GPSImgDirectionRef] == "T"


def test_xmp_contains_the_attitude(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    write_jpeg(path, IMAGE, metadata())
    found = read_xmp(path)
    angles = [float(found[f"{DJI}Gimbal{axis}Degree"]) for axis in ("Yaw", "Pitch", "Roll")]
    assert angles == pytest.approx([-30.0, -45.0, 0.0], abs=1e-3)
    assert float(found[f"{DJI}FlightYawDegree"]) == 12.5


def test_the_picture_itself_survives(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    smooth = np.broadcast_to(np.linspace(0, 255, 60)[None, :, None], (40, 60, 3)).astype(np.uint8)
    write_jpeg(path, smooth, metadata())
    with PIL.Image.open(path) as picture:
        np.testing.assert_allclose(np.asarray(picture).astype(float), smooth, atol=6)


def test_without_a_fix_no_position_is_claimed(tmp_path: Path) -> None:
    nowhere = Position(latitude_deg=float("nan"), longitude_deg=float("nan"), altitude_m=float("nan"))
    for position in (None, nowhere):
        write_jpeg(tmp_path / "a.jpg", IMAGE, metadata(position=position, flight_yaw_deg=None))
        assert PIL.ExifTags.GPS.GPSLatitude not in read_exif(tmp_path / "a.jpg")[2]
        assert not [name for name in read_xmp(tmp_path / "a.jpg") if "Latitude" in name or "Flight" in name]


def test_below_sea_level_and_west(tmp_path: Path) -> None:
    place = Position(latitude_deg=31.5, longitude_deg=-0.25, altitude_m=-430.0)
    write_jpeg(tmp_path / "a.jpg", IMAGE, metadata(position=place))
    gps, g = read_exif(tmp_path / "a.jpg")[2], PIL.ExifTags.GPS
    assert (gps[g.GPSLatitudeRef], gps[g.GPSLongitudeRef]) == ("N", "W")
    assert gps[g.GPSAltitudeRef] == b"\x01"
    assert float(gps[g.GPSAltitude]) == 430.0  # type: ignore[arg-type]


def test_an_unwritable_folder_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be written"):
        write_jpeg(tmp_path / "gone" / "a.jpg", IMAGE, metadata())


@pytest.mark.parametrize("size", [0, 5000, 100_000, 3_000_001])
def test_a_padded_photo_shows_and_tells_the_same(tmp_path: Path, size: int) -> None:
    content = jpeg_bytes(IMAGE, metadata())
    larger = padded(content, size)
    assert len(content) <= len(larger)
    assert size <= len(larger) <= max(len(content), size + 4)
    for name, data in (("a.jpg", content), ("b.jpg", larger)):
        (tmp_path / name).write_bytes(data)
    told = read_settings(tmp_path / "a.jpg")
    assert told is not None
    assert read_settings(tmp_path / "b.jpg") == told
    with PIL.Image.open(tmp_path / "a.jpg") as one, PIL.Image.open(tmp_path / "b.jpg") as other:
        assert np.array_equal(np.asarray(one), np.asarray(other))
