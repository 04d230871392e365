from __future__ import annotations

from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from numpy.typing import NDArray

from panoexec.stitching.tiff import TILE_PX, TiledTiff

SIZE = (1300, 700)


def picture() -> NDArray[np.uint8]:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    out = np.stack([x % 256, y % 256, (x * y) % 251, np.where(x > 600, 255, 0)], axis=-1)
    return out.astype(np.uint8)


def write(tiff: TiledTiff, pixels: NDArray[np.uint8], rows: range) -> None:
    for row in rows:
        for column in range(tiff.columns):
            top, left = row * TILE_PX, column * TILE_PX
            tiff.write_tile(column, row, pixels[top : top + TILE_PX, left : left + TILE_PX])


@pytest.mark.parametrize("big", [False, True])
def test_other_programs_read_it(tmp_path: Path, big: bool) -> None:
    path = tmp_path / "a.tif"
    with TiledTiff(path, SIZE, big=big) as tiff:
        write(tiff, picture(), range(tiff.rows))
        assert not path.exists()
        tiff.finish("<x:xmpmeta/>")
    assert path.read_bytes()[2] == (43 if big else 42)
    with PIL.Image.open(path) as found:
        assert found.size == SIZE
        assert found.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(found), picture())
        assert b"xmpmeta" in bytes(found.tag_v2[700])  # type: ignore[attr-defined]
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


def test_size_decides_the_kind(tmp_path: Path) -> None:
    with TiledTiff(tmp_path / "a.tif", (30000, 15000)) as tiff:
        assert not tiff.big
    with TiledTiff(tmp_path / "b.tif", (88280, 44140)) as tiff:
        assert tiff.big


def test_an_interrupted_file_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with TiledTiff(path, SIZE) as tiff:
        write(tiff, picture(), range(1))
        tiff.flush()
        known = dict(tiff.tiles)
        # what a crash leaves: half a tile that nobody recorded
        tiff.write_tile(0, 1, picture()[:100, :100])
    with TiledTiff(path, SIZE, tiles=known) as tiff:
        write(tiff, picture(), range(1, tiff.rows))
        tiff.finish()
    with PIL.Image.open(path) as found:
        np.testing.assert_array_equal(np.asarray(found), picture())


def test_missing_tiles_are_noticed(tmp_path: Path) -> None:
    with TiledTiff(tmp_path / "a.tif", SIZE) as tiff:
        write(tiff, picture(), range(1))
        with pytest.raises(ValueError, match="3 of 6 tiles"):
            tiff.finish()
    assert not (tmp_path / "a.tif").exists()
