"""Checks of the vehicle: link, message rates, clock, and status."""

from __future__ import annotations

import asyncio
import math
import time
from datetime import UTC, datetime
from typing import Final

from panoexec.adapters.camera.camera_kind import OpenCamera
from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.serial_ports import connection_of
from panoexec.adapters.link.stream_health import DEFAULT_STREAMS
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.adapters.linked_vehicle import LinkedVehicle, linked_vehicle
from panoexec.adapters.mavsdk_vehicle import MavsdkVehicle
from panoexec.clock import Clock
from panoexec.doctor.advice import advise
from panoexec.doctor.camera import check_camera
from panoexec.doctor.findings import Findings
from panoexec.doctor.gimbal import Planner, check_control, check_gimbal, check_reports, plan_here
from panoexec.doctor.message_rates import MessageRates, Rate
from panoexec.errors import DeviceError, LinkError
from panoexec.inputs.config import Config

_MEASURE_S: Final = 4.0
_SETTLE_S: Final = 1.5
_ENOUGH: Final = 0.8
_GIMBAL_LEAST_HZ: Final = 4.0
_CLOCK_APART_S: Final = 2.0
_SYSTEM_TIME: Final = 2
_AUTOPILOT_VERSION: Final = 148
_COMPONENTS: Final = {1: "autopilot", 26: "gimbal", 30: "camera", 18: "companion", 6: "ground station", 27: "ADSB"}
_NAMES: Final = {"ardupilot": "ArduPilot", "px4": "PX4"}
_ESTIMATORS: Final = ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")
_WITHOUT: Final = {
    "GIMBAL_DEVICE_ATTITUDE_STATUS": "no pointing can be verified",
    "ATTITUDE": "the gimbal's yaw cannot be converted to north",
    "GIMBAL_MANAGER_STATUS": "a loss of gimbal control goes undetected",
    "GLOBAL_POSITION_INT": "the position guard and the heading have no data",
    "GPS_RAW_INT": "a lost GPS fix is found only by the estimator's flags",
    "SYS_STATUS": "the battery guard has no data",
    "EXTENDED_SYS_STATE": "the landed state is unknown",
}


async def check_vehicle(
    config: Config, findings: Findings, *, clock: Clock, patience_s: float, photo: bool = False
) -> None:
    """Check everything behind the MAVLink connection; nothing moves, and a photo is taken only with `photo`.

    Args:
        config: the daemon's configuration.
        findings: results are added to it.
        clock: the mission clock; faster than real time for a sped-up simulation.
        patience_s: timeout for autopilot, gimbal and camera each, seconds of real time.
        photo: take one photo to measure its evidence level.
    """
    try:
        url = await asyncio.to_thread(connection_of, config.vehicle)
    except LinkError as error:
        findings.missing("link", "port", str(error), advice="[vehicle] serial or connection")
        return
    try:
        async with linked_vehicle(config, url, clock=clock) as linked:
            await examine_vehicle(linked, config, findings, patience_s=patience_s, photo=photo)
    except LinkError as error:
        findings.missing("link", "port", str(error), advice=error.advice or _where(config))


def _where(config: Config) -> str:
    """The key that says where the autopilot is."""
    serial = config.vehicle.serial
    if serial is None:
        return "[vehicle] connection"
    return (
        "[vehicle] serial"
        if serial == "auto"
        else '[vehicle] serial: another device, or "auto", which finds it by USB id'
    )


