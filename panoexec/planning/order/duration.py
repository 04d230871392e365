"""Duration of a plan: slews at the gimbal's rates and accelerations, settling, exposure, camera interval."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray, wrap_180
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.model import Estimate, GimbalLimits, Plan, Shot, Timing, Turning
from panoexec.planning.order.vehicle_yaw import NO_TURN_DEG, headings_deg


def axis_time_s(angle_deg: ArrayLike, rate_deg_s: float, acceleration_deg_s2: float) -> FloatArray:
    """Minimum time (s) of one axis from rest to rest: trapezoidal speed profile, or triangular below the full rate."""
    angle = np.abs(np.asarray(angle_deg, dtype=np.float64))
    trapezoid = angle / rate_deg_s + rate_deg_s / acceleration_deg_s2
    return np.where(angle >= rate_deg_s**2 / acceleration_deg_s2, trapezoid, 2 * np.sqrt(angle / acceleration_deg_s2))


def yaw_travel_deg(limits: GimbalLimits, from_yaw_deg: ArrayLike, to_yaw_deg: ArrayLike) -> FloatArray:
    """Signed pan angle: the shorter way for a continuous pan axis, else the way that does not cross ±180°."""
    travel = np.asarray(to_yaw_deg, dtype=np.float64) - np.asarray(from_yaw_deg, dtype=np.float64)
    return wrap_180(travel) if limits.all_round else travel


def slew_times_s(
    limits: GimbalLimits,
    from_pitch_deg: ArrayLike,
    from_yaw_deg: ArrayLike,
    to_pitch_deg: ArrayLike,
    to_yaw_deg: ArrayLike,
) -> FloatArray:
    """Minimum slew times, seconds; both axes move simultaneously (Chebyshev metric); arguments broadcast.

    Where the gimbal has no pan axis the vehicle yaws, and its heading must settle. Turns of the vehicle with a gimbal
    that pans part of the circle depend on more than two poses: see `panoexec.planning.order.vehicle_yaw`.
    """
    travel = np.asarray(to_pitch_deg, dtype=np.float64) - np.asarray(from_pitch_deg, dtype=np.float64)
    pitch_s = axis_time_s(travel, limits.pitch_rate_deg_s, limits.pitch_acceleration_deg_s2)
    yaw = yaw_travel_deg(limits, from_yaw_deg, to_yaw_deg)
    if limits.turning is not None and not limits.pans:
        return np.maximum(pitch_s, turn_times_s(limits.turning, yaw))
    return np.maximum(pitch_s, axis_time_s(yaw, limits.yaw_rate_deg_s, limits.yaw_acceleration_deg_s2))


def turn_times_s(turning: Turning, angle_deg: ArrayLike) -> FloatArray:
    """Times (s) of turns of the vehicle, including settling of the heading; 0 for an angle of 0."""
    angle = np.abs(np.asarray(angle_deg, dtype=np.float64))
    moving_s = axis_time_s(angle, turning.rate_deg_s, turning.acceleration_deg_s2) + turning.settle_s
    return np.where(angle > NO_TURN_DEG, moving_s, 0.0)


def slew_time_s(
    limits: GimbalLimits, *, from_pitch_deg: float, from_yaw_deg: float, to_pitch_deg: float, to_yaw_deg: float
) -> float:
    """Minimum time of one slew, seconds."""
    return float(slew_times_s(limits, from_pitch_deg, from_yaw_deg, to_pitch_deg, to_yaw_deg))


def shot_times_s(timing: Timing, slews_s: ArrayLike) -> FloatArray:
    """Time from the end of one exposure to the end of the next (s): slew + settling + exposure, or the interval."""
    own = np.asarray(slews_s, dtype=np.float64) + timing.settle_s + timing.trigger_latency_s + timing.exposure_s
    return np.maximum(own, timing.interval_s)


def path_duration_s(shots: Sequence[Shot], limits: GimbalLimits, timing: Timing) -> float:
    """Seconds from the start of the first settling to the end of the last exposure, in the given order, no retakes."""
    first_s = timing.settle_s + timing.trigger_latency_s + timing.exposure_s
    if len(shots) < 2:
        return first_s * len(shots)
    return first_s + float(shot_times_s(timing, _slews_s(shots, limits)).sum())


def estimate(shots: Sequence[Shot], camera: Camera, limits: GimbalLimits, timing: Timing) -> Estimate:
    """Expected duration, slew angle and other figures of these shots in this order."""
    pitch, yaw = _angles(shots)
    turned = np.maximum(np.abs(np.diff(pitch)), np.abs(yaw_travel_deg(limits, yaw[:-1], yaw[1:])))
    return Estimate(
        duration_s=round(path_duration_s(shots, limits, timing), 3),
        slew_deg=round(float(turned.sum()), 3),
        panorama_px=camera.panorama_px(),
    )


def budget_problems(plan: Plan, *, max_images: int | None, max_duration_s: float | None) -> list[str]:
    """The parts of a budget that a plan exceeds, one line each, with the figures."""
    problems = []
    if max_images is not None and len(plan.shots) > max_images:
        problems.append(f"the plan needs {len(plan.shots)} images, {max_images} are allowed")
    duration_s = math.nan if plan.estimate is None else plan.estimate.duration_s
    if max_duration_s is not None and duration_s > max_duration_s:
        problems.append(f"the mission takes about {duration_s:.0f} s, {max_duration_s:g} s are allowed")
    return problems


def check_budget(plan: Plan, *, max_images: int | None, max_duration_s: float | None, hint: str = "") -> None:
    """Reject a plan that exceeds a budget.

    Args:
        plan: the plan, with its estimate.
        max_images: None for no limit.
        max_duration_s: None for no limit.
        hint: what would fit, appended to the message.

    Raises:
        PlanningError: the plan exceeds the budget; the message gives the figures.
    """
    problems = budget_problems(plan, max_images=max_images, max_duration_s=max_duration_s)
    if problems:
        raise PlanningError("; ".join(problems) + (f": {hint}" if hint else ""))


def _angles(shots: Sequence[Shot]) -> tuple[FloatArray, FloatArray]:
    return np.array([shot.pitch_deg for shot in shots]), np.array([shot.yaw_deg for shot in shots])


def _slews_s(shots: Sequence[Shot], limits: GimbalLimits) -> FloatArray:
    pitch, yaw = _angles(shots)
    slews = slew_times_s(limits, pitch[:-1], yaw[:-1], pitch[1:], yaw[1:])
    if limits.turning is None or not limits.pans or limits.yaw_endless:
        return slews
    turned = wrap_180(np.diff(headings_deg(yaw, limits)))
    return np.maximum(slews, turn_times_s(limits.turning, turned))
