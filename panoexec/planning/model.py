"""What a plan is: request, shots, certificate and estimate, as plain frozen values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera

Guarantee: TypeAlias = Literal["coverage", "all"]
Method: TypeAlias = Literal["certified", "paper", "hdrpano", "published", "foreign", "patch"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """Largest accepted pointing error τ of each gimbal axis (3-1-2 order: yaw, roll, pitch), degrees, each ≥ 0."""

    pitch_deg: float
    roll_deg: float
    yaw_deg: float

    @property
    def is_zero(self) -> bool:
        """Whether perfect pointing is asked for."""
        return self.pitch_deg == self.roll_deg == self.yaw_deg == 0


NO_TOLERANCE = Tolerance(pitch_deg=0.0, roll_deg=0.0, yaw_deg=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """The part of the sphere that a panorama covers: a box in elevation and azimuth.

    Azimuths run clockwise from `azimuth_min_deg` to `azimuth_max_deg`, which may lie beyond 180 (170 to 190 is a
    20° sector around the back); a span of 360 is the full circle.
    """

    elevation_min_deg: float
    elevation_max_deg: float
    azimuth_min_deg: float = -180.0
    azimuth_max_deg: float = 180.0

    @property
    def azimuth_span_deg(self) -> float:
        """Width of the sector, (0, 360]."""
        return self.azimuth_max_deg - self.azimuth_min_deg

    @property
    def is_full_circle(self) -> bool:
        """Whether the band closes on itself."""
        return self.azimuth_span_deg >= 360.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleBox:
    """A box of directions, by elevation and azimuth (clockwise from min to max, as in `Band`)."""

    elevation_min_deg: float
    elevation_max_deg: float
    azimuth_min_deg: float
    azimuth_max_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Turning:
    """How the vehicle turns on the spot, where it pans the camera.

    Attributes:
        rate_deg_s: largest speed, which it is also asked for.
        acceleration_deg_s2: of the start and the end of a turn.
        settle_s: until the nose stands still after one, besides the settle time of every shot.
        margin_deg: so much of each end of the gimbal's pan range is left for the swaying of the nose.
    """

    rate_deg_s: float = 45.0
    acceleration_deg_s2: float = 90.0
    settle_s: float = 1.0
    margin_deg: float = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalLimits:
    """Where the gimbal can point: pitch range and pan range, degrees; rates and accelerations per axis.

    A pan range of 360 or more has no end stops, one of 0 is a gimbal of two axes. Rates in degrees a second,
    accelerations in degrees a second squared. With `turning` the pan range is relative to a nose that may be turned, so
    that every yaw can be reached.
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
    """Whether the pan axis may turn through ±180 without end."""
    turning: Turning | None = None
    """How the vehicle pans where the gimbal cannot; None: it is never turned."""

    @property
    def pans(self) -> bool:
        """Whether the gimbal has a pan axis at all, or one that is used."""
        return self.yaw_endless or self.yaw_max_deg > self.yaw_min_deg

    @property
    def all_round(self) -> bool:
        """Whether every yaw can be reached, and the short way."""
        return self.yaw_endless or self.turning is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """What a shot costs besides the slew, seconds."""

    settle_s: float = 0.3
    exposure_s: float = 0.02
    trigger_latency_s: float = 0.05
    interval_s: float = 1.0
    """Least time between two photos of the camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Constraints:
    """What a plan must satisfy (docs/contract.md: C1 to C4).

    Attributes:
        overlap_h: least overlap of neighbours in a row, fraction of the image area, [0, 1).
        overlap_v: least overlap of an image with the union of the next row, fraction, [0, 1).
        band: directions to cover.
        tolerance: pointing errors to survive.
        guarantee: `coverage`: C1 and C4 for every error, C2 and C3 at the planned poses; `all`: all for every error.
        masks: boxes of the band that need no coverage (landing gear).
        gimbal: where the gimbal can point, if it is known.
    """

    overlap_h: float
    overlap_v: float
    band: Band
    tolerance: Tolerance = NO_TOLERANCE
    guarantee: Guarantee = "coverage"
    masks: tuple[AngleBox, ...] = ()
    gimbal: GimbalLimits | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One pose of the gimbal; roll is 0.

    Attributes:
        index: position in the shooting order, from 0.
        row: rows are counted from the lowest pitch, from 0; images of one row have one pitch.
        pitch_deg: positive up.
        yaw_deg: clockwise from the reference, [-180, 180).
    """

    index: int
    row: int
    pitch_deg: float
    yaw_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Hole:
    """A part of the band that no image is sure to cover: where, and how large across (angular diameter bound)."""

    elevation_deg: float
    azimuth_deg: float
    size_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """The verdict on a plan (docs/contract.md: certified means C1 to C4), and where it fails.

    Overlaps are the least found, at the planned poses; `worst_*` are their lower bounds over all combinations of errors
    within the tolerance. `None` where there is nothing to overlap (a single image, a single row).
    """

    certified: bool
    images: int
    min_overlap_h: float | None
    min_overlap_v: float | None
    worst_overlap_h: float | None
    worst_overlap_v: float | None
    uncovered_fraction: float
    """Of the band's solid angle, not sure to be covered; 0.0 exactly when C1 is proven."""
    connected: bool
    two_edge_connected: bool
    failures: tuple[str, ...] = ()
    """One line for each of C1 to C4 that fails: what, where, by how much."""
    holes: tuple[Hole, ...] = ()
    """Largest first."""
    weakest_h: tuple[int, int] | None = None
    """Shot indices of the pair with the least overlap in a row."""
    weakest_v: int | None = None
    """Index of the shot with the least overlap with a neighbouring row."""
    bridges: tuple[tuple[int, int], ...] = ()
    """Pairs whose loss would disconnect the graph."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What flying a plan is expected to cost and to bring."""

    duration_s: float
    slew_deg: float
    """Sum over slews of the larger of the two axes' angles."""
    panorama_px: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Shots in shooting order for a camera and constraints, with the verdict and the estimate where made."""

    method: Method
    camera: Camera
    constraints: Constraints
    shots: tuple[Shot, ...]
    certificate: Certificate | None = None
    estimate: Estimate | None = None
    lower_bound: int | None = None
    """No plan for these constraints can have fewer images (solid angle)."""
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
    return rotation(np.array([s.yaw_deg for s in shots]), np.array([s.pitch_deg for s in shots]))
