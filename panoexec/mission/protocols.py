"""What the executor asks of its surroundings besides the devices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from panoexec.angles import FloatArray
from panoexec.devices import Recollection
from panoexec.mission.log.events import Event
from panoexec.planning.model import Certificate, Shot


class Journal(Protocol):
    """Keeps events for good."""

    async def append(self, events: Sequence[Event]) -> None:
        """Return when all of them are on disk, in this order, or raise and keep none.

        Raises:
            MissionError: the journal cannot be written.
        """
        ...


class Verifier(Protocol):
    """The certificate of a panorama as flown; heavy work, done beside the event loop."""

    async def certify(self, rotations: FloatArray, rows: Sequence[int]) -> Certificate:
        """The verdict on measured attitudes.

        Args:
            rotations: camera to plan frame (n, 3, 3), one an accepted shot.
            rows: the row of each.
        """
        ...

    async def patch(self, rotations: FloatArray, rows: Sequence[int]) -> Sequence[Shot]:
        """Shots that would close the holes that these leave; empty if there are none, or no shot can."""
        ...


@runtime_checkable
class ReportsPhotos(Protocol):
    """A camera that may report each photo with the time of its exposure (CAMERA_IMAGE_CAPTURED, 263)."""

    @property
    def reports_photos(self) -> bool:
        """Whether a report of the next photo is to be expected, so that its verdict should wait for it."""
        ...


@runtime_checkable
class PhotoMemory(Protocol):
    """A camera that remembers what it took: settles a photo that was in flight when the process died."""

    @property
    def image_count(self) -> int:
        """How many images it counts, if that includes all that were triggered; else -1."""
        ...

    async def recall(self) -> Recollection:
        """Ask for its last photos.

        Raises:
            DeviceError: it does not answer.
        """
        ...
