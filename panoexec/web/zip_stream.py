"""A zip archive of a folder as a stream of known length, which can begin anywhere: downloads resume after a lost link.

Files are stored, not compressed: photos are compressed already. The place of every byte follows from names and sizes
alone; the checksum of a file comes after its content, so that nothing has to be read before the first byte is sent
(APPNOTE.TXT of PKWARE, 4.3.9; zip64: 4.5.3).
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import stat
import struct
import time
import zlib
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from panoexec.errors import PanoexecError

_CHUNK: Final = 256 * 1024
# Windows has neither of the last two
_OPEN_FLAGS: Final = (
    os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
)
_FOUR_GB: Final = 0xFFFFFFFF
_MOST_ENTRIES: Final = 0xFFFF
_UTF8_AND_CRC_AFTER: Final = 0x0808
_UNIX: Final = 3 << 8
_VERSION: Final = 45
"""4.5: zip64."""


class FolderChangedError(PanoexecError):
    """A file changed while it was sent: the rest of the archive would not fit what was sent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Entry:
    name: bytes
    path: Path
    size: int
    stamp_ns: int
    offset: int

    @property
    def is_large(self) -> bool:
        return self.size >= _FOUR_GB

    @property
    def key(self) -> tuple[str, int, int]:
        return str(self.path), self.size, self.stamp_ns

    def moment(self) -> tuple[int, int]:
        """Time and date as MS-DOS has them, UTC; what is before 1980 becomes its beginning."""
        t = time.gmtime(max(self.stamp_ns // 10**9, 315_532_800))
        return t.tm_hour << 11 | t.tm_min << 5 | t.tm_sec // 2, (t.tm_year - 1980) << 9 | t.tm_mon << 5 | t.tm_mday

    def local_header(self) -> bytes:
        extra = struct.pack("<HHQQ", 1, 16, self.size, self.size) if self.is_large else b""
        size = _FOUR_GB if self.is_large else self.size
        flags = (_VERSION, _UTF8_AND_CRC_AFTER, 0, *self.moment(), 0, size, size, len(self.name), len(extra))
        return struct.pack("<IHHHHHIIIHH", 0x04034B50, *flags) + self.name + extra

    def descriptor(self, crc: int) -> bytes:
        return struct.pack("<IIQQ" if self.is_large else "<IIII", 0x08074B50, crc, self.size, self.size)

    def central_header(self, crc: int) -> bytes:
        fields = []
        if self.is_large:
            fields += [self.size, self.size]
        if self.offset >= _FOUR_GB:
            fields.append(self.offset)
        extra = struct.pack(f"<HH{len(fields)}Q", 1, 8 * len(fields), *fields) if fields else b""
        size = _FOUR_GB if self.is_large else self.size
        mode = (stat.S_IFREG | 0o644) << 16
        lengths = (len(self.name), len(extra), 0, 0, 0, mode, min(self.offset, _FOUR_GB))
        head = (_UNIX | _VERSION, _VERSION, _UTF8_AND_CRC_AFTER, 0, *self.moment(), crc, size, size)
        return struct.pack("<IHHHHHHIIIHHHHHII", 0x02014B50, *head, *lengths) + self.name + extra


@dataclass(slots=True, kw_only=True)
class ZipStream:
    """An archive that is made while it is sent.

    Attributes:
        size: of the archive, bytes.
        etag: changes with any name, size or time of a file.
        checksums: CRC-32 of files that were read whole, shared between streams.
    """

    size: int
    etag: str
    checksums: dict[tuple[str, int, int], int] = field(default_factory=dict)
    _entries: tuple[_Entry, ...] = ()

    async def read(self, start: int, stop: int) -> AsyncGenerator[bytes]:
        """The bytes from `start` up to `stop`.

        Raises:
            FolderChangedError: a file changed.
        """
        at = 0
        for entry in self._entries:
            parts = (len(entry.local_header()), entry.size, len(entry.descriptor(0)))
            if at + sum(parts) <= start:
                at += sum(parts)
                continue
            if at >= stop:
                return
            for piece in _cut(entry.local_header(), start - at, stop - at):
                yield piece
            at += parts[0]
            content = self._content(entry, max(0, start - at), min(entry.size, stop - at))
            async with aclosing(content):
                async for chunk in content:
                    yield chunk
            at += parts[1]
            if start < at + parts[2] and stop > at:
                for piece in _cut(entry.descriptor(await self._crc(entry)), start - at, stop - at):
                    yield piece
            at += parts[2]
        if stop > at:
            crcs = [await self._crc(entry) for entry in self._entries]
            for piece in _cut(_ending(self._entries, crcs, at), start - at, stop - at):
                yield piece

    async def _content(self, entry: _Entry, start: int, stop: int) -> AsyncGenerator[bytes]:
        if start >= stop:
            return
        file = await asyncio.to_thread(_opened, entry)
        crc, at = 0, start
        try:
            os.lseek(file, start, os.SEEK_SET)
            while at < stop:
                chunk = await asyncio.to_thread(os.read, file, min(_CHUNK, stop - at))
                if not chunk:
                    raise FolderChangedError(f"{entry.path.name} became shorter")
                crc = zlib.crc32(chunk, crc)
                at += len(chunk)
                yield chunk
        finally:
            os.close(file)
        if start == 0 and stop == entry.size:
            self.checksums[entry.key] = crc

    async def _crc(self, entry: _Entry) -> int:
        crc = self.checksums.get(entry.key)
        if crc is None:
            crc = 0 if not entry.size else await asyncio.to_thread(_crc_of, entry)
            self.checksums[entry.key] = crc
        return crc


def zip_stream(folder: Path, *, name: str, checksums: dict[tuple[str, int, int], int] | None = None) -> ZipStream:
    """Plan the archive of a folder; blocks.

    Hidden files, links and SQLite's shared memory are left out.

    Args:
        folder: its regular files go in, in the order of their names.
        name: of the folder in the archive.
        checksums: known from earlier streams.
    """
    entries: list[_Entry] = []
    at, told = 0, hashlib.sha256()
    for path, relative in sorted(_files(folder, ""), key=lambda item: item[1]):
        try:
            status = path.lstat()
        except OSError:
            continue
        if not stat.S_ISREG(status.st_mode):
            continue
        coded = f"{name}/{relative}".encode(errors="replace")
        entry = _Entry(name=coded, path=path, size=status.st_size, stamp_ns=status.st_mtime_ns, offset=at)
        entries.append(entry)
        told.update(f"{relative}|{entry.size}|{entry.stamp_ns}\n".encode(errors="replace"))
        at += len(entry.local_header()) + entry.size + len(entry.descriptor(0))
    size = at + len(_ending(tuple(entries), [0] * len(entries), at))
    return ZipStream(
        size=size,
        etag=f'"{told.hexdigest()[:32]}"',
        checksums={} if checksums is None else checksums,
        _entries=tuple(entries),
    )


def _files(folder: Path, prefix: str) -> Iterator[tuple[Path, str]]:
    with os.scandir(folder) as found:
        for one in found:
            if one.name.startswith(".") or one.name.endswith("-shm"):
                continue
            if one.is_dir(follow_symlinks=False):
                yield from _files(Path(one.path), f"{prefix}{one.name}/")
            else:
                yield Path(one.path), prefix + one.name


def _ending(entries: tuple[_Entry, ...], crcs: list[int], at: int) -> bytes:
    central = b"".join(entry.central_header(crc) for entry, crc in zip(entries, crcs, strict=True))
    count, tail = len(entries), b""
    if count >= _MOST_ENTRIES or at >= _FOUR_GB or len(central) >= _FOUR_GB:
        record = (44, _UNIX | _VERSION, _VERSION, 0, 0, count, count, len(central), at)
        tail = struct.pack("<IQHHIIQQQQ", 0x06064B50, *record)
        tail += struct.pack("<IIQI", 0x07064B50, 0, at + len(central), 1)
    few = min(count, _MOST_ENTRIES)
    ends = (0, 0, few, few, min(len(central), _FOUR_GB), min(at, _FOUR_GB), 0)
    return central + tail + struct.pack("<IHHHHIIH", 0x06054B50, *ends)


def _cut(data: bytes, start: int, stop: int) -> Iterator[bytes]:
    piece = data[max(0, start) : max(0, stop)]
    if piece:
        yield piece


def _opened(entry: _Entry) -> int:
    try:
        file = os.open(entry.path, _OPEN_FLAGS)
    except OSError as error:
        raise FolderChangedError(f"{entry.path.name}: {error.strerror}") from error
    status = os.fstat(file)
    if (status.st_size, status.st_mtime_ns) != (entry.size, entry.stamp_ns):
        os.close(file)
        raise FolderChangedError(f"{entry.path.name} changed")
    return file


def _crc_of(entry: _Entry) -> int:
    file, crc = _opened(entry), 0
    try:
        while chunk := os.read(file, 1 << 20):
            crc = zlib.crc32(chunk, crc)
    finally:
        os.close(file)
    return crc
