"""Preflight checks, made before the gimbal moves; each problem is one line for the pilot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from panoexec.angles import wrap_180
from panoexec.devices import AttitudeSample, Camera, Gimbal, GimbalKnowledge, Vehicle
from panoexec.mission.pointing.poses import GIMBAL_FAILURES
from panoexec.mission.pointing.steady_error import cannot_hold
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.planning.model import GimbalLimits, Shot, Tolerance
from panoexec.planning.order.vehicle_yaw import PanReach

PILOT_MODE_NAMES = {"OFFBOARD": "OFFBOARD (ArduPilot: GUIDED)", "HOLD": "HOLD (PX4: Hold)"}
"""Flight mode names that pilots know, by MAVSDK's names."""

IDLE_SILENCE_S = 2.5
"""Least attitude timeout while the gimbal is not held: its attitude is then read or streamed at 1 to 2 Hz."""
ECHO_ADVICE = (
    'use a gimbal that reports measured angles, or set [gimbal] feedback = "none" to fly without verified poses'
)
"""What to do about a gimbal whose reports repeat the command."""
FRESH_FRAC = 0.9
"""A battery above this counts as full: it has just taken off."""


def limit_problems(shots: Iterable[Shot], limits: GimbalLimits, *, margin_deg: float = 1e-6) -> list[str]:
    """Shots that the gimbal cannot reach: one line per axis, with the worst shot.

    Yaw limits are relative to the vehicle's heading, and so must the shots' yaws be; they are checked only if the pan
    range is less than a full turn.
    """
    out: dict[str, tuple[float, str, int]] = {}
    for shot in shots:
        for axis, value, low, high in (
            ("pitch", shot.pitch_deg, limits.pitch_min_deg, limits.pitch_max_deg),
            ("yaw", shot.yaw_deg, limits.yaw_min_deg, limits.yaw_max_deg),
        ):
            if axis == "yaw" and (limits.all_round or high - low >= 360.0):
                continue
            beyond = max(low - value, value - high)
            if beyond <= margin_deg:
                continue
            worst, _, count = out.get(axis, (0.0, "", 0))
            text = f"shot {shot.index} at {axis} {value:.2f}° is outside the gimbal's {low:g}° to {high:g}°"
            if axis == "yaw":
                text += ' relative to the heading (gimbal.yaw = "auto" lets the vehicle turn)'
            out[axis] = (beyond, text, count + 1) if beyond > worst else (worst, out[axis][1], count + 1)
    return [text + (f" (and {count - 1} more)" if count > 1 else "") for _, text, count in out.values()]


def gimbal_limits(gimbal: Gimbal, settings: MissionSettings) -> GimbalLimits:
    """The effective limits: ranges as the gimbal reports them, else as configured; rates always as configured."""
    return effective_limits(gimbal.limits, settings.gimbal)


def effective_limits(own: GimbalLimits | None, configured: GimbalLimits) -> GimbalLimits:
    """The limits that the gimbal reports (None: none) combined with the configured ones; see `gimbal_limits`."""
    if own is None:
        return configured
    pitch = replace(configured, pitch_min_deg=own.pitch_min_deg, pitch_max_deg=own.pitch_max_deg)
    if configured.turning is not None and not configured.pans:  # the vehicle pans: a pan axis is not used
        return pitch
    return replace(
        pitch,
        yaw_min_deg=own.yaw_min_deg,
        yaw_max_deg=own.yaw_max_deg,
        yaw_endless=own.yaw_endless,
    )


def preflight_problems(
    *,
    shots: Sequence[Shot],
    settings: MissionSettings,
    gimbal: Gimbal,
    camera: Camera,
    vehicle: Vehicle,
    reference_yaw_north_deg: float,
    now_s: float,
    expected_s: float,
) -> list[str]:
    """Everything that prevents a start now; empty if nothing does.

    Args:
        shots: the remaining shots, in the plan's frame.
        settings: the mission's.
        gimbal: its limits and newest attitude are read.
        camera: its free storage is read.
        vehicle: its status is read.
        reference_yaw_north_deg: direction of the plan's yaw 0 from true north.
        now_s: on the mission's clock.
        expected_s: expected duration of those shots.
    """
    status = vehicle.status
    guards = settings.guards
    if not status.connected:
        return ["no heartbeat from the autopilot: check the link"]
    problems = []
    if settings.feedback != "none":
        silence_s = max(guards.attitude_silence_s, IDLE_SILENCE_S)
        gimbal.feed.ingest()
        problems += attitude_problems(gimbal.feed.latest, now_s=now_s, silence_s=silence_s)
        problems += feedback_problems(gimbal.known, settings.tolerance)
    turn = reference_yaw_north_deg - status.heading_deg
    forward = [
        Shot(index=s.index, row=s.row, pitch_deg=s.pitch_deg, yaw_deg=float(wrap_180(s.yaw_deg + turn)))
        for s in shots
        if math.isfinite(turn)
    ]
    limits = gimbal_limits(gimbal, settings)
    problems += limit_problems(forward or shots, limits)
    problems += turning_problems(forward, limits, vehicle)
    needed = len(shots) * settings.brackets
    if camera.storage_free_images < needed:
        problems.append(f"the camera has room for {camera.storage_free_images:g} photos, {needed} are needed")
    problems += battery_problems(status.battery_frac, guards, expected_s=expected_s)
    if status.unhealthy:
        problems.append(f"the autopilot reports as unhealthy: {', '.join(status.unhealthy)}")
    if guards.position_hold and not status.in_air:
        problems.append("the vehicle is not in the air: take off and hover")
    if guards.position_hold and not status.position_ok:
        problems.append("the vehicle has no valid position and cannot hold it")
    if guards.allowed_modes and status.mode not in guards.allowed_modes:
        problems.append(f"flight mode is {status.mode_text}; allowed: {', '.join(guards.allowed_modes)}")
    return problems


