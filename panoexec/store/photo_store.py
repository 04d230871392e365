"""Photos in the mission directory: written whole, under their final name, with their hash, then told as an event.

Everything that brings photos here stores them by `PhotoStore`: the camera's files while the mission flies, what is
fetched after landing, the import of a card. A file appears below `images/` at once or not at all; `photo_stored`
follows it in the journal. A process that is killed between the two leaves a file without an event: the same photo
stored again finds it and adds the event.

Copying and hashing run in one thread beside the event loop; both leave the interpreter to others meanwhile. The thread
has no lower priority: one that is not scheduled while it holds the interpreter would stop the event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Final, Literal, TypeAlias

from panoexec.errors import PanoexecError, UsageError
from panoexec.files import to_disk, write_atomically_with
from panoexec.formats.photo_kind import photo_kind
from panoexec.formats.photo_settings import PhotoExif, differences, read_settings, read_taken
from panoexec.mission.log.events import PhotoStored
from panoexec.mission.log.record import MissionRecord

MAX_PHOTO_BYTES: Final = 256 * 1024 * 1024
"""The largest file that counts as a photo."""

PhotoSource: TypeAlias = Literal["gphoto2", "http", "mavftp", "local", "import"]
"""Where a photo's file came from."""

_FOLDER: Final = "images"
_CHUNK_BYTES: Final = 1 << 20
_ODD = re.compile(r"[^A-Za-z0-9._ +()-]|^[.]+")


class PhotoRefusedError(PanoexecError):
    """A file is not stored: no image, cut off, too large, of another size than told, or the photo of another shot."""


class PhotoNotRecordedError(PanoexecError):
    """The file is stored, but the mission takes no more events: store it again when its journal can be opened."""


@dataclass(frozen=True, slots=True)
class _Written:
    """A file at its final name."""

    name: str
    size_bytes: int
    sha256: str
    exif: PhotoExif | None
    taken: tuple[float, float]


