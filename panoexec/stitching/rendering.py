"""Renders the panorama block by block: `nona` remaps, panoexec blends, counts holes and appends to the TIFF.

A block is finished when its record (`blocks/RRRR_CCCC.npz`) is on disk: the position of its tiles in the TIFF, its part
of the preview, and its counts for completeness. After an interruption, finished blocks are not rendered again.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from panoexec.files import write_atomically
from panoexec.formats.hugin_pto import PtoProject, render_pto
from panoexec.stitching.blending import Patch, blend
from panoexec.stitching.canvas import Block, View, block_side, blocks, image_depth, images_in_view, turned, view_of
from panoexec.stitching.completeness import BlockCount, Completeness, CompletenessCounter, Ground
from panoexec.stitching.gains import stored_gain
from panoexec.stitching.tiff import TILE_PX, TiledTiff, TileEntry
from panoexec.stitching.tools import ToolError, disk_error, run_tool

PREVIEW_WIDTH_PX: Final = 8192
_BLUR_FRACTION: Final = 1 / 150
"""Radius that separates detail from brightness, by an image's width on the canvas."""


@dataclass(frozen=True, slots=True)
class Rendered:
    """The panorama.

    Attributes:
        completeness: the result.
        preview: (h, w, 3) uint8, the whole canvas reduced by a whole factor.
        covered: (h, w) share of each preview pixel that is covered, 0 to 255.
    """

    completeness: Completeness
    preview: NDArray[np.uint8]
    covered: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class _Record:
    """The stored record of a finished block."""

    tiles: dict[int, TileEntry]
    preview: NDArray[np.uint8]
    covered: NDArray[np.uint8]
    count: BlockCount


