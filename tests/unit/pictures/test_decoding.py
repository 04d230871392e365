"""Photos are readable to their last byte, or the reason is told."""

from __future__ import annotations

import io
import random
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.pictures.decoding import UnreadableError, decode, decode_file, scan_end, scan_start


def jpeg(width: int = 320, height: int = 240, seed: int = 1, **options: Any) -> bytes:
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 255, (height // 8, width // 8, 3), dtype=np.uint8)
    image = PIL.Image.fromarray(small).resize((width, height), PIL.Image.Resampling.BICUBIC)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=90, **options)
    return buffer.getvalue()


WHOLE = jpeg()
START = scan_start(WHOLE)[1]
END = scan_end(WHOLE, START)


def test_a_whole_photo_is_decoded_at_the_scale_that_is_asked_for() -> None:
    photo = decode(WHOLE, 160)
    assert photo.grey.shape == (120, 160)
    assert (photo.width_px, photo.height_px) == (320, 240)
    with PIL.Image.open(io.BytesIO(WHOLE)) as image:
        expected = np.asarray(image.convert("L").resize((160, 120), PIL.Image.Resampling.BOX), dtype=float)
    assert np.abs(photo.grey - expected).mean() < 2


def test_a_smaller_photo_keeps_its_size() -> None:
    assert decode(WHOLE, 1000).grey.shape == (240, 320)


@pytest.mark.parametrize("options", [{"progressive": True}, {"restart_marker_blocks": 4}, {"subsampling": 0}])
def test_other_kinds_of_jpegs_are_whole_too(options: dict[str, Any]) -> None:
    assert decode(jpeg(**options), 1000).grey.shape == (240, 320)


def test_black_photos_are_readable() -> None:
    buffer = io.BytesIO()
    PIL.Image.new("RGB", (160, 120)).save(buffer, "JPEG")
    assert decode(buffer.getvalue(), 1000).grey.max() == 0


def test_data_after_the_end_do_not_matter() -> None:
    assert decode(WHOLE + b"preview" * 100, 1000).grey.shape == (240, 320)


@given(cut=st.integers(0, len(WHOLE) - 2))
def test_a_truncated_photo_is_unreadable_wherever_it_ends(cut: int) -> None:
    with pytest.raises(UnreadableError):
        decode(WHOLE[:cut], 1000)


@given(cut=st.integers(START, END - 12))
def test_an_end_marker_does_not_make_a_truncated_photo_whole(cut: int) -> None:
    with pytest.raises(UnreadableError):
        decode(WHOLE[:cut] + b"\xff\xd9", 1000)


@given(place=st.integers(START, END - 512), length=st.sampled_from([512, 2048]))
def test_zeros_in_the_picture_data_are_found(place: int, length: int) -> None:
    damaged = bytearray(WHOLE)
    damaged[place : min(END, place + length)] = bytes(min(END, place + length) - place)
    with pytest.raises(UnreadableError):
        decode(bytes(damaged), 1000)


def test_the_second_half_of_zeros_is_found() -> None:
    middle = (START + END) // 2
    with pytest.raises(UnreadableError, match="damaged"):
        decode(WHOLE[:middle] + bytes(END - middle) + WHOLE[END:], 1000)


def test_random_sectors_in_the_picture_data_are_found() -> None:
    rng = random.Random(3)
    found = 0
    for _ in range(60):
        damaged = bytearray(WHOLE)
        place = rng.randrange(START, END - 512)
        damaged[place : place + 512] = rng.randbytes(512)
        try:
            decode(bytes(damaged), 1000)
        except UnreadableError:
            found += 1
    assert found >= 59


def test_lost_sectors_are_found() -> None:
    rng = random.Random(4)
    for _ in range(30):
        place = rng.randrange(START, END - 1024)
        with pytest.raises(UnreadableError):
            decode(WHOLE[:place] + WHOLE[place + 512 :], 1000)


@pytest.mark.parametrize("content", [b"", b"\xff\xd8", b"not a photo", b"\xff\xd8\xff\xe0" + bytes(40)])
def test_what_is_no_photo_is_unreadable(content: bytes) -> None:
    with pytest.raises(UnreadableError):
        decode(content, 1000)


def test_a_missing_file_is_unreadable(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="cannot be read"):
        decode_file(tmp_path / "gone.jpg", 1000)
