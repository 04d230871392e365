from __future__ import annotations

from pathlib import Path

import PIL.Image
import pytest

from panoexec.formats.jpeg_header import read_jpeg_header


def photo(path: Path, orientation: int | None = None, *, thumbnail: bool = False) -> Path:
    exif = PIL.Image.Exif()
    if orientation is not None:
        exif[0x010F] = "maker"
        exif[0x0112] = orientation
    extra = b"\xff\xd8\xff\xd9" if thumbnail else b""
    PIL.Image.effect_noise((64, 48), 60).save(path, "JPEG", exif=exif.tobytes() + extra if orientation else b"")
    return path


@pytest.mark.parametrize("orientation", [None, 1, 3, 6, 8])
def test_size_and_orientation(tmp_path: Path, orientation: int | None) -> None:
    header = read_jpeg_header(photo(tmp_path / "a.jpg", orientation))
    assert (header.width_px, header.height_px) == (64, 48)
    assert header.orientation == (orientation or 1)
    assert header.complete


def test_progressive_and_appended_data(tmp_path: Path) -> None:
    PIL.Image.effect_noise((40, 30), 60).save(tmp_path / "a.jpg", progressive=True)
    with (tmp_path / "a.jpg").open("ab") as file:
        file.write(b"preview" * 1000)
    header = read_jpeg_header(tmp_path / "a.jpg")
    assert (header.width_px, header.height_px, header.complete) == (40, 30, True)


def test_a_truncated_photo_is_incomplete_even_with_a_whole_thumbnail(tmp_path: Path) -> None:
    whole = photo(tmp_path / "a.jpg", 1, thumbnail=True).read_bytes()
    (tmp_path / "a.jpg").write_bytes(whole[: len(whole) * 2 // 3])
    assert not read_jpeg_header(tmp_path / "a.jpg").complete


def test_cut_off_headers_and_other_files(tmp_path: Path) -> None:
    whole = photo(tmp_path / "a.jpg", 1).read_bytes()
    path = tmp_path / "b.jpg"
    for content, text in (
        (b"", "not a JPEG"),
        (b"\x89PNG\r\n", "not a JPEG"),
        (whole[:10], "cut off"),
        (whole[:21], "cut off"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=text):
            read_jpeg_header(path)
    with pytest.raises(FileNotFoundError):
        read_jpeg_header(tmp_path / "none.jpg")


def test_nonsense_in_exif_is_upright(tmp_path: Path) -> None:
    buffer = photo(tmp_path / "a.jpg", 6).read_bytes()
    start = buffer.index(b"Exif\x00\x00") + 6
    (tmp_path / "b.jpg").write_bytes(buffer[:start] + b"XX" + buffer[start + 2 :])
    assert read_jpeg_header(tmp_path / "b.jpg").orientation == 1
    (tmp_path / "c.jpg").write_bytes(buffer[: start + 4] + b"\xff\xff\xff\x00" + buffer[start + 8 :])
    assert read_jpeg_header(tmp_path / "c.jpg").orientation == 1
