"""The card of the simulated camera: folders and files by PTP handle. Files stay where they are on disk."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from panoexec.sim.tethered.ptp import ALL, STORE, Format, object_info

_RAW: Final = frozenset({".nef", ".arw", ".cr2", ".cr3", ".dng", ".raf"})
PER_FOLDER: Final = 999
"""Most files in one folder of DCIM, as DCF has it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CardObject:
    """A folder or a file.

    Attributes:
        handle: its PTP handle.
        parent: handle of its folder, 0 for the root.
        name: within its folder.
        path: the file on disk; None for a folder.
        size_bytes: as the camera tells it.
        time_s: when it was written, seconds since 1970 UTC.
    """

    handle: int
    parent: int
    name: str
    path: Path | None = None
    size_bytes: int = 0
    time_s: float = 0.0

    @property
    def form(self) -> int:
        """Object format code."""
        if self.path is None:
            return Format.FOLDER
        return Format.UNDEFINED if Path(self.name).suffix.lower() in _RAW else Format.JPEG

    def info(self) -> bytes:
        """ObjectInfo."""
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(self.time_s))
        return object_info(name=self.name, form=self.form, size_bytes=self.size_bytes, parent=self.parent, stamp=stamp)


class Card:
    """A card with a DCIM folder. What is on it stays, whoever connects and disconnects."""

    def __init__(self, *, size_bytes: int = 64 << 30) -> None:
        self.size_bytes = size_bytes
        self.read_only = False
        self._objects: dict[int, CardObject] = {}
        self._last = 0
        self._dcim = self._add(parent=0, name="DCIM").handle
        self._folder = 0
        self._in_folder = PER_FOLDER

    @property
    def files(self) -> list[CardObject]:
        """All files, oldest first."""
        return [one for one in self._objects.values() if one.path is not None]

    @property
    def used_bytes(self) -> int:
        """What the files take."""
        return sum(one.size_bytes for one in self._objects.values())

    def find(self, handle: int) -> CardObject | None:
        """The object with this handle."""
        return self._objects.get(handle)

    def handles(self, *, storage: int, form: int, parent: int) -> list[int] | None:
        """GetObjectHandles; None if there is no such storage.

        Args:
            storage: storage id, or `ALL`.
            form: format code, 0 for every one.
            parent: handle of a folder, `ALL` for the root, 0 for everything.
        """
        if storage not in {ALL, STORE}:
            return None
        wanted = [one for one in self._objects.values() if form in {0, one.form}]
        if parent:
            wanted = [one for one in wanted if one.parent == (0 if parent == ALL else parent)]
        return [one.handle for one in wanted]

    def add_file(self, path: Path, *, name: str, time_s: float, size_bytes: int | None = None) -> CardObject:
        """Put a file on the card, in the newest folder, or a new one if that is full.

        Args:
            path: the file on disk, which must stay as it is.
            name: on the card.
            time_s: when it was written, seconds since 1970 UTC.
            size_bytes: as the camera tells it; None: that of the file.
        """
        if self._in_folder >= PER_FOLDER:
            self._folder += 1
            self._in_folder = 0
            self._newest = self._add(parent=self._dcim, name=f"{99 + self._folder}PANOX").handle
        self._in_folder += 1
        size = path.stat().st_size if size_bytes is None else size_bytes
        return self._add(parent=self._newest, name=name, path=path, size_bytes=size, time_s=time_s)

    def _add(
        self, *, parent: int, name: str, path: Path | None = None, size_bytes: int = 0, time_s: float = 0.0
    ) -> CardObject:
        self._last += 1
        added = CardObject(handle=self._last, parent=parent, name=name, path=path, size_bytes=size_bytes, time_s=time_s)
        self._objects[added.handle] = added
        return added