async def examine_vehicle(
    linked: LinkedVehicle,
    config: Config,
    findings: Findings,
    *,
    patience_s: float,
    photo: bool = False,
    camera: OpenCamera | None = None,
    planner: Planner = plan_here,
    in_use: bool = False,
) -> None:
    """Check everything on an open link.

    Args:
        linked: the link, which stays open.
        config: the daemon's configuration.
        findings: results are added to it.
        patience_s: timeout for autopilot, gimbal and camera each, seconds of real time.
        photo: take one photo to measure its evidence level.
        camera: the open camera; None: open the configured one for the time of the check.
        planner: plans the configured panorama.
        in_use: a mission uses the devices: nothing is asked of them that could disturb it.
    """
    link, gimbal, vehicle = linked.link, linked.gimbal, linked.vehicle
    findings.ok("link", "port", str(link.url))
    if not await _examine_link(link, findings, patience_s=patience_s):
        for area in ("rates", "gimbal", "camera", "vehicle"):
            findings.note(area, "not examined", "no autopilot found")
        return
    there = await check_gimbal(
        gimbal, link, config, findings, patience_s=patience_s, planner=None if in_use else planner
    )
    try:
        await _examine_rates(link, findings, gimbal if there else None, active=in_use)
        if there:
            await check_reports(gimbal, config, findings, since_s=link.clock.monotonic() - _MEASURE_S)
        _examine_components(link, findings)
        if there and in_use:
            holder = "panoexec" if gimbal.in_control else f"{gimbal.controlled_by or 'unknown'}"
            findings.note("gimbal", "control", f"a mission is under way; in control: {holder}")
        elif there:
            await check_control(gimbal, findings)
        await check_camera(
            link, config, findings, patience_s=patience_s, photo=photo and not in_use, camera=camera, in_use=in_use
        )
        if photo and in_use:
            findings.note("camera", "photo", "not taken: a mission is under way")
        if link.files.refused:
            findings.warning(
                "camera",
                "file names",
                link.files.refused,
                needed="photos whose place is expected",
                advice="[camera] file_folders for photos on this computer, file_hosts for those that a camera serves",
            )
        await _examine_clock(link, findings)
        _examine_status(vehicle, config, findings)
    finally:
        if not in_use:
            await link.use_rates(active=False)


def gimbal_is_earth(gimbal: MavsdkGimbal) -> bool:
    """Whether the gimbal's attitude reports are relative to the earth (no vehicle attitude needed)."""
    return gimbal.found is not None and gimbal.found.feedback == "earth"


# --- the link


async def _examine_link(link: MavsdkLink, findings: Findings, *, patience_s: float) -> bool:
    try:
        await link.wait_autopilot(patience_s)
    except LinkError as error:
        findings.missing("link", "autopilot", str(error), needed="heartbeats", advice=advise("link", ""))
        return False
    kind = link.autopilot
    findings.autopilot = kind if kind in ("ardupilot", "px4") else ""
    found = f"{_NAMES.get(kind or '', 'unknown')} {await _version(link)}".strip() + f", system {link.vehicle_system_id}"
    if kind in _NAMES:
        findings.ok("link", "autopilot", found)
    else:
        findings.warning(
            "link", "autopilot", found, needed="ArduPilot or PX4: the vehicle is not turned, parameters are not known"
        )
    _examine_identity(link, findings)
    return True


def _examine_identity(link: MavsdkLink, findings: Findings) -> None:
    """Whether this is certainly the right vehicle."""
    identity = link.identity
    if identity.problem:
        advice = "[vehicle] system_id"
        findings.missing("link", "vehicle", identity.problem, needed="one vehicle, or its system id", advice=advice)
        return
    others = ", ".join(f"{member.system}" for member in identity.others)
    findings.ok(
        "link", "vehicle", identity.label + (f"; other vehicles on this link: system {others}" if others else "")
    )


def _examine_components(link: MavsdkLink, findings: Findings) -> None:
    """Report the other components; all of them have sent heartbeats by now."""
    others = [
        f"{component} ({_COMPONENTS.get(kind, f'MAV_TYPE {kind}')})"
        for component, (kind, _) in sorted(link.components.items())
        if component != AUTOPILOT
    ]
    elsewhere = [
        f"{member.system}/{member.component} ({_COMPONENTS.get(member.kind, f'MAV_TYPE {member.kind}')})"
        for member in link.identity.strangers
    ]
    beside = f"; of other systems: {', '.join(elsewhere)}" if elsewhere else ""
    findings.note("link", "components", f"{', '.join(others) or 'none'} beside the autopilot{beside}")
    if link.has_id_conflict:
        system, component = link.own_ids
        findings.missing(
            "link",
            "our ids",
            f"another component sends heartbeats as {system}/{component}",
            needed="a unique MAVLink id",
            advice="change [vehicle] component_id, or stop the other program (a second panoexec?)",
        )


