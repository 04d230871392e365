"""Events about photos after their exposure: which file they are, that it is stored, what its content proves."""

from __future__ import annotations

from dataclasses import dataclass

from panoexec.codec import Number, Whole
from panoexec.formats.photo_settings import PhotoExif
from panoexec.mission.log.event_base import NAN, Event, Photo, ShotEvent


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoIdentified(ShotEvent):
    """More became known about an attempt's photos after its verdict (a file name, better evidence)."""

    photos: tuple[Photo, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoStored(ShotEvent):
    """The file of a photo is in the mission directory, whole and on disk; also after the mission's end.

    A later event for the same photo replaces an earlier one.

    Attributes:
        photo: number of the photo within its attempt, from 1.
        file: path relative to the mission directory, below `images/`, with forward slashes.
        size_bytes: its size.
        sha256: of its content, 64 hexadecimal digits.
        source: where it came from: `gphoto2`, `http`, `mavftp`, `local` (a folder of this computer) or `import`.
        raw: path of the RAW file beside it; "" without one.
        raw_sha256: of the RAW file's content.
        exif: what it was taken with; None if it is no JPEG, or was stored by a version that did not read it.
        differs: in what its settings differ from those of the mission's first stored photo.
        taken_s: when it was taken, as its EXIF tells by the camera's clock, taken as UTC, seconds since 1970; NaN if it
            does not tell.
        taken_resolution_s: of that time; NaN if there is none.
        contradiction: why that time does not fit its attempt, by the photos stored before it; "" if nothing says so.
    """

    photo: Whole = 1
    file: str
    size_bytes: Whole
    sha256: str
    source: str
    raw: str = ""
    raw_sha256: str = ""
    exif: PhotoExif | None = None
    differs: tuple[str, ...] = ()
    taken_s: Number = NAN
    taken_resolution_s: Number = NAN
    contradiction: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoTie:
    """What ties a photo to another one.

    Attributes:
        shot: the other photo's.
        points: how many points agree.
        angle_deg: by how much the two measured attitudes contradict the content.
        parallax_deg: by how much the ground is displaced because they were taken from different places.
    """

    shot: Whole
    points: Whole
    angle_deg: Number
    parallax_deg: Number = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoChecked(ShotEvent):
    """The content of a photo was examined; a later event for the same photo replaces an earlier one.

    Attributes:
        photo: number of the photo within its attempt, from 1.
        verdict: `ok`, `geometry_only`, `unreadable`, `exposure`, `blurred`, `untied`, `contradicts` or `unchecked`
            (docs/content.md).
        reason: in words; "" for a good photo.
        sharpness: fine detail relative to its neighbours; NaN without a comparison.
        odd_deg: by how much the content contradicts the measured attitude, beyond what attitudes usually err.
        error_deg: measured minus estimated attitude, about north, east and down.
        ties: to its neighbours.
    """

    photo: Whole = 1
    verdict: str
    reason: str = ""
    sharpness: Number = NAN
    odd_deg: Number = 0.0
    error_deg: tuple[Number, ...] = ()
    ties: tuple[PhotoTie, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgePlanned(Event):
    """Shots were added halfway between photos that show texture but share too little to be tied.

    Attributes:
        shots: their indices.
        between: the two shots that each may tie, in pairs one after the other.
        pitch_deg, yaw_deg: their targets in the plan's frame.
    """

    shots: tuple[Whole, ...]
    between: tuple[Whole, ...]
    pitch_deg: tuple[Number, ...]
    yaw_deg: tuple[Number, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ContentJudged(Event):
    """All photos that reached this computer were judged together.

    Attributes:
        edges: shots that are tied, in pairs one after the other.
        groups: number of groups of photos that are tied to each other; photos that nothing ties are not counted.
        bridges: ties without which a group falls apart, in pairs one after the other.
        geometry_only: shots that hang on their measured attitude alone.
        geometry_bound_deg: bound (three standard deviations) of the error of these attitudes, relative to the others.
        bad: shots whose photo does not count.
        unchecked: shots whose photo was not examined.
    """

    edges: tuple[Whole, ...] = ()
    groups: Whole = 0
    bridges: tuple[Whole, ...] = ()
    geometry_only: tuple[Whole, ...] = ()
    geometry_bound_deg: Number = NAN
    bad: tuple[Whole, ...] = ()
    unchecked: tuple[Whole, ...] = ()
