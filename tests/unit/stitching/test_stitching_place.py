"""The EXIF tags of a panorama: what is known is in them as readers expect it, what is not is not."""

from __future__ import annotations

import io
import math
from typing import Any

import PIL.ExifTags
import PIL.Image
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from panoexec.exports.model import ExportShot
from panoexec.formats.xmp import gpano_properties
from panoexec.stitching.place import Place, degrees_minutes_seconds, exif_of, place_of

GPS = PIL.ExifTags.GPS
ZURICH = {"latitude_deg": 47.3977, "longitude_deg": 8.5456, "altitude_m": 488.25}


def written(place: Place) -> tuple[dict[str, Any], dict[str, Any]]:
    """EXIF and GPS tags by name, as a reader finds them in a JPEG."""
    buffer = io.BytesIO()
    PIL.Image.new("RGB", (8, 4)).save(buffer, "JPEG", exif=exif_of(place))
    with PIL.Image.open(io.BytesIO(buffer.getvalue())) as picture:
        exif = picture.getexif()
        tags = dict(exif) | exif.get_ifd(PIL.ExifTags.IFD.Exif)
        gps = exif.get_ifd(PIL.ExifTags.IFD.GPSInfo)
    return {PIL.ExifTags.TAGS[key]: value for key, value in tags.items()}, {
        PIL.ExifTags.GPSTAGS[key]: value for key, value in gps.items()
    }


def degrees(parts: tuple[Any, ...], ref: str) -> float:
    whole, minutes, seconds = (float(part) for part in parts)
    assert minutes < 60
    assert seconds < 60
    return (whole + minutes / 60 + seconds / 3600) * (-1 if ref in "SW" else 1)


@given(st.floats(-90, 90), st.floats(-180, 180), st.floats(-450, 9000), st.floats(-720, 720))
@example(-0.00000001, -179.9999999999, -0.001, 359.99999)
@example(47.99999999999, 180.0, 0.0, -0.0001)
def test_what_is_known_is_written(latitude: float, longitude: float, altitude: float, heading: float) -> None:
    _, gps = written(Place(latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude, heading_deg=heading))
    assert degrees(gps["GPSLatitude"], gps["GPSLatitudeRef"]) == pytest.approx(latitude, abs=3e-8)
    east = degrees(gps["GPSLongitude"], gps["GPSLongitudeRef"])
    assert (east - longitude + 180) % 360 - 180 == pytest.approx(0, abs=3e-8)
    below = gps["GPSAltitudeRef"] in (b"\x01", 1)
    assert float(gps["GPSAltitude"]) * (-1 if below else 1) == pytest.approx(altitude, abs=0.0051)
    assert gps["GPSImgDirectionRef"] == "T"
    told = gpano_properties(1000, heading_deg=heading)["GPano:PoseHeadingDegrees"]
    assert f"{float(gps['GPSImgDirection']):.3f}" == told
    assert float(told) < 360


@given(st.floats(-180, 180))
def test_angles_are_rounded_and_never_have_sixty_seconds(angle: float) -> None:
    whole, minutes, seconds = degrees_minutes_seconds(angle)
    assert degrees((whole, minutes, seconds), "N") == pytest.approx(abs(angle), abs=2e-8)


def test_the_moment_of_the_first_photo_in_utc() -> None:
    tags, gps = written(Place(time_utc_s=1790000000.25))
    assert tags["DateTimeOriginal"] == "2026:09:21 14:13:20"
    assert tags["OffsetTimeOriginal"] == "+00:00"
    assert tags["SubsecTimeOriginal"] == "250"
    assert gps == {}


def test_what_is_not_known_is_not_written() -> None:
    tags, gps = written(Place())
    assert "DateTimeOriginal" not in tags
    assert gps == {}
    assert "GPano:PoseHeadingDegrees" not in gpano_properties(1000, heading_deg=math.nan)
    _, gps = written(Place(latitude_deg=1.0, longitude_deg=2.0))
    assert {"GPSAltitude", "GPSAltitudeRef", "GPSImgDirection", "GPSImgDirectionRef"}.isdisjoint(gps)
    _, gps = written(Place(latitude_deg=95.0, longitude_deg=2.0, altitude_m=3.0, heading_deg=4.0))
    assert {"GPSLatitude", "GPSAltitude"}.isdisjoint(gps)
    assert float(gps["GPSImgDirection"]) == 4.0


def photo(**changes: Any) -> ExportShot:
    values: dict[str, Any] = {
        "index": 0,
        "row": 0,
        "q_wxyz": (1.0, 0.0, 0.0, 0.0),
        "target_pitch_deg": 0.0,
        "target_yaw_deg": 0.0,
    }
    return ExportShot(**(values | changes))


def test_the_place_is_the_missions_else_that_of_a_photo() -> None:
    away = photo(latitude_deg=-1.0, longitude_deg=-2.0, altitude_m=-3.0, time_utc_s=50.0)
    document = {"position": ZURICH, "reference": {"yaw_north_deg": 12.5}}
    place = place_of(document, [photo(time_utc_s=60.0), away])
    assert place == Place(**ZURICH, heading_deg=12.5, time_utc_s=50.0)
    nowhere: dict[str, Any] = {
        "position": dict.fromkeys(ZURICH),
        "reference": {"kind": "heading", "yaw_north_deg": None},
    }
    place = place_of(nowhere, [photo(), away])
    assert (place.latitude_deg, place.longitude_deg, place.altitude_m) == (-1.0, -2.0, -3.0)
    assert math.isnan(place.heading_deg)
    place = place_of({"position": None}, [photo()])
    assert not place.has_position
    assert math.isnan(place.heading_deg)
    assert math.isnan(place.time_utc_s)