async def _version(link: MavsdkLink) -> str:
    try:
        message = await link.requests.message(_AUTOPILOT_VERSION, "AUTOPILOT_VERSION")
    except DeviceError:
        return ""
    word = int(message.fields["flight_sw_version"])
    return f"{word >> 24 & 0xFF}.{word >> 16 & 0xFF}.{word >> 8 & 0xFF}"


# --- rates


async def _examine_rates(link: MavsdkLink, findings: Findings, gimbal: MavsdkGimbal | None, *, active: bool) -> None:
    """Measure message rates at the rates requested during a mission; `active`: they are requested already."""
    clock = link.clock
    earth = gimbal is not None and gimbal_is_earth(gimbal)
    if not active:
        await link.use_rates(active=True)
        if gimbal is not None:
            await gimbal.ask_rate()
        await clock.sleep(_SETTLE_S)
    meters = [MessageRates(link, stream.name) for stream in DEFAULT_STREAMS]
    for meter in meters:
        meter.start()
    await clock.sleep(_MEASURE_S)
    rates = {meter.name: meter.stop() for meter in meters}
    reports = {report.stream.name: report for report in link.streams.reports()}
    own = {rate.component for rate in rates["GIMBAL_DEVICE_ATTITUDE_STATUS"]} - {AUTOPILOT}
    for stream in DEFAULT_STREAMS:
        if stream.name in _ESTIMATORS:
            continue
        wanted_hz = reports[stream.name].wanted_hz
        if stream.name == "GIMBAL_DEVICE_ATTITUDE_STATUS" and own:
            wanted_hz = stream.rate_hz  # the autopilot's copy is throttled: the gimbal's own reports count
        _judge_rate(
            findings, stream.name, rates[stream.name], wanted_hz, earth=earth, refused=reports[stream.name].refused
        )
    _judge_estimator(findings, rates)


def _judge_rate(
    findings: Findings, name: str, rates: list[Rate], wanted_hz: float, *, earth: bool, refused: bool
) -> None:
    best = rates[0] if rates else Rate(component=0, hz=0.0, gap_s=math.inf)
    needed = f"{wanted_hz:g} Hz"
    advice = advise("rates", findings.autopilot)
    if best.hz >= _ENOUGH * wanted_hz:
        sender = "" if best.component == AUTOPILOT else f" from component {best.component}"
        findings.ok("rates", name, f"{best.hz:.1f} Hz{sender}, longest gap {1000 * best.gap_s:.0f} ms", needed=needed)
        return
    found = f"{best.hz:.1f} Hz" if best.hz else "request denied" if refused else "not received"
    if not best.hz:
        found += f": {_WITHOUT[name]}"
    if name == "GIMBAL_DEVICE_ATTITUDE_STATUS" and best.hz > _GIMBAL_LEAST_HZ:
        found += f" from component {best.component}, longest gap {1000 * best.gap_s:.0f} ms: poses settle more slowly"
        if best.component != AUTOPILOT:
            advice = "the gimbal's own settings, if it has a rate of its MAVLink attitude"
    least_hz = _GIMBAL_LEAST_HZ if name == "GIMBAL_DEVICE_ATTITUDE_STATUS" else 0.0
    needless = name == "ATTITUDE" and earth
    if name in ("GIMBAL_DEVICE_ATTITUDE_STATUS", "ATTITUDE") and best.hz <= least_hz and not needless:
        findings.missing("rates", name, found, needed=needed, advice=advice)
    else:
        findings.warning("rates", name, found, needed=needed, advice=advice)


