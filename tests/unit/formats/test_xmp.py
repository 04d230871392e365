from __future__ import annotations

import io
from xml.etree import ElementTree as ET

import numpy as np
import PIL.Image
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from panoexec.angles import rotation, rotation_321
from panoexec.formats.xmp import Position, attitude_properties, gpano_properties, packet, with_xmp


def jpeg(exif: bool = True) -> bytes:
    buffer = io.BytesIO()
    metadata = PIL.Image.Exif()
    metadata[0x010F] = "maker"
    PIL.Image.effect_noise((64, 48), 60).save(buffer, "JPEG", **({"exif": metadata} if exif else {}))
    return buffer.getvalue()


@given(yaw=st.floats(-180, 179.9), pitch=st.floats(-91, 91), roll=st.floats(-2, 2))
@example(yaw=30, pitch=-90, roll=0)
@example(yaw=30, pitch=-90, roll=0.02)
@example(yaw=30, pitch=0, roll=0.02)
def test_both_sets_of_angles_give_back_the_attitude(yaw: float, pitch: float, roll: float) -> None:
    pose = rotation(yaw, pitch, roll)
    found = attitude_properties(pose)
    dji = rotation_321(*(float(found[f"drone-dji:Gimbal{axis}Degree"]) for axis in ("Yaw", "Pitch", "Roll")))
    np.testing.assert_allclose(dji, pose, atol=4e-5)
    body = rotation_321(*(float(found[f"Camera:{axis}"]) for axis in ("Yaw", "Pitch", "Roll")))
    # the body's axes are image top, image right, boresight
    np.testing.assert_allclose(np.stack([body[:, 2], body[:, 1], -body[:, 0]], axis=1), pose, atol=4e-5)


def test_the_nadir_with_its_top_to_the_north_is_all_zero_for_pix4d_and_minus_90_for_dji() -> None:
    found = attitude_properties(rotation(0, -90))
    assert [found[f"Camera:{axis}"] for axis in ("Yaw", "Pitch", "Roll")] == ["0.000"] * 3
    assert found["drone-dji:GimbalPitchDegree"] == "-90.000"
    horizontal = attitude_properties(rotation(90, 0))
    assert [horizontal[f"Camera:{axis}"] for axis in ("Yaw", "Pitch", "Roll")] == ["90.000", "90.000", "0.000"]


def test_unknown_positions_are_left_out() -> None:
    nan = float("nan")
    some = attitude_properties(
        rotation(0, 0), position=Position(latitude_deg=1, longitude_deg=2, altitude_m=nan, relative_altitude_m=nan)
    )
    assert "drone-dji:GpsLatitude" in some
    assert "drone-dji:AbsoluteAltitude" not in some
    assert "drone-dji:RelativeAltitude" not in some
    assert "drone-dji:FlightYawDegree" not in attitude_properties(rotation(0, 0), flight_yaw_deg=nan)


def test_packet_is_well_formed_and_escapes() -> None:
    text = packet({"tiff:Make": 'a "b" <c> & d'})
    root = ET.fromstring(text[text.index("<x:xmpmeta") : text.index("<?xpacket end")])
    values = [v for element in root.iter() for v in element.attrib.values()]
    assert 'a "b" <c> & d' in values
    with pytest.raises(ValueError, match="unknown XMP prefix"):
        packet({"other:Thing": "1"})


def test_gpano_has_the_required_properties() -> None:
    whole = gpano_properties(1000, heading_deg=-90)
    assert whole["GPano:FullPanoHeightPixels"] == whole["GPano:CroppedAreaImageHeightPixels"] == "500"
    assert whole["GPano:PoseHeadingDegrees"] == "270.000"
    part = gpano_properties(1000, cropped_width_px=800, cropped_height_px=300, left_px=100, top_px=200)
    assert part["GPano:CroppedAreaTopPixels"] == "200"
    assert part["GPano:CroppedAreaImageWidthPixels"] == "800"


@pytest.mark.parametrize("exif", [True, False])
def test_xmp_is_put_in_and_replaced_without_touching_the_rest(exif: bool) -> None:
    original = jpeg(exif)
    once = with_xmp(original, packet({"tiff:Make": "first"}))
    twice = with_xmp(once, packet({"tiff:Make": "other"}))
    assert once.count(b"<x:xmpmeta") == twice.count(b"<x:xmpmeta") == 1
    assert b"first" not in twice
    assert len(twice) == len(once)
    scan = original.index(b"\xff\xda")
    assert twice.endswith(original[scan:])
    with PIL.Image.open(io.BytesIO(twice)) as picture:
        assert picture.getexif().get(0x010F) == ("maker" if exif else None)
        np.testing.assert_array_equal(np.asarray(picture), np.asarray(PIL.Image.open(io.BytesIO(original))))


def test_what_is_no_jpeg_is_refused() -> None:
    whole = jpeg()
    for broken, text in (
        (b"", "is not a JPEG"),
        (b"\x89PNG", "is not a JPEG"),
        (whole[:3], "broken"),
        (whole[:20], "broken"),
    ):
        with pytest.raises(ValueError, match=text):
            with_xmp(broken, packet({"tiff:Make": "x"}))
    with pytest.raises(ValueError, match="does not fit"):
        with_xmp(whole, packet({"tiff:Make": "x" * 70000}))