class PanoramaRenderer:
    """Renders one aligned project into a TIFF.

    Args:
        project: aligned images; file names relative to `folder`.
        folder: the mission directory.
        work: folder of the records.
        target: the TIFF, which has a temporary name until it is complete.
        ground: what must be covered.
        memory_bytes: memory limit for blending.
        xmp: XMP packet for the TIFF.
        gains: factors of red, green and blue light of each image; none: 1.
    """

    def __init__(
        self, project: PtoProject, folder: Path, work: Path, *, target: Path, ground: Ground, memory_bytes: int,
        xmp: str = "", gains: Sequence[tuple[float, float, float]] = (),
    ) -> None:  # fmt: skip
        self._project = project
        self._folder = folder
        self._work = work
        self._records = work / "blocks"
        self._target = target
        self._part = target.with_name(target.name + ".part")
        self._xmp = xmp
        self._gains = [stored_gain(gain) for gain in gains]
        canvas = project.canvas_px
        self._blur = max(2, round(project.images[0].width_px * _BLUR_FRACTION * self._canvas_scale))
        self._margin = 2 * self._blur + 2
        self._side = block_side(memory_bytes, canvas[0], self._margin)
        self._factor = max(1, -(-canvas[0] // PREVIEW_WIDTH_PX))
        # blocks begin at multiples of 512: a factor that divides 512 keeps preview pixels whole
        self._factor = 1 << (self._factor - 1).bit_length()
        self._counter = CompletenessCounter(canvas, ground)

    @property
    def _canvas_scale(self) -> float:
        """Pixels of the canvas per pixel of the photos, at their centre."""
        return self._project.canvas_px[0] / (2 * np.pi * self._project.focal_length_px)

    def render(self, progress: Callable[[float, str], None]) -> None:
        """Render the missing blocks.

        Args:
            progress: called with a fraction and a text.

        Raises:
            ToolError: `nona` failed, or the disk is full.
        """
        todo = list(blocks(self._project.canvas_px, self._side))
        try:
            self._records.mkdir(exist_ok=True)
            records = self._read_all(todo) if self._part.exists() else {}
            tiles = {number: entry for record in records.values() for number, entry in record.tiles.items()}
            with TiledTiff(self._target, self._project.canvas_px, tiles=tiles) as tiff:
                for number, block in enumerate(todo):
                    progress(number / len(todo), f"block {number + 1} of {len(todo)}")
                    if block not in records:
                        self._render_block(block, tiff)
        except OSError as error:
            raise disk_error(self._work, error) from error

    def finish(self) -> Rendered:
        """Finish the TIFF and sum up the blocks; may be called again after an interruption.

        Raises:
            ToolError: blocks are missing, or the disk is full.
        """
        todo = list(blocks(self._project.canvas_px, self._side))
        records = self._read_all(todo)
        if len(records) != len(todo):
            raise ToolError(f"{self._work}: {len(todo) - len(records)} blocks of the panorama are missing")
        try:
            if self._part.exists():
                tiles = {number: entry for record in records.values() for number, entry in record.tiles.items()}
                with TiledTiff(self._target, self._project.canvas_px, tiles=tiles) as tiff:
                    tiff.finish(self._xmp)
        except OSError as error:
            raise disk_error(self._work, error) from error
        return self._collect(records)

    def _render_block(self, block: Block, tiff: TiledTiff) -> None:
        view = view_of(block, self._project.canvas_px, self._margin)
        project = turned(self._project, view)
        patches = self._remap(project, view)
        picture, covered = blend(
            (view.height, view.width),
            patches,
            lambda patch: image_depth(project, patch.number, view, patch.place),
            self._blur,
        )
        picture, covered = picture[view.inner], covered[view.inner]
        alpha = np.where(covered, np.uint8(255), np.uint8(0))
        pixels = np.concatenate([picture, alpha[..., None]], axis=-1)
        before = set(tiff.tiles)
        for top in range(0, block.height, TILE_PX):
            for left in range(0, block.width, TILE_PX):
                column, row = (block.left + left) // TILE_PX, (block.top + top) // TILE_PX
                tiff.write_tile(column, row, pixels[top : top + TILE_PX, left : left + TILE_PX])
        record = _Record(
            tiles={number: entry for number, entry in tiff.tiles.items() if number not in before},
            preview=_reduced(picture, covered, self._factor),
            covered=_reduced(alpha[..., None], np.ones_like(covered), self._factor)[..., 0],
            count=self._counter.count(block.left, block.top, covered),
        )
        # the tiles must be on disk before the record that refers to them
        tiff.flush()
        self._write(block, record)

    def _remap(self, project: PtoProject, view: View) -> list[Patch]:
        """Run `nona` for the images that touch a view."""
        numbers = images_in_view(project, view)
        if not numbers:
            return []
        folder = self._work / "remapped"
        folder.mkdir(exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        images = (project.images[number] for number in numbers)
        named = tuple(replace(image, file_name=str((self._folder / image.file_name).resolve())) for image in images)
        part = replace(project, images=named, control_points=(), optimise=())
        text = render_pto(part).replace('n"TIFF_m c:LZW r:CROP"', 'n"TIFF_m c:NONE r:CROP"')
        write_atomically(folder / "view.pto", text, sync=False)
        run_tool(["nona", "-o", "out", "view.pto"], folder)
        patches = []
        for place, number in enumerate(numbers):
            path = folder / f"out{place:04d}.tif"
            if path.exists():
                patches.append(_patch(path, number, view, self._gains[number] if self._gains else None))
                path.unlink()
        return patches

    def _collect(self, records: dict[Block, _Record]) -> Rendered:
        width, height = (-(-n // self._factor) for n in self._project.canvas_px)
        preview, covered = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.uint8)
        for block, record in records.items():
            h, w = record.covered.shape
            top, left = block.top // self._factor, block.left // self._factor
            preview[top : top + h, left : left + w] = record.preview
            covered[top : top + h, left : left + w] = record.covered
            self._counter.add(record.count)
        return Rendered(self._counter.result(), preview, covered)

    def _path(self, block: Block) -> Path:
        return self._records / f"{block.row:04d}_{block.column:04d}.npz"

    def _write(self, block: Block, record: _Record) -> None:
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            tiles=np.array([(n, e.offset, e.length) for n, e in record.tiles.items()], dtype=np.int64).reshape(-1, 3),
            preview=record.preview,
            covered=record.covered,
            ground_px=record.count.ground_px,
            weights=np.array([record.count.ground_weight, record.count.hole_weight]),
            cells=record.count.cells,
        )
        write_atomically(self._path(block), buffer.getvalue())

    def _read_all(self, todo: list[Block]) -> dict[Block, _Record]:
        return {block: record for block in todo if (record := self._read(block)) is not None}

    def _read(self, block: Block) -> _Record | None:
        """The record of a finished block; None if it is missing or damaged (then the block is rendered again)."""
        try:
            with np.load(self._path(block)) as data:
                return _Record(
                    tiles={int(n): TileEntry(int(o), int(size)) for n, o, size in data["tiles"]},
                    preview=data["preview"],
                    covered=data["covered"],
                    count=BlockCount(
                        ground_px=int(data["ground_px"]),
                        ground_weight=float(data["weights"][0]),
                        hole_weight=float(data["weights"][1]),
                        cells=data["cells"],
                    ),
                )
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None


def _patch(path: Path, number: int, view: View, gain: NDArray[np.uint8] | None) -> Patch:
    """The output of `nona`, placed in the view; `gain` are tables (3, 256) of stored values."""
    with PIL.Image.open(path) as picture:
        tags = picture.tag_v2  # type: ignore[attr-defined]
        pixels = np.array(picture)
        # positions are stored in inches
        left, top = (
            round(float(tags.get(place, 0)) * float(tags.get(unit, 1))) for place, unit in ((286, 282), (287, 283))
        )
    if gain is not None:
        for channel in range(3):
            pixels[..., channel] = gain[channel][pixels[..., channel]]
    return Patch(number, left - view.left, top - view.top, pixels[..., :3], pixels[..., 3] > 127)


def _reduced(picture: NDArray[np.uint8], weight: NDArray[np.bool_], factor: int) -> NDArray[np.uint8]:
    """Means of squares of `factor` pixels, by the weight; the border's squares may be smaller."""
    if factor == 1:
        return picture
    h, w, c = picture.shape
    padded = np.zeros((-(-h // factor) * factor, -(-w // factor) * factor, c + 1), dtype=np.uint32)
    padded[:h, :w, :c] = picture * weight[..., None]
    padded[:h, :w, c] = weight
    total = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor, c + 1).sum(axis=(1, 3))
    return np.asarray((total[..., :c] / np.maximum(total[..., c:], 1) + 0.5).astype(np.uint8))
