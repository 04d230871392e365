"""What the gimbal can point to: the last check of every plan, whatever method made it."""

from __future__ import annotations

from collections.abc import Sequence

from panoexec.errors import PlanningError
from panoexec.planning.model import GimbalLimits, Shot

_ROUNDING_DEG = 1e-6
"""More than the rounding of angles in plans, far less than any gimbal can tell."""


def reaches_yaw(gimbal: GimbalLimits, yaw_deg: float) -> bool:
    """Whether the gimbal, or the vehicle in its place, can turn the camera to a yaw of any number of turns."""
    if gimbal.all_round:
        return True
    beyond = (yaw_deg - gimbal.yaw_min_deg + _ROUNDING_DEG) % 360.0
    return beyond <= gimbal.yaw_max_deg - gimbal.yaw_min_deg + 2 * _ROUNDING_DEG


def reaches_pitch(gimbal: GimbalLimits, pitch_deg: float) -> bool:
    """Whether the gimbal can tilt the camera to a pitch."""
    return gimbal.pitch_min_deg - _ROUNDING_DEG <= pitch_deg <= gimbal.pitch_max_deg + _ROUNDING_DEG


def check_not_rolled(shots: Sequence[Shot]) -> None:
    """Reject shots that are rolled: gimbals are commanded with roll 0.

    Raises:
        PlanningError: names the first of them.
    """
    rolled = [shot for shot in shots if abs(shot.roll_deg) > _ROUNDING_DEG]
    if rolled:
        raise PlanningError(
            f"shot {rolled[0].index} has roll_deg {rolled[0].roll_deg:g}, as have {len(rolled)} of {len(shots)}: "
            "gimbals are commanded with roll 0; such a plan can be verified and exported, not flown"
        )


def check_reachable(shots: Sequence[Shot], gimbal: GimbalLimits | None) -> None:
    """Reject shots outside the gimbal's limits.

    Raises:
        PlanningError: names the first shot outside, its angle, the limit and what to change.
    """
    if gimbal is None:
        return
    for shot in shots:
        if not reaches_pitch(gimbal, shot.pitch_deg):
            raise PlanningError(
                f"the plan needs a row at pitch {shot.pitch_deg:.1f}°, the gimbal reaches "
                f"{gimbal.pitch_min_deg:g} to {gimbal.pitch_max_deg:g}°: ask for a smaller elevation band"
            )
        if not reaches_yaw(gimbal, shot.yaw_deg):
            raise PlanningError(
                f"the plan needs a shot at yaw {shot.yaw_deg:.1f}°, the gimbal pans from "
                f"{gimbal.yaw_min_deg:g} to {gimbal.yaw_max_deg:g}°: ask for a smaller azimuth sector, "
                "or let the vehicle pan the rest (yaw: auto)"
            )
