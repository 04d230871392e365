"""Interfaces that the executor needs besides the devices."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from panoexec.angles import FloatArray
from panoexec.devices import RecalledPhotos
from panoexec.formats.photo_settings import PhotoExif
from panoexec.mission.log.events import Event
from panoexec.pictures.model import BridgePose, Content, Verdicts
from panoexec.planning.model import Certificate, Shot, TurnLimits


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


class PictureChecker(Protocol):
    """Examines photos, in a process of its own; every method may raise `PanoexecError` if that failed."""

    async def plan(self, planned: Mapping[int, Sequence[float]]) -> None:
        """Tell planned attitudes, quaternions by shot."""
        ...

    async def add(
        self, shot: int, path: Path, q_wxyz: Sequence[float], time_s: float, place: Sequence[float] | None = None
    ) -> Verdicts:
        """Examine a photo; the verdicts on all photos so far."""
        ...

    async def condemn(self, shot: int, code: Content, reason: str, q_wxyz: Sequence[float], time_s: float) -> Verdicts:
        """Add a photo that is bad for a reason that others found."""
        ...

    async def drop(self, shots: Sequence[int]) -> Verdicts:
        """Forget photos."""
        ...

    async def judge(self, *, final: bool = False) -> Verdicts:
        """The verdicts on all photos; `final`: no more are to come."""
        ...

    async def bridges(
        self, *, tried: Collection[frozenset[int]], pitch_deg: tuple[float, float], most: int
    ) -> list[BridgePose]:
        """Poses that may tie photos which share too little (`panoexec.pictures.bridging.bridge_poses`)."""
        ...


@runtime_checkable
class LimitsTurns(Protocol):
    """A vehicle that knows how fast its autopilot turns it."""

    async def turn_limits(self) -> TurnLimits:
        """What the autopilot's parameters say; unknown limits if it does not answer.

        Raises:
            LinkError: the autopilot has not been found yet.
        """
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
class MetersExposure(Protocol):
    """A camera whose exposure is metered once for a whole panorama."""

    @property
    def needs_metering(self) -> bool:
        """Whether that is asked for, and was not done since it was prepared."""
        ...

    async def meter(self, known: PhotoExif | None) -> str:
        """Keep an exposure from now on: a known one, or what the camera meters where it points now.

        Returns:
            What prevents that, "" if nothing does.

        Raises:
            DeviceError: it took no photo to meter by, or is gone.
        """
        ...


@runtime_checkable
class TellsLens(Protocol):
    """A camera that may tell the focal length of its lens."""

    @property
    def focal_length_mm(self) -> float:
        """In millimetres, not the 35 mm equivalent; NaN if it does not tell. Known once the camera is prepared."""
        ...


@runtime_checkable
class ReportsUndated(Protocol):
    """A camera whose reports have no time: a photo was exposed at any time between its trigger and its report."""

    @property
    def undated_hold_s(self) -> float:
        """How long nothing may move after a trigger, unless the report comes sooner."""
        ...


@runtime_checkable
class MayFireLate(Protocol):
    """A trigger that may be carried out later than it was acknowledged: an autopilot or a camera may defer it."""

    async def fired(self) -> float:
        """Return once it was carried out, or cannot be any more; nothing may move before.

        Returns:
            The earliest time of the exposure, on the mission's clock: that of the trigger if nothing more is known.
        """
        ...


@runtime_checkable
class PacesPhotos(Protocol):
    """A camera whose least interval may be longer than configured: told by a parameter, or learned from refusals."""

    @property
    def interval_s(self) -> float:
        """The least time between two triggers that is known; 0 if none is."""
        ...

    @property
    def ready_s(self) -> float:
        """When the next trigger is likely to be accepted, on the mission's clock; -inf if nothing speaks against it."""
        ...


@runtime_checkable
class PreparesForPhotos(Protocol):
    """A camera that has to be made ready, and is left as it was found."""

    async def prepare(self) -> str:
        """Make it ready for photos; returns what prevents that, "" if nothing does.

        Raises:
            DeviceError: it did not answer.
        """
        ...

    async def restore(self) -> None:
        """Undo `prepare`; does not raise, and takes at most 5 s."""
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


@runtime_checkable
class PhotoFetcher(Protocol):
    """Brings the files of a camera to this computer."""

    source: str
    """The `source` of `photo_stored`."""

    def takes(self, url: str) -> bool:
        """Whether it can bring files with such a URL."""
        ...

    async def fetch(self, url: str, part: Path) -> Path:
        """Bring a file here.

        Args:
            url: as told by the camera.
            part: where to write it; what an earlier, interrupted attempt left there may be continued.

        Returns:
            `part`, or the file itself if it is on this computer already.

        Raises:
            PhotoFileError: it could not be brought; `final` if trying again would not help.
        """
        ...
