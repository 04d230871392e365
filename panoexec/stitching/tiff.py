"""Writes a tiled TIFF of any size, tile by tile in any order; can continue after an interruption.

Classic TIFF up to 4 GB, BigTIFF beyond. Tiles are compressed by deflate with horizontal
differencing; pixels are RGB and alpha (255 where the panorama has content).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

TILE_PX: Final = 512
_CHANNELS: Final = 4
_CLASSIC_LIMIT: Final = 4_000_000_000
_SHORT, _LONG, _BYTE, _LONG8 = 3, 4, 1, 16


@dataclass(frozen=True, slots=True)
class TileEntry:
    """Position and size of a compressed tile in the file."""

    offset: int
    length: int


class TiledTiff:
    """A TIFF that is written tile by tile under a temporary name and gets its directory and its name at the end.

    Args:
        path: the finished file.
        size: (width, height) of the picture.
        tiles: tiles that an earlier run has written, by number (row by row); what follows the last one is cut off.
        big: BigTIFF; by default if the image could exceed the limit of a classic TIFF.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        *,
        tiles: Mapping[int, TileEntry] | None = None,
        big: bool | None = None,
    ) -> None:
        self.path = path
        self.part = path.with_name(path.name + ".part")
        self.size = size
        width, height = size
        self.columns, self.rows = -(-width // TILE_PX), -(-height // TILE_PX)
        self.big = width * height * _CHANNELS > _CLASSIC_LIMIT if big is None else big
        self.tiles: dict[int, TileEntry] = dict(tiles or {})
        start = max((entry.offset + entry.length for entry in self.tiles.values()), default=16)
        self._file = self.part.open("r+b" if self.tiles else "w+b")
        self._file.truncate(start)
        self._file.seek(start)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def write_tile(self, column: int, row: int, pixels: NDArray[np.uint8]) -> int:
        """Append a tile; one without any content takes about a kilobyte.

        Args:
            column: of the tile.
            row: of the tile.
            pixels: (≤ 512, ≤ 512, 4); tiles at the right and lower border may be smaller.

        Returns:
            The tile's number.
        """
        number = row * self.columns + column
        whole = np.zeros((TILE_PX, TILE_PX, _CHANNELS), dtype=np.uint8)
        whole[: pixels.shape[0], : pixels.shape[1]] = pixels
        whole[:, 1:] -= whole[:, :-1].copy()
        data = zlib.compress(whole.tobytes(), 4)
        self.tiles[number] = TileEntry(self._file.tell(), len(data))
        self._file.write(data)
        return number

    def flush(self) -> None:
        """Flush the written data to disk."""
        self._file.flush()
        os.fsync(self._file.fileno())

    def finish(self, xmp: str = "") -> None:
        """Write the directory and rename the file to its final name.

        Args:
            xmp: a packet to include.

        Raises:
            ValueError: a tile is missing.
        """
        count = self.columns * self.rows
        if len(self.tiles) != count:
            raise ValueError(f"{len(self.tiles)} of {count} tiles were written")
        entries = [self.tiles[number] for number in range(count)]
        end = self._file.seek(0, os.SEEK_END)
        self._file.write(b"\0" * (end % 2))
        offset_kind = _LONG8 if self.big else _LONG
        width, height = self.size
        fields: list[tuple[int, int, list[int] | bytes]] = [
            (256, _LONG, [width]),
            (257, _LONG, [height]),
            (258, _SHORT, [8] * _CHANNELS),
            (259, _SHORT, [8]),
            (262, _SHORT, [2]),
            (277, _SHORT, [_CHANNELS]),
            (284, _SHORT, [1]),
            (317, _SHORT, [2]),
            (322, _SHORT, [TILE_PX]),
            (323, _SHORT, [TILE_PX]),
            (324, offset_kind, [entry.offset for entry in entries]),
            (325, _LONG, [entry.length for entry in entries]),
            (338, _SHORT, [2]),
        ]
        if xmp:
            fields.append((700, _BYTE, xmp.encode()))
        directory = self._write_directory(sorted(fields, key=lambda field: field[0]))
        self._file.seek(0)
        header = (
            struct.pack("<2sHHHQ", b"II", 43, 8, 0, directory)
            if self.big
            else struct.pack("<2sHI", b"II", 42, directory)
        )
        self._file.write(header.ljust(16, b"\0"))
        self.flush()
        self._file.close()
        self.part.replace(self.path)

    def _write_directory(self, fields: list[tuple[int, int, list[int] | bytes]]) -> int:
        """Append long values and the directory itself; returns where the directory is."""
        forms = {_SHORT: "H", _LONG: "I", _LONG8: "Q"}
        room, pointer = (8, "Q") if self.big else (4, "I")
        lines = []
        for tag, kind, values in fields:
            data = values if isinstance(values, bytes) else struct.pack(f"<{len(values)}{forms[kind]}", *values)
            if len(data) > room:
                where = self._file.tell()
                self._file.write(data + b"\0" * (len(data) % 2))
                data = struct.pack(f"<{pointer}", where)
            lines.append(struct.pack(f"<HH{pointer}", tag, kind, len(values)) + data.ljust(room, b"\0"))
        directory = self._file.tell()
        self._file.write(struct.pack("<Q" if self.big else "<H", len(lines)) + b"".join(lines))
        self._file.write(b"\0" * room)
        return directory
