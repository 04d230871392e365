"""Duration of a plan: slews at the gimbal's rates and accelerations, settling, exposure, camera interval."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray, wrap_180
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.model import Band, Estimate, GimbalLimits, Plan, Shot, Timing, Turning
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
    """Time from the last exposure at one pose to the last one at the next (s): slew, settling, exposures, intervals."""
    own = np.asarray(slews_s, dtype=np.float64) + timing.settle_s + timing.trigger_latency_s + timing.exposure_s
    return np.maximum(own, timing.interval_s) + _further_s(timing)


def _further_s(timing: Timing) -> float:
    """What the photos of a bracket beyond the first take, seconds."""
    return (timing.brackets - 1) * max(timing.interval_s, timing.trigger_latency_s + timing.exposure_s)


def path_duration_s(shots: Sequence[Shot], limits: GimbalLimits, timing: Timing) -> float:
    """Seconds from the start of the first settling to the end of the last exposure, in the given order, no retakes."""
    return float(_ends_s(shots, limits, timing)[-1]) if shots else 0.0


def _ends_s(shots: Sequence[Shot], limits: GimbalLimits, timing: Timing) -> FloatArray:
    """When the last exposure of each shot ends, (n,), seconds after the start of the first settling."""
    first_s = timing.settle_s + timing.trigger_latency_s + timing.exposure_s + _further_s(timing)
    steps = shot_times_s(timing, _slews_s(shots, limits)) if len(shots) > 1 else np.empty(0)
    return np.cumsum(np.concatenate([[first_s], steps]))


def _over_s(ends_s: FloatArray, timing: Timing) -> float:
    """When the last photo is examined: files arrive one after the other, and are examined one after the other."""
    here_s = checked_s = 0.0
    for end_s in ends_s.tolist():
        here_s = max(here_s, end_s) + timing.brackets * timing.transfer_s
        checked_s = max(checked_s, here_s) + timing.brackets * timing.check_s
    return max(here_s, checked_s)


def estimate(
    shots: Sequence[Shot], camera: Camera, limits: GimbalLimits, timing: Timing, band: Band | None = None
) -> Estimate:
    """Expected duration, slew angle and other figures of these shots in this order.

    Args:
        shots: in shooting order.
        camera: the camera.
        limits: rates of the gimbal, and turns of the vehicle.
        timing: what a shot costs besides the slew.
        band: that is covered; None for the whole sphere.
    """
    pitch, yaw = _angles(shots)
    turned = np.maximum(np.abs(np.diff(pitch)), np.abs(yaw_travel_deg(limits, yaw[:-1], yaw[1:])))
    ends_s = _ends_s(shots, limits, timing) if shots else np.zeros(1)
    shooting_s, over_s = float(ends_s[-1]), _over_s(ends_s, timing) if shots else 0.0
    return Estimate(
        duration_s=round(over_s, 3),
        slew_deg=round(float(turned.sum()), 3),
        panorama_px=camera.panorama_px(),
        band_px=_band_px(camera, band),
        after_s=round(over_s - shooting_s, 3),
    )


def _band_px(camera: Camera, band: Band | None) -> tuple[int, int]:
    width, height = camera.panorama_px()
    if band is None:
        return width, height
    per_degree = width / 360
    return (
        max(1, round(per_degree * band.azimuth_span_deg)),
        max(1, round(per_degree * (band.elevation_max_deg - band.elevation_min_deg))),
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
