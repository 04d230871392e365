"""Interfaces that the executor needs besides the devices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from panoexec.angles import FloatArray
from panoexec.devices import RecalledPhotos
from panoexec.mission.log.events import Event
from panoexec.planning.model import Certificate, Shot


class Journal(Protocol):
    """Stores events durably."""

    async def append(self, events: Sequence[Event]) -> None:
        """Return when all of them are on disk, in this order, or raise and store none.

        Raises:
            MissionError: the journal cannot be written.
        """
        ...


class Verifier(Protocol):
    """Certifies measured attitudes; heavy work, done outside the event loop."""

    async def certify(self, rotations: FloatArray, rows: Sequence[int]) -> Certificate:
        """The certificate of measured attitudes.

        Args:
            rotations: camera to plan frame (n, 3, 3), one per accepted shot.
            rows: the row of each.
        """
        ...

    async def patch(self, rotations: FloatArray, rows: Sequence[int]) -> Sequence[Shot]:
        """Shots that close the holes of these attitudes; empty if there are no holes or no shots can close them."""
        ...


@runtime_checkable
class AnswersControl(Protocol):
    """A gimbal whose manager can be asked who has control."""

    async def ask_control(self) -> None:
        """Request the manager's status; takes at most 3 s and does not raise if it does not answer."""
        ...


@runtime_checkable
class ReportsPhotos(Protocol):
    """A camera that may report each photo with the time of its exposure (CAMERA_IMAGE_CAPTURED, 263)."""

    @property
    def reports_photos(self) -> bool:
        """Whether a report of the next photo is to be expected, so that its verdict should wait for it."""
        ...


@runtime_checkable
class PhotoRecall(Protocol):
    """A camera that remembers what it took: settles a photo that was in flight when the process died."""

    @property
    def image_count(self) -> int:
        """The camera's image count if it includes all triggered photos; else -1."""
        ...

    async def recall(self) -> RecalledPhotos:
        """Request its latest photos.

        Raises:
            DeviceError: the camera did not answer.
        """
        ...
