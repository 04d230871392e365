"""Brings the files of accepted photos into the mission directory, newest first, one at a time.

While a mission flies it is one of the session's tasks; what is missing at its end is brought after landing, by another
collector on the same journal. A file that cannot be brought is tried again, ever more rarely.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

import structlog

from panoexec.errors import PanoexecError, PhotoFileError
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.protocols import PhotoFetcher
from panoexec.store.photo_store import PhotoNotRecordedError, PhotoRefusedError, PhotoSource, PhotoStore

INCOMING: Final = ".incoming"
"""Folder of a mission directory for parts of files."""

_FIRST_PAUSE_S: Final = 1.0
_LONGEST_PAUSE_S: Final = 20.0
_TRIES: Final = 12
_REFUSED_TRIES: Final = 3

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Wanted:
    """A photo whose file is not here yet.

    Attributes:
        shot: index of the shot.
        attempt: number of its accepted attempt.
        photo: number of the photo within the attempt.
        url: as told by the camera.
        seq: of the event that began the attempt.
    """

    shot: int
    attempt: int
    photo: int
    url: str
    seq: int


@dataclass(slots=True)
class _Trouble:
    tries: int
    next_s: float
    problem: str
    refused: bool = False


def wanted_files(record: MissionRecord) -> list[Wanted]:
    """The photos of accepted attempts whose camera told a file that is not here yet; newest first."""
    found = [
        Wanted(index, attempt.number, photo.number, photo.file, attempt.seq)
        for index, shot in record.shots.items()
        for attempt in shot.attempts
        if attempt.verdict is Verdict.ACCEPTED
        for photo in attempt.photos
        if photo.file and photo.number not in attempt.stored
    ]
    return sorted(found, key=lambda one: one.seq, reverse=True)


class LocalFiles:
    """Files on this computer, below given folders; implements `PhotoFetcher`."""

    source = "local"

    def __init__(self, folders: Iterable[Path]) -> None:
        """Describe it: `folders` are the only ones that files are taken from."""
        self._folders = tuple(folders)

    def takes(self, url: str) -> bool:
        """See `PhotoFetcher.takes`."""
        return url.startswith("file:")

    async def fetch(self, url: str, part: Path) -> Path:
        """See `PhotoFetcher.fetch`."""
        del part
        return await asyncio.to_thread(self._found, url)

    def _found(self, url: str) -> Path:
        parts = urlsplit(url)
        path = Path(unquote(parts.path)).resolve()
        inside = any(path.is_relative_to(folder.resolve()) for folder in self._folders)
        if not inside or parts.netloc not in {"", "localhost"}:
            raise PhotoFileError(f"{url}: is below no folder of [camera] file_folders", final=True)
        if not path.is_file():
            raise PhotoFileError(f"{path}: there is no such file yet")
        return path


class PhotoCollector:
    """Collects the files of one mission; an event sink, so that it notices new photos."""

    def __init__(
        self, folder: Path, *, record: MissionRecord, store: PhotoStore, fetchers: Sequence[PhotoFetcher]
    ) -> None:
        """Create it.

        Args:
            folder: the mission directory.
            record: of the mission.
            store: of its photos.
            fetchers: ways to bring files here.
        """
        self._incoming = folder / INCOMING
        self._record = record
        self._store = store
        self._fetchers = tuple(fetchers)
        self._news = asyncio.Event()
        self._trouble: dict[Wanted, _Trouble] = {}

    def publish(self, event: ev.Event) -> None:
        """See `EventSink.publish`."""
        if getattr(event, "photos", None):
            self._news.set()

    @property
    def remaining(self) -> list[Wanted]:
        """What can still be brought."""
        return [one for one in self._known() if not self._is_given_up(one)]

    @property
    def problems(self) -> dict[Wanted, str]:
        """Why files have not been brought yet, in order."""
        return {one: found.problem for one in self._known() if (found := self._trouble.get(one)) is not None}

    def refused(self) -> dict[tuple[int, int], str]:
        """Files that are no photos of their shots for good, by shot and attempt, with the reason."""
        return {
            (one.shot, one.attempt): found.problem
            for one, found in self._trouble.items()
            if found.refused and found.tries >= _TRIES
        }

    async def run(self) -> None:
        """Bring files until cancelled."""
        while True:
            self._news.clear()
            if not await self._next():
                return
            if not self._due() and not self._news.is_set():
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(self._pause_s()):
                        await self._news.wait()

    async def run_until_done(self, after_each: Callable[[], Awaitable[None]]) -> None:
        """Bring what can be brought.

        Args:
            after_each: awaited after each stored file.
        """
        while self.remaining:
            if self._due():
                await self._next()
                await after_each()
            else:
                await asyncio.sleep(self._pause_s() or 0.0)

    async def _next(self) -> bool:
        """Bring the newest file that is due; False if the mission takes no more."""
        due = self._due()
        if not due:
            return True
        one = due[0]
        fetcher = next(fetcher for fetcher in self._fetchers if fetcher.takes(one.url))
        part = self._incoming / f"{one.shot}-{one.attempt}-{one.photo}"
        try:
            await asyncio.to_thread(self._incoming.mkdir, exist_ok=True)
            path = await fetcher.fetch(one.url, part)
            stored = await self._store.store(
                path,
                shot=one.shot,
                attempt=one.attempt,
                photo=one.photo,
                name=unquote(urlsplit(one.url).path) if "://" in one.url and "[" not in one.url else one.url,
                source=_source(fetcher),
                how="move" if path == part else "copy",
            )
        except PhotoNotRecordedError:
            return False
        except (PanoexecError, OSError) as error:
            if isinstance(error, PhotoRefusedError):
                part.unlink(missing_ok=True)
            self._note(one, error)
        else:
            self._trouble.pop(one, None)
            _log.info("photo stored", shot=one.shot, attempt=one.attempt, file=stored.file, bytes=stored.size_bytes)
        if not self._known():
            with contextlib.suppress(OSError):
                await asyncio.to_thread(_removed, self._incoming)
        return True

    def _note(self, one: Wanted, error: Exception) -> None:
        tries = 1 if (earlier := self._trouble.get(one)) is None else earlier.tries + 1
        if (isinstance(error, PhotoFileError) and error.final) or (
            isinstance(error, PhotoRefusedError) and tries >= _REFUSED_TRIES
        ):
            tries = _TRIES
        pause_s = min(_FIRST_PAUSE_S * 2 ** (tries - 1), _LONGEST_PAUSE_S)
        refused = isinstance(error, PhotoRefusedError)
        self._trouble[one] = _Trouble(tries, time.monotonic() + pause_s, str(error), refused)
        if tries in {3, _TRIES}:
            _log.warning("photo not brought", shot=one.shot, problem=str(error), given_up=tries >= _TRIES)

    def _known(self) -> list[Wanted]:
        return [one for one in wanted_files(self._record) if any(fetcher.takes(one.url) for fetcher in self._fetchers)]

    def _is_given_up(self, one: Wanted) -> bool:
        return one in self._trouble and self._trouble[one].tries >= _TRIES

    def _due(self) -> list[Wanted]:
        now = time.monotonic()
        return [one for one in self.remaining if one not in self._trouble or self._trouble[one].next_s <= now]

    def _pause_s(self) -> float | None:
        """Until the next file is due; None if nothing is waited for."""
        moments = [self._trouble[one].next_s for one in self.remaining if one in self._trouble]
        return max(0.0, min(moments) - time.monotonic()) if moments else None


def _source(fetcher: PhotoFetcher) -> PhotoSource:
    match fetcher.source:
        case "http" | "mavftp" | "local" | "gphoto2" as source:
            return source
    raise AssertionError(fetcher.source)


def _removed(folder: Path) -> None:
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
