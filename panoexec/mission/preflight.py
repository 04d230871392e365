"""Checks before a mission moves anything: each problem one line for a pilot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from panoexec.angles import wrap_180
from panoexec.devices import AttitudeSample, Camera, Gimbal, Vehicle
from panoexec.mission.pointing.poses import GIMBAL_FAILURES
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.planning.model import GimbalLimits, Shot
from panoexec.planning.order.vehicle_yaw import PanReach

PILOTS_NAMES = {"OFFBOARD": "OFFBOARD (ArduPilot: GUIDED)", "HOLD": "HOLD (PX4: Hold)"}
"""Flight modes as pilots know them, by MAVSDK's names."""

LEISURELY_S = 2.5
"""While the gimbal is not held, its reports are looked at once a second, or come twice: silence is longer."""
FRESH_FRAC = 0.9
"""A battery with more than this is as full as one is that has just taken off."""


def limit_problems(shots: Iterable[Shot], limits: GimbalLimits, *, margin_deg: float = 1e-6) -> list[str]:
    """Shots that the gimbal cannot reach: one line an axis and end, with the worst of them.

    Yaw limits mean yaw from the vehicle's heading; they are checked only where the pan range has no full turn and the
    caller gives shots in that frame.
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
                text += ' of the nose (gimbal.yaw = "auto" lets the vehicle turn)'
            out[axis] = (beyond, text, count + 1) if beyond > worst else (worst, out[axis][1], count + 1)
    return [text + (f" (and {count - 1} more)" if count > 1 else "") for _, text, count in out.values()]


def gimbal_limits(gimbal: Gimbal, settings: MissionSettings) -> GimbalLimits:
    """The limits that hold: ranges as the gimbal states them, else as configured; rates always as configured."""
    return limits_that_hold(gimbal.limits, settings.gimbal)


def limits_that_hold(own: GimbalLimits | None, configured: GimbalLimits) -> GimbalLimits:
    """What the gimbal states (None: nothing) with what is configured; see `gimbal_limits`."""
    if own is None:
        return configured
    pitch = replace(configured, pitch_min_deg=own.pitch_min_deg, pitch_max_deg=own.pitch_max_deg)
    if configured.turning is not None and not configured.pans:  # a pan axis is not used where the vehicle is to pan
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
    """Everything that speaks against beginning now; empty when all is well.

    Args:
        shots: those still to be taken, in the plan's frame.
        settings: the mission's.
        gimbal: asked for limits and its newest attitude.
        camera: asked for its storage.
        vehicle: asked for its status.
        reference_yaw_north_deg: direction of the plan's yaw 0 from true north.
        now_s: on the mission's clock.
        expected_s: how long those shots will take.
    """
    status = vehicle.status
    guards = settings.guards
    if not status.connected:
        return ["no heartbeat from the autopilot: check the link"]
    problems = []
    if settings.feedback != "none":
        silence_s = max(guards.attitude_silence_s, LEISURELY_S)
        gimbal.feed.ingest()
        problems += attitude_problems(gimbal.feed.latest, now_s=now_s, silence_s=silence_s)
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
        problems.append(f"the autopilot calls unhealthy what its attitude rests on: {', '.join(status.unhealthy)}")
    if guards.position_hold and not status.in_air:
        problems.append("the vehicle is not in the air: take off and hover")
    if guards.position_hold and not status.position_ok:
        problems.append("the vehicle has no good position: it cannot hold its place")
    if guards.allowed_modes and status.mode not in guards.allowed_modes:
        problems.append(f"flight mode is {status.mode or 'unknown'}; allowed: {', '.join(guards.allowed_modes)}")
    return problems


def battery_problems(charge_frac: float, guards: GuardSettings, *, expected_s: float) -> list[str]:
    """Why a mission must not begin with this charge; empty if it may, or the vehicle does not tell its charge.

    What a fresh battery could not do either is no reason not to begin (`battery_warning`): it is flown on several.

    Args:
        charge_frac: 0 to 1, NaN where it is not told.
        guards: floor, and how long a full battery lasts.
        expected_s: how long shooting will take.
    """
    floor_frac = guards.battery_floor_frac
    have, floor = f"battery at {100 * charge_frac:.0f} %", f"{100 * floor_frac:.0f} %"
    if charge_frac < floor_frac:
        return [f"{have}, the floor is {floor}"]
    needed_frac = _needed_frac(guards, expected_s)
    enough = not charge_frac - floor_frac < needed_frac  # NaN: the vehicle does not say
    if enough or charge_frac >= FRESH_FRAC or needed_frac > FRESH_FRAC - floor_frac:
        return []
    needed = f"the {expected_s / 60:.1f} min of shooting take about {100 * needed_frac:.0f} %"
    return [
        f"{have}: {needed}, and {floor} must remain; begin with a full one ([guards] hover_min: how long that lasts)"
    ]


def battery_warning(charge_frac: float, guards: GuardSettings, *, expected_s: float) -> str:
    """What a pilot should know of a mission that one battery is not enough for; "" if this one is."""
    needed_frac = _needed_frac(guards, expected_s)
    if not charge_frac - guards.battery_floor_frac < needed_frac:
        return ""
    return (
        f"{expected_s / 60:.0f} min of shooting are more than this battery lasts: it will pause at"
        f" {100 * guards.battery_floor_frac:.0f} % and can be resumed with a full one"
    )


def _needed_frac(guards: GuardSettings, expected_s: float) -> float:
    return expected_s / guards.hover_s if guards.hover_s > 0 else 0.0


def turning_problems(forward: Sequence[Shot], limits: GimbalLimits, vehicle: Vehicle) -> list[str]:
    """Why a vehicle that must be turned for these shots cannot be; empty if it can, or need not.

    Args:
        forward: the shots, yaw from the vehicle's nose; empty while its heading is unknown.
        limits: of the gimbal, and of the turning.
        vehicle: asked for its mode.
    """
    if limits.turning is None:
        return []
    if not forward:
        return ["the vehicle does not say where its nose points, and may have to be turned"]
    reach = PanReach.of(limits)
    beyond = sum(not reach.has(shot.yaw_deg, 0.0) for shot in forward)
    if not beyond or vehicle.status.mode in vehicle.turn_modes:
        return []
    return [f"{beyond} shots need the vehicle to turn: {cannot_turn(vehicle.status.mode, vehicle.turn_modes)}"]


def cannot_turn(mode: str, turn_modes: Sequence[str]) -> str:
    """Why a vehicle does not turn in this mode, and in which it does, in words for its pilot."""
    names = [PILOTS_NAMES.get(name, name) for name in turn_modes]
    return f"in flight mode {mode or 'unknown'} it cannot be turned; change to {' or '.join(names) or 'another one'}"


def attitude_problems(sample: AttitudeSample | None, *, now_s: float, silence_s: float) -> list[str]:
    """What is wrong with the gimbal's attitude stream."""
    if sample is None:
        return ["the gimbal reports no attitude: check that it is connected and that its messages are streamed"]
    if now_s - sample.received_s > silence_s:
        return [f"the gimbal's last attitude is {now_s - sample.received_s:.1f} s old"]
    if not all(math.isfinite(value) for value in sample.q_wxyz):
        return ["the gimbal reports an attitude that is not a number"]
    flagged = [name for flag, name in GIMBAL_FAILURES.items() if sample.failure_flags & flag]
    return [f"the gimbal reports: {', '.join(flagged)}"] if flagged else []
