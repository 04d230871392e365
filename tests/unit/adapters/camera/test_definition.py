"""Camera definitions: what is read of them, what is refused, and the values of extended parameters."""

from __future__ import annotations

import contextlib
import gzip
import lzma
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.camera.settings.definition import Parameter, read_definition
from panoexec.adapters.camera.settings.extended_parameters import decoded, encoded
from panoexec.adapters.camera.settings.lock import changes
from panoexec.inputs.vehicle_sections import LockSection

# as a definition for Sony's cameras has it: values are codes, names are for people
SONY = b"""<?xml version="1.0" encoding="UTF-8" ?>
<mavlinkcamera>
  <definition version="7"><model>M</model><vendor>V</vendor></definition>
  <parameters>
    <parameter name="CAM_EXPMODE" type="int32" default="2">
      <description>Exposure Mode</description>
      <options default="2">
        <option name="P auto mode" value="2"><exclusions><exclude>CAM_ISO</exclude></exclusions></option>
        <option name="M manual" value="1"><exclusions></exclusions></option>
      </options>
    </parameter>
    <parameter name="CAM_SHUTTERSPD" type="int32" default="66536">
      <options><option name="1/500" value="66036" /><option name="1/1000" value="66536" /></options>
    </parameter>
    <parameter name="CAM_APERTURE" type="int32" default="560">
      <options><option name="F5.6" value="560" /></options>
    </parameter>
    <parameter name="CAM_ISO" type="int32" default="0">
      <options><option name="AUTO" value="16777215" /><option name="100" value="100" /></options>
    </parameter>
    <parameter name="CAM_FOCUSMODE" type="int32" default="2" readonly="1">
      <options><option name="Manual" value="1" /><option name="AF_S" value="2" /></options>
    </parameter>
    <parameter name="CAM_BROADCAST" type="bool" default="0" />
    <parameter name="A_NAME_THAT_IS_TOO_LONG" type="int32" />
  </parameters>
</mavlinkcamera>"""


def test_what_a_definition_offers_is_locked_by_the_names_of_its_choices() -> None:
    defined = read_definition(SONY)
    assert set(defined) == {
        *("CAM_EXPMODE", "CAM_SHUTTERSPD", "CAM_APERTURE", "CAM_ISO", "CAM_FOCUSMODE", "CAM_BROADCAST"),
    }
    assert defined["CAM_BROADCAST"].options == (("Off", "0"), ("On", "1"))
    assert defined["CAM_FOCUSMODE"].read_only
    now = {"CAM_EXPMODE": 2, "CAM_SHUTTERSPD": 66536, "CAM_APERTURE": 560, "CAM_ISO": 100}
    widgets = {
        name: {"value": defined[name].choice_of(value), "choices": [one for one, _ in defined[name].options]}
        | {"read_only": False}
        for name, value in now.items()
    }
    lock = LockSection(exposure="manual", shutter_s=0.002, aperture=5.6, iso=100)
    found = {one.name: defined[one.name].value_of(one.value) for one in changes(lock, widgets)}
    assert found == {"CAM_EXPMODE": "1", "CAM_SHUTTERSPD": "66036", "CAM_APERTURE": "560", "CAM_ISO": "100"}


@pytest.mark.parametrize("pack", [lzma.compress, gzip.compress])
def test_a_compressed_definition_is_read(pack: object) -> None:
    assert read_definition(pack(SONY)) == read_definition(SONY)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "no XML"),
        (b"<html></html>", "its root is <html>"),
        (b"<mavlinkcamera></mavlinkcamera>", "no parameters"),
        (SONY[:300], "no XML"),
        (b"\xff\xfe<\x00", "no UTF-8"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><mavlinkcamera/>', "document type"),
        (lzma.compress(SONY)[:20] + b"\0" * 40, "cannot be decompressed"),
        (gzip.compress(b" " * (5 << 20)), "larger than"),
        (lzma.compress(b" " * (5 << 20)), "larger than"),
    ],
)
def test_what_is_no_definition_is_refused_with_the_reason(data: bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        read_definition(data)


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        assert read_definition(data)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [("1", 1, 1), ("-3", 6, -3), ("268435506", 5, 268435506), ("0.004", 9, 0.004), ("0.1", 10, 0.1), ("4.0", 5, 4)],
)
def test_values_survive_the_wire(text: str, kind: int, value: float) -> None:
    raw = encoded(text, kind)
    assert len(raw) == 128
    assert decoded(raw, kind) == pytest.approx(value, rel=1e-6)
    assert Parameter(name="A", options=(("x", text),)).choice_of(decoded(raw, kind)) == "x"


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_float_is_told_as_it_is(value: float) -> None:
    raw = list(struct.pack("<f", value).ljust(128, b"\0"))
    assert decoded(raw, 9) == value
    assert decoded(encoded(repr(value), 9), 9) == value


@pytest.mark.parametrize(("text", "kind"), [("300", 1), ("-1", 5), ("0.5", 6), ("Auto", 9), ("1", 77), ("x" * 129, 11)])
def test_a_value_that_a_type_cannot_hold_is_refused(text: str, kind: int) -> None:
    with pytest.raises(ValueError, match=r".+"):
        encoded(text, kind)
    with pytest.raises(ValueError, match="unknown"):
        decoded([0] * 128, 77)


def test_a_text_is_a_text() -> None:
    assert decoded(encoded("abc", 11), 11) == "abc"
