"""Which photo in the camera is whose: matches what a tethered camera lists with the triggers. Pure logic.

A photo is known by its path in the camera without the suffix, so that a RAW file and its JPEG are one photo. Events are
lost, and a call that hung may have released the shutter or not. A photo that is taken for another one would be proof of
a pose that it does not show. So a new photo belongs to a trigger only if that trigger is the only one that can have
taken it: one trigger waits for its photo, none before it may still bring one, and no further photo is new.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Final

from panoexec.adapters.camera.capture import Capture

JPEGS: Final = frozenset({".jpg", ".jpeg", ".jpe", ".heic", ".heif"})
"""Suffixes of files that show the photo without being developed."""
RAWS: Final = frozenset(
    {
        ".3fr",
        ".arw",
        ".cr2",
        ".cr3",
        ".crw",
        ".dng",
        ".iiq",
        ".nef",
        ".nrw",
        ".orf",
        ".pef",
        ".raf",
        ".raw",
        ".rw2",
        ".srw",
    }
)
SCHEME: Final = "gphoto2:"
"""What the URL of a file in a tethered camera begins with."""
AMBIGUOUS: Final = "the camera has photos that may belong to an earlier trigger: it cannot be told which one this is"


@dataclass(slots=True, kw_only=True)
class Photo:
    """A photo in the camera.

    Attributes:
        folder: in the camera.
        stem: name of its files without the suffix.
        suffixes: of its files, in the order in which they were seen.
    """

    folder: str
    stem: str
    suffixes: list[str] = field(default_factory=list)

    @property
    def file(self) -> str:
        """Name of the file to fetch: the JPEG if there is one."""
        jpegs = [one for one in self.suffixes if one.lower() in JPEGS]
        return self.stem + (jpegs or self.suffixes)[0]

    @property
    def url(self) -> str:
        """That file in the camera, as evidence names it."""
        return f"{SCHEME}{self.folder.rstrip('/')}/{self.file}"

    @property
    def urls(self) -> list[str]:
        """All its files in the camera."""
        return [f"{SCHEME}{self.folder.rstrip('/')}/{self.stem}{suffix}" for suffix in self.suffixes]

    @property
    def is_raw_only(self) -> bool:
        """Whether no file of it shows the photo as it is."""
        return not any(one.lower() in JPEGS for one in self.suffixes)


class PhotoBook:
    """All photos in the camera, and the triggers.

    Args:
        late_s: how long after a trigger its photo may come, on the mission's clock.

    Attributes:
        surplus: photos that no trigger can claim, or that more than one could.
        lost_triggers: triggers that brought no photo.
    """

    def __init__(self, late_s: float) -> None:
        self._late_s = late_s
        self.surplus: list[Photo] = []
        self.lost_triggers = 0
        self._photos: dict[tuple[str, str], Photo] = {}
        self._waiting: list[Capture] = []
        self._vanished: list[tuple[Capture, float]] = []
        self._unclaimed: list[Photo] = []

    @property
    def count(self) -> int:
        """Photos known to be in the camera."""
        return len(self._photos)

    @property
    def waiting(self) -> tuple[Capture, ...]:
        """Triggers that wait for their photo, oldest first."""
        return tuple(self._waiting)

    def find(self, url: str) -> Photo | None:
        """The photo with a file of this URL."""
        pure = PurePosixPath(url.removeprefix(SCHEME))
        return self._photos.get((str(pure.parent), pure.stem))

    def baseline(self, files: Iterable[tuple[str, str]]) -> None:
        """Take the first listing: photos that were there before."""
        for folder, name in files:
            self._enter(folder, name)
        self._unclaimed.clear()

    def sent(self, capture: Capture) -> None:
        """A trigger is about to be sent."""
        self._waiting.append(capture)

    def refused(self, capture: Capture) -> None:
        """The camera refused a trigger: it takes no photo."""
        if capture in self._waiting:
            self._waiting.remove(capture)

    def gave_up(self, capture: Capture, until_s: float) -> None:
        """A trigger brought no photo so far; one that comes before `until_s` may be its."""
        if capture in self._waiting:
            self._waiting.remove(capture)
            self._vanished.append((capture, until_s))
            self.lost_triggers += 1

    def doubt_until_s(self, now_s: float) -> float:
        """Until when a new photo may be that of a trigger that was given up; -inf if there is none."""
        self._forget(now_s)
        return max((until_s for _, until_s in self._vanished), default=-math.inf)

    def postpone(self, until_s: float) -> None:
        """The camera did not answer meanwhile: photos of earlier triggers may come until then."""
        self._vanished = [(one, max(until_s, before_s)) for one, before_s in self._vanished]

    def _forget(self, now_s: float) -> None:
        """Give up triggers whose photo cannot come any more."""
        self._vanished = [(one, until_s) for one, until_s in self._vanished if until_s > now_s]
        if self._unclaimed and not self._waiting:
            self._claim_by_nobody()

    def _claim_by_nobody(self) -> None:
        self.surplus += self._unclaimed
        del self._vanished[: len(self._unclaimed)]  # as many as triggers that brought none: it is over with those
        self._unclaimed = []

    def seen(self, files: Iterable[tuple[str, str]], now_s: float) -> list[tuple[Photo, Capture]]:
        """Take files that the camera told or lists; returns the photos that are now known to be a trigger's.

        Args:
            files: folder and name; known ones are ignored.
            now_s: on the mission's clock.
        """
        for folder, name in files:
            photo = self._enter(folder, name)
            if photo is not None:
                self._unclaimed.append(photo)
        return self._match(now_s)

    def _enter(self, folder: str, name: str) -> Photo | None:
        """Note a file; returns its photo if that is new."""
        pure = PurePosixPath(name)
        if pure.suffix.lower() not in JPEGS | RAWS:
            return None
        key = (str(PurePosixPath(folder)), pure.stem)
        known = self._photos.get(key)
        if known is not None:
            if pure.suffix not in known.suffixes:
                known.suffixes.append(pure.suffix)
            return None
        photo = Photo(folder=key[0], stem=pure.stem, suffixes=[pure.suffix])
        self._photos[key] = photo
        return photo

    def _match(self, now_s: float) -> list[tuple[Photo, Capture]]:
        self._forget(now_s)
        if not self._unclaimed:
            return []
        candidates = len(self._waiting) + len(self._vanished)
        if candidates == len(self._unclaimed):
            # every trigger brought its photo, in order
            late = len(self._vanished)
            self.surplus += self._unclaimed[:late]
            found = list(zip(self._unclaimed[late:], self._waiting, strict=True))
            self._waiting, self._vanished, self._unclaimed = [], [], []
            return found
        if not self._vanished and len(self._unclaimed) < len(self._waiting):
            return []  # the others are to come
        for capture in self._waiting:
            capture.contradict(AMBIGUOUS)
        if len(self._unclaimed) > candidates:
            self.surplus += self._unclaimed
            self._unclaimed, self._waiting = [], []
        return []
