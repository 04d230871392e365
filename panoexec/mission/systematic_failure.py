"""Recognises a systematic failure: the same refusal, or the same pointing offset, at several shots in a row.

A camera in video mode refuses each trigger, and a gimbal whose north is off misses each target by the same angle. More
attempts change nothing: the mission pauses with the cause. Gusts, drifts and single refusals differ from attempt to
attempt and from shot to shot; any attempt that ends otherwise begins the count anew. A gimbal that is stuck, or whose
reports are in another convention, misses each target by another angle, but by much: that is systematic too. Pure logic.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from panoexec.angles import wrap_180
from panoexec.mission.attempt_result import Offset
from panoexec.mission.guards import Finding
from panoexec.planning.model import Shot, Tolerance

SHOTS: Final = 3
"""How many different shots in a row must fail alike."""
ATTEMPTS: Final = 8
"""How many attempts in a row must fail alike: where one of five is refused at random, that is once in 390 000."""
FOREIGN_ATTEMPTS: Final = 2
"""The same for another station that points the gimbal, which is no matter of chance: since the last accepted photo."""
SPREAD_FRAC: Final = 0.25
"""How far offsets may differ, as a fraction of their size, or by τ if that is more."""
ELSEWHERE_DEG: Final = 5.0
"""A pose that is farther from its target than this has nothing to do with it."""
APART_DEG: Final = 10.0
"""Where the vehicle pans, its heading has a steady error in wind that depends on the heading: the shots must be at
headings this far apart."""

_ADVICE: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "trigger": ("camera", "check the camera (photo mode, storage, shortest interval, power)"),
        "evidence": ("photos", "check that the camera takes photos and reports them ([camera] evidence)"),
        "late_exposure": ("photos", "check the camera's delay ([camera] latency_s) and its shortest interval"),
        "gimbal": ("gimbal", "check the gimbal (mode, limits, who controls it)"),
        "foreign": ("foreign", "let no other station point it (DO_MOUNT_CONTROL, ROI, a gimbal page)"),
        "stale": ("reports", "check the link's load and the gimbal's message rate"),
        "vehicle": ("turn_refused", "check the flight mode and whether the vehicle can turn"),
    }
)
"""For each code of a rejected attempt that may be systematic: code of the hold, and what to do."""
HOLD_CODES: Final = frozenset({"offset", *(hold for hold, _ in _ADVICE.values())})
"""Codes of the holds."""
_ELSEWHERE_ADVICE: Final = (
    "check that the gimbal obeys (mode, lock, limits of its angles) and in which frame and convention it reports"
)
_OFFSET_ADVICE: Final = "calibrate the gimbal or its compass, or widen [pointing] tolerance_*_deg"


_AXES: Final = ("pitch_deg", "roll_deg", "yaw_deg")


def _beyond(offset: Offset, tolerance: Tolerance) -> tuple[str, ...]:
    """Axes whose error exceeds the tolerance."""
    return tuple(axis for axis in _AXES if abs(getattr(offset, axis)) > getattr(tolerance, axis))


def _alike(offset: Offset, other: Offset, tolerance: Tolerance) -> bool:
    """Whether both exceed the tolerance about the same axes, in the same direction and by about the same size."""
    if _beyond(offset, tolerance) != _beyond(other, tolerance):
        return False
    return all(
        abs(float(wrap_180(getattr(offset, axis) - getattr(other, axis))))
        <= max(getattr(tolerance, axis), SPREAD_FRAC * abs(getattr(other, axis)))
        for axis in _AXES
    )


def _is_elsewhere(offset: Offset, tolerance: Tolerance) -> bool:
    """Whether a pose is so far from the target that neither sway nor a bad calibration explains it."""
    return any(abs(getattr(offset, axis)) > max(ELSEWHERE_DEG, 2 * getattr(tolerance, axis)) for axis in _AXES)


class SystematicFailure:
    """The run of attempts that failed alike.

    Args:
        tolerance: τ of the mission.
        vehicle_pans: whether the vehicle's heading sets the camera's yaw.
    """

    def __init__(self, tolerance: Tolerance, *, vehicle_pans: bool = False) -> None:
        self._tolerance = tolerance
        self._vehicle_pans = vehicle_pans
        self._cause: tuple[str, str] | None = None
        self._offset: Offset | None = None
        self._attempts = 0
        self._shots: dict[int, float] = {}
        self._elsewhere: dict[int, int] = {}
        self._foreign: dict[int, int] = {}

    @property
    def shots(self) -> tuple[int, ...]:
        """The shots of the run, in the order of their first failure."""
        return tuple(dict.fromkeys([*self._elsewhere, *self._foreign, *self._shots]))

    def reset(self) -> None:
        """A photo was accepted, or the operator has resumed the mission."""
        self._ended_otherwise()
        self._foreign.clear()

    def _ended_otherwise(self) -> None:
        """Begin the run anew.

        Another station that points the gimbal also spoils exposures after the gimbal has settled: they do not end the
        count of its attempts.
        """
        self._cause, self._offset, self._attempts = None, None, 0
        self._shots.clear()
        self._elsewhere.clear()

    def rejected(self, shot: Shot, *, code: str, reason: str, offset: Offset | None = None) -> Finding | None:
        """Take a rejected attempt; returns why the mission must pause once the run is long enough.

        Args:
            shot: that was missed.
            code: of the rejection.
            reason: of the rejection.
            offset: the pointing error, for rejections by the pose; None where it is unknown.
        """
        by_pose = code in {"not_settled", "pointing"}
        if by_pose and offset is None:
            return None  # no pose is known: neither alike nor otherwise
        if (offset is not None and by_pose and not _beyond(offset, self._tolerance)) or not (
            by_pose or code in _ADVICE
        ):
            self._ended_otherwise()
            return None
        if code == "foreign":
            return self._count_foreign(shot, reason)
        elsewhere = code != "stale" and self._count_elsewhere(shot, offset if by_pose else None)
        cause = ("offset", "") if by_pose else (code, re.sub(r"[-+]?\d+(\.\d+)?", "#", reason))
        same = cause == self._cause
        if same and offset is not None and self._offset is not None:
            same = _alike(offset, self._offset, self._tolerance)
        if not same:
            self._cause, self._offset, self._attempts = cause, offset, 0
            self._shots.clear()
        self._attempts += 1
        self._shots.setdefault(shot.index, shot.yaw_deg)
        if self._attempts < ATTEMPTS or self._different_shots() < SHOTS:
            return self._elsewhere_finding(reason) if elsewhere else None
        return self._finding(code, reason)

    def _count_foreign(self, shot: Shot, reason: str) -> Finding | None:
        """Take an attempt at which another station pointed the gimbal."""
        self._ended_otherwise()
        self._foreign[shot.index] = self._foreign.get(shot.index, 0) + 1
        attempts = sum(self._foreign.values())
        if attempts < FOREIGN_ATTEMPTS:
            return None
        hold, advice = _ADVICE["foreign"]
        text = f"the same failure at {len(self._foreign)} shots ({attempts} attempts): {reason}"
        return Finding(code=hold, reason=f"{text}; {advice}, then resume", automatic=False, retry=True)

    def _count_elsewhere(self, shot: Shot, offset: Offset | None) -> bool:
        """Whether so many poses in a row had nothing to do with their targets, however they differ."""
        if offset is None or not _is_elsewhere(offset, self._tolerance):
            self._elsewhere.clear()
            return False
        self._elsewhere[shot.index] = self._elsewhere.get(shot.index, 0) + 1
        return sum(self._elsewhere.values()) >= ATTEMPTS and len(self._elsewhere) >= SHOTS

    def _elsewhere_finding(self, reason: str) -> Finding:
        attempts, shots = sum(self._elsewhere.values()), len(self._elsewhere)
        text = (
            f"the gimbal does not come near its targets by its reports, at {shots} shots in a row ({attempts} attempts;"
            f" the last one {reason})"
        )
        return Finding(code="offset", reason=f"{text}; {_ELSEWHERE_ADVICE}, then resume", automatic=False, retry=True)

    def _different_shots(self) -> int:
        if not (self._vehicle_pans and self._cause == ("offset", "")):
            return len(self._shots)
        headings: list[float] = []
        for yaw in self._shots.values():
            if all(abs((yaw - other + 180.0) % 360.0 - 180.0) >= APART_DEG for other in headings):
                headings.append(yaw)
        return len(headings)

    def _finding(self, code: str, reason: str) -> Finding:
        where = f"at {len(self._shots)} shots in a row ({self._attempts} attempts)"
        if self._offset is not None:
            axes = _beyond(self._offset, self._tolerance)
            off = ", ".join(f"{axis.removesuffix('_deg')} {getattr(self._offset, axis):+.2f}°" for axis in axes)
            hold, advice, what = "offset", _OFFSET_ADVICE, f"the camera points off its target by {off} {where}"
        else:
            (hold, advice), what = _ADVICE[code], f"the same failure {where}: {reason}"
        return Finding(code=hold, reason=f"{what}; {advice}, then resume", automatic=False, retry=True)
