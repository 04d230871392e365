"""Diagnosis of infeasible requests: which constraint prevents a plan, and by how much."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from panoexec.angles import rotation
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.certificate.adjacency import MUTUAL_OVERLAP
from panoexec.planning.certificate.robust_footprint import robust_cores
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.model import NO_TOLERANCE, Constraints, GimbalLimits, Tolerance
from panoexec.planning.search.budget import BudgetSpentError, SearchBudget
from panoexec.planning.search.row_constraints import Demands, RowConstraints
from panoexec.planning.search.row_search import MORE_AT_LIMITS, searches
from panoexec.planning.search.row_spacing import MOST_IN_A_ROW, NeighbourDemand
from panoexec.planning.search.variants import worst_loss

_PITCHES_DEG = (0.0, -30.0, -60.0, -90.0)
_STEPS = 40

_BISECTIONS = 5
_MOST_SEEN = 100
"""Limit of the images that see one direction: the number of image pairs grows with its square."""

_WIDTH = 4
"""Beam width of searches that only test feasibility."""


def infeasibility_error(camera: Camera, constraints: Constraints, budget: SearchBudget | None = None) -> PlanningError:
    """The error that explains why no plan was found.

    Args:
        camera: the camera.
        constraints: the request.
        budget: if it ends the analysis, the error says so, and gives the reason as far as it is known.
    """
    return PlanningError(
        empty_cores(camera, constraints) or _Analysis(camera, budget or SearchBudget()).of(constraints)
    )


def nothing_to_cover(constraints: Constraints) -> str | None:
    """Message if the domain is empty; None otherwise."""
    if not constraints.masks:
        return None
    if len(Domain.of(constraints.band, constraints.masks).cell_centres()):
        return None
    return "the masks leave nothing of the band to cover: ask for a larger band or smaller masks"


def excessive_overlap(camera: Camera, constraints: Constraints) -> str | None:
    """Message if the overlaps need too many images; None otherwise."""
    exact = NeighbourDemand(planned=constraints.overlap_h, worst=0.0, tolerance=NO_TOLERANCE)
    finest = np.array([360.0 / MOST_IN_A_ROW])
    # spacing is smallest at the pitch of the band that is nearest to the horizon
    band = constraints.band
    flattest = 0.0 if band.elevation_min_deg <= 0 <= band.elevation_max_deg else 45.0
    if exact.surplus(camera, np.array([flattest]), finest)[0] < 0:
        return (
            f"horizontal overlap {constraints.overlap_h:g} needs more than {MOST_IN_A_ROW} images in one row: "
            "ask for less overlap"
        )
    seen = 1 / ((1 - constraints.overlap_h) * (1 - constraints.overlap_v))
    if seen > _MOST_SEEN * (1 + 1e-9):
        return (
            f"overlaps of {constraints.overlap_h:g} in rows and {constraints.overlap_v:g} between rows show each "
            f"direction in about {seen:.0f} images, {seen - _MOST_SEEN:.0f} above the limit: ask for less overlap"
        )
    step = camera.vfov_deg / 2 + math.degrees(math.atan(camera.half_height * (1 - 2 * constraints.overlap_v)))
    rows = (band.elevation_max_deg - band.elevation_min_deg) / max(step, 1e-12)
    if rows > MOST_IN_A_ROW:
        return f"vertical overlap {constraints.overlap_v:g} needs more than {MOST_IN_A_ROW} rows: ask for less overlap"
    return None


def empty_cores(camera: Camera, constraints: Constraints) -> str | None:
    """Message if no direction is seen for every error in the tolerance (all cores empty); None otherwise."""
    t = constraints.tolerance
    cores = robust_cores(camera, rotation(0.0, np.array(_PITCHES_DEG)), t)
    if not cores.empty.all():
        return None
    return (
        f"with tolerances of {_text(t)} an image of {_size(camera)} is not guaranteed to see any direction: "
        f"pitch must stay below {camera.vfov_deg / 2:.3g}°, roll and yaw well below {camera.hfov_deg / 2:.3g}°"
    )


class _Analysis:
    """Which constraint prevents a plan, found by leaving out one after the other."""

    def __init__(self, camera: Camera, budget: SearchBudget) -> None:
        self._camera = camera
        self._budget = budget
        self._known = ""

    def of(self, constraints: Constraints) -> str:
        """The reason; if the budget ends before it is found, what is known of it."""
        self._known = (
            "no set of rows covers the band with these overlaps, tolerances and limits: "
            "ask for less overlap, a smaller tolerance or a smaller band"
        )
        try:
            return (
                self._gimbal(constraints)
                or self._overlap(constraints)
                or self._tolerance(constraints)
                or "no set of rows covers the band: ask for a smaller tolerance or a smaller band"
            )
        except BudgetSpentError:
            return f"{self._known} (the budget of {self._budget.seconds:g} s ended the search for a closer reason)"

    def _gimbal(self, constraints: Constraints) -> str | None:
        gimbal = constraints.gimbal
        if gimbal is None or not self._feasible(replace(constraints, gimbal=None)):
            return None
        self._known = (
            f"with the gimbal's limits (pitch {gimbal.pitch_min_deg:g} to {gimbal.pitch_max_deg:g}°, "
            f"pan {gimbal.yaw_min_deg:g} to {gimbal.yaw_max_deg:g}°) no set of rows covers the band: "
            "ask for a smaller band"
        )
        all_round = replace(constraints, gimbal=replace(gimbal, yaw_min_deg=-180.0, yaw_max_deg=180.0))
        if not self._feasible(all_round):
            return _pitch_limits(_rules(self._camera, all_round, self._budget), constraints, gimbal)
        return _pan_limits(_rules(self._camera, constraints, self._budget), constraints, gimbal)

    def _overlap(self, constraints: Constraints) -> str | None:
        """Message if the overlaps are infeasible with the tolerances; None otherwise."""
        easy = replace(constraints, gimbal=None, overlap_h=0.0, overlap_v=0.0, guarantee="coverage")
        if not self._feasible(easy):
            return None
        errors = " for every pointing error" if constraints.guarantee == "all" else ""
        together = (
            f"overlaps of {constraints.overlap_h:g} and {constraints.overlap_v:g}{errors} are infeasible together"
        )
        self._known = together
        for name, value, changed in (
            ("horizontal", constraints.overlap_h, replace(constraints, gimbal=None, overlap_h=0.0)),
            ("vertical", constraints.overlap_v, replace(constraints, gimbal=None, overlap_v=0.0)),
        ):
            if value and self._feasible(changed):
                fails = f"a {name} overlap of {value:.3g}{errors} is infeasible with these tolerances"
                most = self._most_overlap(constraints, name, fails)
                return f"{fails}: the maximum is about {most:.2g}, {value - most:.2g} less"
        return together

    def _most_overlap(self, constraints: Constraints, name: str, fails: str) -> float:
        low, high = 0.0, constraints.overlap_h if name == "horizontal" else constraints.overlap_v
        for _ in range(_BISECTIONS):
            self._known = f"{fails}: the maximum is between {low:.2g} and {high:.2g}"
            middle = (low + high) / 2
            changed = (
                replace(constraints, gimbal=None, overlap_h=middle)
                if name == "horizontal"
                else replace(constraints, gimbal=None, overlap_v=middle)
            )
            low, high = (middle, high) if self._feasible(changed) else (low, middle)
        return low

    def _tolerance(self, constraints: Constraints) -> str | None:
        exact = replace(constraints.tolerance, pitch_deg=0.0, roll_deg=0.0, yaw_deg=0.0)
        if not self._feasible(replace(constraints, tolerance=exact)):
            return None
        t = constraints.tolerance
        fails = (
            f"with tolerances of {_text(t)} no set of rows of images of {_size(self._camera)} "
            "is guaranteed to cover the band"
        )
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            self._known = f"{fails}: between {low:.0%} and {high:.0%} of these tolerances would be feasible"
            middle = (low + high) / 2
            less = replace(t, pitch_deg=t.pitch_deg * middle, roll_deg=t.roll_deg * middle, yaw_deg=t.yaw_deg * middle)
            low, high = (middle, high) if self._feasible(replace(constraints, tolerance=less)) else (low, middle)
        return f"{fails}: about {low:.0%} of these tolerances would be feasible"

    def _feasible(self, constraints: Constraints) -> bool:
        rules = _rules(self._camera, constraints, self._budget)
        return any(search.solutions(retry=False) for search in searches(rules, width=_WIDTH))


def _pan_limits(rules: RowConstraints, constraints: Constraints, gimbal: GimbalLimits) -> str:
    camera, layout = rules.camera, rules.layout
    pan = f"the gimbal pans from {gimbal.yaw_min_deg:g} to {gimbal.yaw_max_deg:g}°"
    advice = "ask for an azimuth sector within the pan range, or let the vehicle pan the rest (yaw: auto)"
    if gimbal.yaw_max_deg - gimbal.yaw_min_deg < camera.hfov_deg:
        advice = (
            f"ask for an azimuth sector around {(gimbal.yaw_min_deg + gimbal.yaw_max_deg) / 2:g}°, "
            "or let the vehicle pan the rest (yaw: auto)"
        )
    if layout.blind_deg == 0:
        band = constraints.band
        where = f"azimuths {band.azimuth_min_deg:g} to {band.azimuth_max_deg:g}°"
        if not layout.reachable:
            where += ", outside this range,"
        return f"{pan}: images of {camera.hfov_deg:.3g}° do not reach the ends of {where} from there: {advice}"
    widest = float(rules.widest(np.zeros(1))[0])
    if layout.blind_deg <= widest:
        return (
            f"{pan}, which leaves a gap of {layout.blind_deg:.4g}° between neighbours: with these overlaps and "
            f"tolerances no rows of images of {camera.hfov_deg:.3g}° x {camera.vfov_deg:.3g}° close across it: {advice}"
        )
    return (
        f"{pan}, which leaves a gap of {layout.blind_deg:.4g}° between neighbours, but with an overlap of "
        f"{constraints.overlap_h:.0%} images at the horizon may be at most {widest:.4g}° apart "
        f"({layout.blind_deg - widest:.3g}° too much): {advice}"
    )


def _pitch_limits(rules: RowConstraints, constraints: Constraints, gimbal: GimbalLimits) -> str:
    low, high = constraints.band.elevation_min_deg, constraints.band.elevation_max_deg
    lowest = _farthest_reach_deg(rules, -1)
    if lowest > low:
        return (
            f"elevation {low:g}° cannot be covered: at the gimbal's lowest pitch "
            f"{gimbal.pitch_min_deg:g}° images cover all azimuths down to {lowest:.2f}°, {lowest - low:.2f}° short: "
            f"{_instead(math.ceil(lowest * 10 + 0.5) / 10, high)}"
        )
    highest = _farthest_reach_deg(rules, 1)
    if highest < high:
        return (
            f"elevation {high:g}° cannot be covered: at the gimbal's highest pitch "
            f"{gimbal.pitch_max_deg:g}° images cover all azimuths up to {highest:.2f}°, {high - highest:.2f}° short: "
            f"{_instead(low, math.floor(highest * 10 - 0.5) / 10)}"
        )
    return (
        f"no set of rows within the gimbal's pitch range, {gimbal.pitch_min_deg:g} to {gimbal.pitch_max_deg:g}°, "
        f"covers elevations {low:g} to {high:g}° with these overlaps and tolerances: ask for a smaller elevation band"
    )


def _instead(low_deg: float, high_deg: float) -> str:
    return f"ask for elevations from {low_deg:g} to {high_deg:g}°" if low_deg < high_deg else "ask for other elevations"


def _farthest_reach_deg(rules: RowConstraints, side: int) -> float:
    """Lowest (`side` -1) or highest (1) elevation that a row near that pitch limit covers at all azimuths.

    90 or -90, respectively, if no row there is closed.
    """
    height = rules.camera.vfov_deg
    limit, other = rules.pitch_deg[:: side * -1]
    pitch = np.linspace(limit, max(other, limit - height) if side > 0 else min(other, limit + height), _STEPS)
    farthest = -90.0
    for more in range(MORE_AT_LIMITS + 1):
        counts = rules.fewest(pitch) + more
        low, high = rules.band(pitch, counts)
        closes = (low < high) & rules.allowed(pitch, counts)
        farthest = max(farthest, float((high if side > 0 else -low)[closes].max(initial=-90.0)))
    return side * farthest


def _text(tolerance: Tolerance) -> str:
    return f"{tolerance.pitch_deg:g}° (pitch), {tolerance.roll_deg:g}° (roll) and {tolerance.yaw_deg:g}° (yaw)"


def _size(camera: Camera) -> str:
    return f"{camera.hfov_deg:.3g}° x {camera.vfov_deg:.3g}°"


def _rules(camera: Camera, constraints: Constraints, budget: SearchBudget) -> RowConstraints:
    every = constraints.guarantee == "all"
    neighbours = NeighbourDemand(
        planned=constraints.overlap_h,
        worst=max(constraints.overlap_h if every else 0.0, MUTUAL_OVERLAP),
        tolerance=constraints.tolerance,
    )
    demands = Demands(
        neighbours=neighbours, planned_v=constraints.overlap_v, worst_v=constraints.overlap_v if every else 0.0
    )
    loss = worst_loss(camera, constraints) if every else None
    return RowConstraints(camera, constraints, demands, loss, budget=budget)