def _judge_estimator(findings: Findings, rates: dict[str, list[Rate]]) -> None:
    """ArduPilot sends one of the messages, PX4 the other; either is sufficient."""
    for name in _ESTIMATORS:
        if rates[name]:
            findings.ok("rates", name, f"{rates[name][0].hz:.1f} Hz")
            return
    findings.note("rates", " or ".join(_ESTIMATORS), "not received: SYS_STATUS is used for the position status")


# --- the vehicle itself


async def _examine_clock(link: MavsdkLink, findings: Findings) -> None:
    """Compare this computer's clock with the GPS time of the autopilot (SYSTEM_TIME, 2)."""
    try:
        message = await link.requests.message(_SYSTEM_TIME, "SYSTEM_TIME")
    except DeviceError:
        findings.note("clock", "vehicle", "the autopilot does not report its time")
        return
    vehicle_s = int(message.fields["time_unix_usec"]) / 1e6
    if vehicle_s <= 0:
        findings.note(
            "clock", "vehicle", "the autopilot has no GPS time yet", advice=advise("time", findings.autopilot)
        )
        return
    apart_s = time.time() - vehicle_s
    shown = datetime.fromtimestamp(vehicle_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    text = f"{shown}, this computer is {abs(apart_s):.1f} s {'ahead' if apart_s > 0 else 'behind'}"
    if abs(apart_s) > _CLOCK_APART_S:
        findings.warning(
            "clock",
            "vehicle",
            text,
            needed=f"within {_CLOCK_APART_S:g} s",
            advice="synchronise this computer's clock with a time service",
        )
    else:
        findings.ok("clock", "vehicle", text)


def _examine_status(vehicle: MavsdkVehicle, config: Config, findings: Findings) -> None:
    """Evaluate the guards' conditions now."""
    status, guards, autopilot = vehicle.status, config.guards, findings.autopilot
    floor = f"{100 * guards.battery_floor_frac:.0f} % ([guards] battery_floor_frac)"
    if math.isnan(status.battery_frac):
        findings.warning(
            "vehicle", "battery", "not reported: no guard", needed=floor, advice=advise("battery", autopilot)
        )
    elif status.battery_frac < guards.battery_floor_frac:
        findings.missing("vehicle", "battery", f"{100 * status.battery_frac:.0f} %", needed=floor, advice="charge it")
    else:
        findings.ok("vehicle", "battery", f"{100 * status.battery_frac:.0f} %", needed=floor)
    if status.position_ok and math.isfinite(status.heading_deg):
        findings.ok("vehicle", "position", f"good, heading {status.heading_deg:.0f}°")
    else:
        findings.warning(
            "vehicle", "position", "not valid (yet)", needed="a position hold", advice=advise("position", autopilot)
        )
    modes = ", ".join(guards.allowed_modes)
    if guards.allowed_modes and status.mode not in guards.allowed_modes:
        findings.warning(
            "vehicle",
            "flight mode",
            f"{status.mode_text} now",
            needed=f"{modes} at the start of a mission",
            advice="change the mode, or [guards] allowed_modes (OFFBOARD is ArduPilot's GUIDED, HOLD its LOITER)",
        )
    elif config.gimbal.yaw != "gimbal" and status.mode not in vehicle.turn_modes:
        findings.warning(
            "vehicle",
            "flight mode",
            f"{status.mode_text} now",
            needed=f"{' or '.join(vehicle.turn_modes)} if the vehicle pans ([gimbal] yaw)",
            advice="change the flight mode (OFFBOARD is ArduPilot's GUIDED)",
        )
    else:
        findings.ok("vehicle", "flight mode", status.mode_text)
    where = "in the air" if status.in_air else "on the ground"
    findings.note("vehicle", "state", f"{where}, {'armed' if status.armed else 'disarmed'}")
