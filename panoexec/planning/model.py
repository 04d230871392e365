"""Data model of planning: constraints, shots, certificate and estimate, as frozen dataclasses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from panoexec.angles import FloatArray, rotation_321
from panoexec.azimuths import azimuth_range, span_of
from panoexec.optics import Camera
from panoexec.planning.skyline import Skyline

Guarantee: TypeAlias = Literal["coverage", "all"]
Method: TypeAlias = Literal["certified", "paper", "hdrpano", "published", "foreign", "patch"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """Largest accepted pointing error τ of each gimbal axis (3-1-2 order: yaw, roll, pitch), degrees, each ≥ 0."""

    pitch_deg: float
    roll_deg: float
    yaw_deg: float

    def times(self, factor: float) -> Tolerance:
        """The same of each axis, multiplied."""
        return Tolerance(
            pitch_deg=factor * self.pitch_deg, roll_deg=factor * self.roll_deg, yaw_deg=factor * self.yaw_deg
        )

    @property
    def is_zero(self) -> bool:
        """Whether all tolerances are 0 (no pointing errors)."""
        return self.pitch_deg == self.roll_deg == self.yaw_deg == 0


NO_TOLERANCE = Tolerance(pitch_deg=0.0, roll_deg=0.0, yaw_deg=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """The part of the sphere that a panorama covers: a box in elevation and azimuth.

    Azimuths run clockwise from `azimuth_min_deg` to `azimuth_max_deg`. Whatever the notation, the first is kept in
    [-180, 180) and the second above it by at most 360 (`panoexec.azimuths`; 170 to 190 and 170 to -170 are
    one 20° sector around the back); what is no range is kept as it is, for `check_request` to refuse.
    """

    elevation_min_deg: float
    elevation_max_deg: float
    azimuth_min_deg: float = -180.0
    azimuth_max_deg: float = 180.0

    def __post_init__(self) -> None:
        _set_range(self)

    @property
    def azimuth_span_deg(self) -> float:
        """Width of the sector, (0, 360]; exactly 360 for the full circle."""
        return span_of(self.azimuth_min_deg, self.azimuth_max_deg)

    @property
    def is_full_circle(self) -> bool:
        """Whether the band covers all azimuths."""
        return self.azimuth_span_deg >= 360.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleBox:
    """A box in elevation and azimuth (clockwise from min to max, as in `Band`)."""

    elevation_min_deg: float
    elevation_max_deg: float
    azimuth_min_deg: float
    azimuth_max_deg: float

    def __post_init__(self) -> None:
        _set_range(self)

    @property
    def azimuth_span_deg(self) -> float:
        """As of `Band`."""
        return span_of(self.azimuth_min_deg, self.azimuth_max_deg)


def _set_range(box: Band | AngleBox) -> None:
    """Keep the azimuths in their one representation."""
    try:
        start, end = azimuth_range(box.azimuth_min_deg, box.azimuth_max_deg)
    except ValueError:
        return
    object.__setattr__(box, "azimuth_min_deg", start)
    object.__setattr__(box, "azimuth_max_deg", end)


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnLimits:
    """How fast an autopilot turns the vehicle on the spot; infinite: unknown.

    Attributes:
        rate_deg_s: the largest yaw rate.
        acceleration_deg_s2: the largest yaw acceleration.
        own_rate: it turns at that rate, whatever rate is commanded.
    """

    rate_deg_s: float = math.inf
    acceleration_deg_s2: float = math.inf
    own_rate: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Turning:
    """How the vehicle yaws on the spot where the gimbal cannot pan the camera.

    Attributes:
        rate_deg_s: commanded and largest yaw rate.
        acceleration_deg_s2: yaw acceleration at the start and the end of a turn.
        settle_s: time until the heading is steady after a turn, in addition to the settle time of each shot.
        margin_deg: margin at each end of the gimbal's pan range, reserved for heading oscillation.
    """

    rate_deg_s: float = 45.0
    acceleration_deg_s2: float = 90.0
    settle_s: float = 1.0
    margin_deg: float = 10.0

    def within(self, limits: TurnLimits) -> Turning:
        """The same turns under the limits of an autopilot."""
        return replace(
            self,
            rate_deg_s=min(self.rate_deg_s, limits.rate_deg_s),
            acceleration_deg_s2=min(self.acceleration_deg_s2, limits.acceleration_deg_s2),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalLimits:
    """The gimbal's pitch range and pan range, degrees; rate (deg/s) and acceleration (deg/s²) of each axis.

    A pan range of 360 or more has no end stops; a range of 0 is a gimbal of two axes (roll and pitch). With `turning`
    the pan range is relative to the vehicle's heading, which may change, so every yaw can be reached.
    """

    pitch_min_deg: float = -90.0
    pitch_max_deg: float = 90.0
    yaw_min_deg: float = -180.0
    yaw_max_deg: float = 180.0
    pitch_rate_deg_s: float = 60.0
    yaw_rate_deg_s: float = 90.0
    pitch_acceleration_deg_s2: float = 240.0
    yaw_acceleration_deg_s2: float = 360.0
    yaw_endless: bool = True
    """Whether the pan axis rotates continuously through ±180."""
    turning: Turning | None = None
    """How the vehicle yaws where the gimbal cannot pan; None: the vehicle keeps its heading."""

    @property
    def pans(self) -> bool:
        """Whether the gimbal has a pan axis and the plan uses it."""
        return self.yaw_endless or self.yaw_max_deg > self.yaw_min_deg

    @property
    def all_round(self) -> bool:
        """Whether every yaw can be reached by the shortest rotation."""
        return self.yaw_endless or self.turning is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Time that a shot takes in addition to the slew, seconds."""

    settle_s: float = 0.3
    exposure_s: float = 0.02
    trigger_latency_s: float = 0.05
    interval_s: float = 1.0
    """Minimum interval between two photos of the camera."""
    brackets: int = 1
    """Photos at each pose."""
    transfer_s: float = 0.0
    """Until a photo's file is here, if they arrive in flight, one after the other; 0: not counted."""
    check_s: float = 0.0
    """Examination of a photo whose file is here, likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Constraints:
    """What a plan must satisfy (docs/contract.md: C1 to C4).

    Attributes:
        overlap_h: minimum overlap of neighbours in a row, fraction of the image area, [0, 1).
        overlap_v: minimum overlap of an image with the union of the adjacent row, fraction, [0, 1).
        band: directions to cover.
        tolerance: pointing errors that the guarantee includes.
        guarantee: `coverage`: C1 and C4 hold for every error, C2 and C3 at the planned poses; `all`: C1 to C4 hold for
            every error.
        masks: boxes of the band that need no coverage (for example the landing gear).
        gimbal: the gimbal's limits, if known.
        textured_below: C2 to C4 count only what lies below it; None: everything.
    """

    overlap_h: float
    overlap_v: float
    band: Band
    tolerance: Tolerance = NO_TOLERANCE
    guarantee: Guarantee = "coverage"
    masks: tuple[AngleBox, ...] = ()
    gimbal: GimbalLimits | None = None
    textured_below: Skyline | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One gimbal pose.

    Attributes:
        index: position in the shooting order, from 0.
        row: row number, from 0 at the lowest pitch; the pitches of a row are the same, or nearly so.
        pitch_deg: positive up.
        yaw_deg: clockwise from the reference heading, [-180, 180).
        roll_deg: about the boresight, which pitch and yaw direct, positive when the right of the image goes down; these
            planners make none, no gimbal is commanded to it, but plans of others are judged and exported with it.
    """

    index: int
    row: int
    pitch_deg: float
    yaw_deg: float
    roll_deg: float = 0.0
    geometry_only: bool = False
    """Whether it sees as good as sky alone, so that nothing but its angles places it in the panorama."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hole:
    """A part of the band without guaranteed coverage: a direction in it, a bound of its angular diameter."""

    elevation_deg: float
    azimuth_deg: float
    size_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """The verdict on a plan (docs/contract.md: certified means C1 to C4), and where it fails.

    Overlaps are minima at the planned poses; `worst_*` are lower bounds over all combinations of errors within the
    tolerance. `None` where there is no pair to measure (a single image, a single row).
    """

    certified: bool
    images: int
    min_overlap_h: float | None
    min_overlap_v: float | None
    worst_overlap_h: float | None
    worst_overlap_v: float | None
    uncovered_fraction: float
    """Fraction of the band's solid angle without guaranteed coverage; 0.0 exactly when C1 is proven."""
    connected: bool
    two_edge_connected: bool
    failures: tuple[str, ...] = ()
    """One line for each condition of C1 to C4 that fails: the condition, the place, the amount."""
    holes: tuple[Hole, ...] = ()
    """Largest first."""
    weakest_h: tuple[int, int] | None = None
    """Shot indices of the neighbours with the smallest overlap."""
    weakest_v: int | None = None
    """Index of the shot with the smallest overlap with an adjacent row."""
    bridges: tuple[tuple[int, int], ...] = ()
    """Edges (pairs of shot indices) whose removal would disconnect the graph."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Expected cost and result of a plan."""

    duration_s: float
    """From the start of the first settling until the last photo is taken, and where files arrive, examined."""
    slew_deg: float
    """Sum over all slews of the larger of the pitch and the yaw angle."""
    panorama_px: tuple[int, int]
    """The whole sphere at full resolution."""
    band_px: tuple[int, int]
    """The part of it that the band fills."""
    after_s: float = 0.0
    """How much of the duration comes after the last exposure: files on their way, photos being examined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Shots in shooting order for a camera and constraints, with certificate and estimate where computed."""

    method: Method
    camera: Camera
    constraints: Constraints
    shots: tuple[Shot, ...]
    certificate: Certificate | None = None
    estimate: Estimate | None = None
    lower_bound: int | None = None
    """Lower bound of the number of images for these constraints: of any plan by solid angle, or, if that is more, of
    plans in closed rows (`panoexec.planning.search.row_bound`), unless this plan in uneven rows has fewer."""
    notes: tuple[str, ...] = field(default=())

    def rotations(self) -> FloatArray:
        """Camera-to-world rotations (n, 3, 3) of the planned poses, in shooting order."""
        return shot_rotations(self.shots)

    def rows(self) -> list[tuple[float, list[Shot]]]:
        """Rows from the lowest pitch up: (pitch_deg, shots by yaw)."""
        by_row: dict[int, list[Shot]] = {}
        for shot in self.shots:
            by_row.setdefault(shot.row, []).append(shot)
        rows = [(shots[0].pitch_deg, sorted(shots, key=lambda s: s.yaw_deg)) for shots in by_row.values()]
        return sorted(rows, key=lambda row: row[0])


def shot_rotations(shots: Sequence[Shot]) -> FloatArray:
    """Camera-to-world rotations (n, 3, 3) of the planned poses."""
    angles = np.array([(s.yaw_deg, s.pitch_deg, s.roll_deg) for s in shots]).reshape(-1, 3)
    return rotation_321(angles[:, 0], angles[:, 1], angles[:, 2])