def battery_problems(charge_frac: float, guards: GuardSettings, *, expected_s: float) -> list[str]:
    """Why a mission must not begin with this charge; empty if it may, or if the charge is unknown.

    A mission that a full battery could not finish either may begin (see `battery_warning`): it needs several.

    Args:
        charge_frac: 0 to 1, NaN if not reported.
        guards: floor, and hover time of a full battery.
        expected_s: expected duration of the shots.
    """
    floor_frac = guards.battery_floor_frac
    have, floor = f"battery at {100 * charge_frac:.0f} %", f"{100 * floor_frac:.0f} %"
    if charge_frac < floor_frac:
        return [f"{have}, the floor is {floor}"]
    needed_frac = battery_need_frac(guards, expected_s)
    enough = not charge_frac - floor_frac < needed_frac  # NaN: not reported
    if enough or charge_frac >= FRESH_FRAC or needed_frac > FRESH_FRAC - floor_frac:
        return []
    needed = f"{expected_s / 60:.1f} min of shooting need about {100 * needed_frac:.0f} %"
    return [
        f"{have}: {needed}, and {floor} must remain; start with a full battery ([guards] hover_min: its hover time)"
    ]


def battery_warning(charge_frac: float, guards: GuardSettings, *, expected_s: float) -> str:
    """The warning for a mission that this battery cannot finish; "" if it can."""
    needed_frac = battery_need_frac(guards, expected_s)
    if not charge_frac - guards.battery_floor_frac < needed_frac:
        return ""
    return (
        f"{expected_s / 60:.0f} min of shooting exceed this battery: the mission will pause at"
        f" {100 * guards.battery_floor_frac:.0f} % and can be resumed with a full battery"
    )


def battery_need_frac(guards: GuardSettings, expected_s: float) -> float:
    """The part of a full battery that this much shooting needs; 0 without a hover time."""
    return expected_s / guards.hover_s if guards.hover_s > 0 else 0.0


def turning_problems(forward: Sequence[Shot], limits: GimbalLimits, vehicle: Vehicle) -> list[str]:
    """Why the vehicle cannot make the turns that these shots need; empty if it can, or need not turn.

    Args:
        forward: the shots, yaw relative to the vehicle's heading; empty while that is unknown.
        limits: of the gimbal and of turns.
        vehicle: its flight mode is read.
    """
    if limits.turning is None:
        return []
    if not forward:
        return ["the vehicle's heading is unknown, but it may have to turn"]
    reach = PanReach.of(limits)
    beyond = sum(not reach.has(shot.yaw_deg, 0.0) for shot in forward)
    if not beyond or vehicle.status.mode in vehicle.turn_modes:
        return []
    return [f"{beyond} shots need the vehicle to turn: {cannot_turn(vehicle.status.mode_text, vehicle.turn_modes)}"]


def cannot_turn(mode: str, turn_modes: Sequence[str]) -> str:
    """Text for the pilot: the vehicle does not turn in this mode, but in those."""
    names = [PILOT_MODE_NAMES.get(name, name) for name in turn_modes]
    return f"it does not turn in flight mode {mode}; change to {' or '.join(names) or 'another mode'}"


def feedback_problems(known: GimbalKnowledge, tolerance: Tolerance) -> list[str]:
    """Why the reports of this gimbal do not prove poses, or why it cannot hold the tolerance; empty if nothing is."""
    if known.echo:
        return [f"the gimbal's reports are no feedback: {known.echo}; {ECHO_ADVICE}"]
    why = "" if known.steady_error is None else cannot_hold(known.steady_error, tolerance)
    return [why] if why else []


def attitude_problems(sample: AttitudeSample | None, *, now_s: float, silence_s: float) -> list[str]:
    """The faults of the gimbal's attitude stream."""
    if sample is None:
        return ["the gimbal sends no attitude: check that it is connected and that its messages are streamed"]
    if now_s - sample.received_s > silence_s:
        return [f"the gimbal's last attitude is {now_s - sample.received_s:.1f} s old"]
    if not all(math.isfinite(value) for value in sample.q_wxyz):
        return ["the gimbal reports a non-finite attitude"]
    flagged = [name for flag, name in GIMBAL_FAILURES.items() if sample.failure_flags & flag]
    return [f"the gimbal reports: {', '.join(flagged)}"] if flagged else []