class PhotoStore:
    """Stores the photos of one mission; for one event loop, closed by `close`."""

    def __init__(
        self, folder: Path, *, record: MissionRecord, emit: Callable[[PhotoStored], PhotoStored | None]
    ) -> None:
        """Create it.

        Args:
            folder: the mission directory.
            record: of the mission: which files are stored already.
            emit: records the event; returns None if the mission takes no more.
        """
        self._folder = folder
        self._record = record
        self._emit = emit
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="photos")

    def close(self) -> None:
        """End the thread after its current file."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def stored(self, shot: int, attempt: int, photo: int = 1) -> PhotoStored | None:
        """The stored file of a photo; None without one.

        Raises:
            LookupError: the mission has no such attempt.
        """
        return self._record.shots[shot].attempts[attempt - 1].stored.get(photo)

    async def store(
        self,
        content: bytes | Path,
        *,
        shot: int,
        attempt: int,
        photo: int = 1,
        name: str,
        source: PhotoSource,
        raw: Path | None = None,
        expected_bytes: int | None = None,
        how: Literal["copy", "move", "link"] = "copy",
    ) -> PhotoStored:
        """Store the file of a photo and record it.

        A photo that is stored already with the same content stays, and its event is returned. A name that another
        photo has gets shot and attempt appended.

        Args:
            content: the file's bytes, or a file; one that lies below `images/` already is hashed where it is.
            shot: index of the shot.
            attempt: number of the attempt at it.
            photo: number of the photo within the attempt.
            name: as the camera names it; folders and characters that file names cannot have are dropped.
            source: where it came from.
            raw: the RAW file of the same photo; it gets the name of the stored one, with its own suffix.
            expected_bytes: the size that the camera told; None if it told none.
            how: what happens to a file: `move` removes it, `link` makes a hard link, else a copy.

        Raises:
            PhotoRefusedError: it is no whole image of at most `MAX_PHOTO_BYTES`, or another attempt has this content.
            PhotoNotRecordedError: the mission takes no more events.
            UsageError: it cannot be read or written; the message names the file.
            LookupError: the mission has no such attempt.
        """
        earlier = self.stored(shot, attempt, photo)
        final = _file_name(name, shot, attempt)
        alternative = f"{PurePosixPath(final).stem}-{shot:04d}-{attempt}-{photo}{PurePosixPath(final).suffix}"
        taken = self._taken(besides=(shot, attempt, photo))
        work = _Work(self._folder, content, (final, alternative), expected_bytes, how, taken)
        written = await asyncio.get_running_loop().run_in_executor(self._pool, work)
        file = f"{_FOLDER}/{written.name}"
        beside = None
        if raw is not None:
            raw_name = f"{PurePosixPath(written.name).stem}{raw.suffix}"
            raw_work = _Work(self._folder, raw, (raw_name,), None, how, taken)
            beside = await asyncio.get_running_loop().run_in_executor(self._pool, raw_work)
        is_same = earlier is not None and (earlier.sha256, earlier.file) == (written.sha256, file)
        if earlier is not None and is_same and (beside is None or earlier.raw_sha256 == beside.sha256):
            return earlier
        event = PhotoStored(
            shot=shot,
            attempt=attempt,
            photo=photo,
            file=file,
            size_bytes=written.size_bytes,
            sha256=written.sha256,
            source=source,
            raw="" if beside is None else f"{_FOLDER}/{beside.name}",
            raw_sha256="" if beside is None else beside.sha256,
            exif=written.exif,
            differs=self._differences(written.exif, besides=(shot, attempt, photo)),
            taken_s=written.taken[0],
            taken_resolution_s=written.taken[1],
        )
        why = self._record.times.judge(shot, self._record.shots[shot].attempts[attempt - 1], event)
        event = replace(event, contradiction=why)
        recorded = self._emit(event)
        if recorded is None:
            raise PhotoNotRecordedError(f"{self._folder / file}: stored, but the mission takes no more events")
        return recorded

    def _differences(self, exif: PhotoExif | None, *, besides: tuple[int, int, int]) -> tuple[str, ...]:
        """In what the settings of a photo differ from those of the first photo that was stored."""
        others = [one for one in stored_photos(self._record) if (one.shot, one.attempt, one.photo) != besides]
        # the photos of a bracket differ on purpose: each is compared with the first of its number
        told = [(one.seq, one.exif) for one in others if one.exif is not None and one.photo == besides[2]]
        return () if exif is None or not told else differences(min(told, key=lambda one: one[0])[1], exif)

    def _taken(self, *, besides: tuple[int, int, int]) -> dict[str, tuple[str, tuple[int, int, int]]]:
        """Content and owner of the files of all other photos, by file."""
        return {
            file: (digest, owner)
            for event in stored_photos(self._record)
            if (owner := (event.shot, event.attempt, event.photo)) != besides
            for file, digest in ((event.file, event.sha256), (event.raw, event.raw_sha256))
            if file
        }


def stored_photos(record: MissionRecord) -> Iterable[PhotoStored]:
    """All stored files of a mission."""
    for shot in record.shots.values():
        for attempt in shot.attempts:
            yield from attempt.stored.values()


def hash_file(path: Path) -> tuple[int, str]:
    """Size and SHA-256 of a file.

    Raises:
        OSError: it cannot be read.
    """
    size, digest = 0, hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            size += len(chunk)
            digest.update(chunk)
    return size, digest.hexdigest()


def _file_name(name: str, shot: int, attempt: int) -> str:
    """The last part of a name that a camera told, with characters that every file system takes."""
    base = PurePosixPath(name.replace("\\", "/")).name
    clean = _ODD.sub("_", base)[-120:]
    return clean if PurePosixPath(clean).suffix else f"shot_{shot:04d}_{attempt}{clean and '_'}{clean}.jpg"


@dataclass(frozen=True, slots=True)
class _Work:
    """Checks, hashes and writes one file; blocks."""

    folder: Path
    content: bytes | Path
    names: tuple[str, ...]
    expected_bytes: int | None
    how: str
    taken: dict[str, tuple[str, tuple[int, int, int]]]

    def __call__(self) -> _Written:
        images = self.folder / _FOLDER
        try:
            images.mkdir(exist_ok=True)
            self._check_size(len(self.content) if isinstance(self.content, bytes) else self.content.stat().st_size)
        except OSError as error:
            raise _unusable(error, self.content if isinstance(self.content, Path) else images) from error
        if isinstance(self.content, Path) and self.content.resolve().parent == images.resolve():
            return self._in_place(self.content)
        written = self._under_a_free_name(images)
        if self.how == "move" and isinstance(self.content, Path):
            with contextlib.suppress(OSError):  # a card that is write-protected: the photo is safe in both places
                self.content.unlink(missing_ok=True)
        return written

    def _under_a_free_name(self, images: Path) -> _Written:
        for name in self.names:
            target = images / name
            if f"{_FOLDER}/{name}" in self.taken:
                continue
            if not target.exists():
                return self._write(target)
            if target.is_file() and self._is_same(target):
                return self._in_place(target)
        raise UsageError(f"{images / self.names[-1]}: there is another file of this name already; move it away")

    def _write(self, target: Path) -> _Written:
        if self.how == "link" and isinstance(self.content, Path):
            written = self._examined(self.content, target.name)
            with contextlib.suppress(OSError):  # another file system, or one without hard links: copied
                os.link(self.content, target)
                to_disk(target.parent)
                return written
        if self.how == "move" and isinstance(self.content, Path) and _same_device(self.content, target.parent):
            written = self._examined(self.content, target.name)
            to_disk(self.content)
            self.content.replace(target)
            to_disk(target.parent)
            return written
        out: list[_Written] = []

        def write(path: Path) -> None:
            out.append(self._copied(path, target.name))

        write_atomically_with(target, write)
        return out[0]

    def _copied(self, path: Path, name: str) -> _Written:
        with path.open("wb") as write:
            for chunk in self._chunks():
                write.write(chunk)
        return self._examined(path, name)

    def _chunks(self) -> Iterator[bytes]:
        if isinstance(self.content, bytes):
            yield self.content
            return
        try:
            with self.content.open("rb") as read:
                while chunk := read.read(_CHUNK_BYTES):
                    yield chunk
        except OSError as error:  # not an error of the file that is written
            raise _unusable(error, self.content) from error

    def _in_place(self, path: Path) -> _Written:
        try:
            written = self._examined(path, path.name)
            to_disk(path)
        except OSError as error:
            raise _unusable(error, path) from error
        return written

    def _examined(self, path: Path, name: str) -> _Written:
        try:
            photo_kind(path)
        except ValueError as error:
            raise PhotoRefusedError(f"{self._shown(name)}: {error}") from error
        size, digest = hash_file(path)
        self._check_size(size)
        for file, (other, (shot, attempt, _)) in self.taken.items():
            if other == digest:
                raise PhotoRefusedError(
                    f"{self._shown(name)}: is the photo of shot {shot}, attempt {attempt}, too ({file});"
                    " one photo counts once"
                )
        return _Written(name, size, digest, read_settings(path), read_taken(path))

    def _is_same(self, target: Path) -> bool:
        if isinstance(self.content, bytes):
            return target.stat().st_size == len(self.content) and target.read_bytes() == self.content
        return target.stat().st_size == self.content.stat().st_size and hash_file(target) == hash_file(self.content)

    def _check_size(self, size: int) -> None:
        if size > MAX_PHOTO_BYTES:
            raise PhotoRefusedError(f"{self._shown()}: has {size} bytes, at most {MAX_PHOTO_BYTES} are accepted")
        if self.expected_bytes is not None and size != self.expected_bytes:
            raise PhotoRefusedError(f"{self._shown()}: has {size} bytes, the camera told {self.expected_bytes}")

    def _shown(self, name: str = "") -> str:
        return str(self.content) if isinstance(self.content, Path) else name or self.names[0]


def _same_device(path: Path, folder: Path) -> bool:
    return path.stat().st_dev == folder.stat().st_dev


def _unusable(error: OSError, path: Path) -> UsageError:
    return UsageError(f"{error.filename or path}: {error.strerror or type(error).__name__}")
