"""EXIF that is damaged, or nonsense: it tells nothing then, and no photo of it stops anything."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.formats.exif import Exif, exif_of

TEXTS: dict[int, bytes] = {0x9003: b"2026:02:28 23:59:58", 0x9291: b"325", 0x9011: b"+02:30"}


def a_tiff(texts: Mapping[int, bytes] = TEXTS) -> bytes:
    """A TIFF header, its first directory, the EXIF directory with these texts, and their content."""
    start = 8 + 2 + 12 + 4
    at = start + 2 + 12 * len(texts) + 4
    entries, content = b"", b""
    for tag, text in sorted(texts.items()):
        told = text.ljust(4, b"\0") + b"\0"  # five bytes and more are beside the directory
        entries += struct.pack("<HHII", tag, 2, len(told), at + len(content))
        content += told
    first = struct.pack("<H", 1) + struct.pack("<HHII", 0x8769, 4, 1, start) + bytes(4)
    return b"II*\0" + struct.pack("<I", 8) + first + struct.pack("<H", len(texts)) + entries + bytes(4) + content


def test_time_and_zone_are_read() -> None:
    told = exif_of(a_tiff())
    assert told.taken_s % 60 == pytest.approx(58.325)
    assert (told.resolution_s, told.zone_s) == (0.001, 9000.0)
    assert exif_of(a_tiff({0x9011: b"-11:00"})).zone_s == -39600.0


def test_one_flipped_bit_anywhere_raises_nothing() -> None:
    """`+02:30` with a flipped bit was `+0²:30`, whose `²` counts as a digit and is no number."""
    whole = a_tiff()
    for bit in range(8 * len(whole)):
        data = bytearray(whole)
        data[bit // 8] ^= 1 << bit % 8
        assert isinstance(exif_of(bytes(data)), Exif)


@pytest.mark.parametrize("zone", ["+0²:30", "+02:3", "+02:3O", "+99999999999999999999:00", "02:30", "+:", "+02:60"])
def test_a_zone_that_is_none(zone: str) -> None:
    assert math.isnan(exif_of(a_tiff({0x9011: zone.encode("latin-1")})).zone_s)


@given(st.dictionaries(st.sampled_from([0x9003, 0x9291, 0x9011, 0x010F]), st.binary(max_size=40), max_size=4))
def test_texts_of_any_kind_raise_nothing(texts: dict[int, bytes]) -> None:
    assert isinstance(exif_of(a_tiff(texts)), Exif)


def test_a_fraction_of_any_length_raises_nothing() -> None:
    told = exif_of(a_tiff(TEXTS | {0x9291: b"3" * 5000}))
    assert told.taken_s % 60 == pytest.approx(58.333333, abs=1e-5)
    assert told.resolution_s > 0
