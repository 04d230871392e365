"""Checks of the gimbal: discovery, limits, quality of its attitude reports, and control."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Final, TypeAlias

from panoexec.adapters.gimbal.gimbal_choice import in_order
from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.doctor.advice import advise
from panoexec.doctor.findings import Findings
from panoexec.doctor.gimbal_quality import measured
from panoexec.errors import DeviceError, PanoexecError
from panoexec.inputs.camera_profiles import configured_profile
from panoexec.inputs.config import Config
from panoexec.inputs.plan_options import configured_gimbal, configured_spec
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.mission.pointing.steady_error import cannot_hold
from panoexec.mission.preflight import attitude_problems, effective_limits, limit_problems
from panoexec.planning.model import GimbalLimits, Plan

Planner: TypeAlias = Callable[[PlanSpec], Awaitable[Plan]]

_PARAMETERS: Final = {"ardupilot": ("MNT1_TYPE",), "px4": ("MNT_MODE_IN", "MNT_MODE_OUT")}
_KINDS: Final = {
    "earth": "measured, relative to the earth",
    "vehicle": "measured, relative to the vehicle's heading",
    "body": "relative to the airframe, as configured",
    "none": "the commanded angles, not measured",
}


async def plan_here(spec: PlanSpec) -> Plan:
    """Plan in a thread of this process."""
    return await asyncio.to_thread(spec.plan)


async def check_gimbal(
    gimbal: MavsdkGimbal,
    link: MavsdkLink,
    config: Config,
    findings: Findings,
    *,
    patience_s: float,
    planner: Planner | None = plan_here,
) -> bool:
    """Check discovery, limits, feedback and plan (not without `planner`); return whether a gimbal was found."""
    try:
        found = await gimbal.discover(patience_s)
    except DeviceError as error:
        set_now = await _parameters(link, findings.autopilot)
        told = f"{error}{f' (now {set_now})' if set_now else ''}"
        findings.missing(
            "gimbal", "found", told, needed="a MAVLink gimbal manager", advice=advise("gimbal", findings.autopilot)
        )
        return False
    name = f"{found.vendor} {found.model}".strip() or "unnamed"
    set_now = await _parameters(link, findings.autopilot)
    findings.ok(
        "gimbal",
        "found",
        f"{name}, manager {found.manager_component}, device {found.device_id}{f', {set_now}' if set_now else ''}",
    )
    _list_gimbals(gimbal, config, findings)
    _examine_limits(gimbal, config, findings)
    _examine_feedback(gimbal, link, config, findings)
    if planner is None:
        findings.note("mission", "plan", "not examined: a mission is under way")
    else:
        await _examine_plan(gimbal, config, findings, planner)
    return True


def _list_gimbals(gimbal: MavsdkGimbal, config: Config, findings: Findings) -> None:
    """Every gimbal that a manager offers, and every component that tells an attitude, with what was chosen."""
    found = gimbal.found
    assert found is not None
    for one in gimbal.candidates:
        limits = gimbal.limits_of(one.manager, one.device_id)
        chosen = one.gimbal_id == found.gimbal_id
        usable = in_order([one], manager=config.gimbal.manager, device=config.gimbal.device)
        role = "used" if chosen else "not chosen" if usable else "excluded by [gimbal] manager or device"
        text = f"{one.describe()}: {role}; {'limits not told' if limits is None else _range(limits)}"
        findings.note("gimbal", "offered", text)
    try:
        source = gimbal.reports.pin(found.device_id)
    except DeviceError as error:
        findings.missing("gimbal", "source", str(error), needed="the attitude of the gimbal that is pointed")
        return
    others = sorted({*gimbal.reports.heard(), *gimbal.known.strangers} - {source})
    own = "the autopilot's reports" if source == AUTOPILOT else f"reports of component {source}"
    beside = f"; ignored: component {', '.join(map(str, others))}" if others else ""
    findings.ok("gimbal", "source", f"{own}{beside}")


async def _parameters(link: MavsdkLink, autopilot: str) -> str:
    """Current values of the mount's parameters, for example `MNT1_TYPE = 6`."""
    out = []
    for name in _PARAMETERS.get(autopilot, ()):
        value = await link.requests.parameter(name)
        if value is not None:
            out.append(f"{name} = {value:g}")
    return ", ".join(out)


def _examine_limits(gimbal: MavsdkGimbal, config: Config, findings: Findings) -> None:
    own, configured = gimbal.limits, config.gimbal.pitch_deg
    if own is None:
        text = "not reported by the gimbal manager (GIMBAL_MANAGER_INFORMATION, 280)"
        if configured is None:
            findings.warning(
                "gimbal",
                "limits",
                text,
                needed="the gimbal's limits, to reject poses outside them",
                advice=f"[gimbal] pitch_deg and yaw_deg, or {advise('limits', findings.autopilot)}",
            )
        else:
            findings.ok("gimbal", "limits", f"{text}; configured {_range(configured_gimbal(config))}")
        return
    if own.pans or config.gimbal.yaw != "gimbal":
        findings.ok("gimbal", "limits", _range(own))
        return
    findings.missing(
        "gimbal",
        "limits",
        f"{_range(own)}: the gimbal has no pan axis",
        needed="all yaws of a panorama",
        advice='[gimbal] yaw = "vehicle": the vehicle yaws instead',
    )


def _range(limits: GimbalLimits) -> str:
    yaw = f"{limits.yaw_min_deg:.0f} to {limits.yaw_max_deg:.0f}°"
    if limits.yaw_endless:
        yaw = "endless"
    elif not limits.pans:
        yaw = "none (two axes: the vehicle must yaw, see [gimbal] yaw)"
    return f"pitch {limits.pitch_min_deg:.0f} to {limits.pitch_max_deg:.0f}°, yaw {yaw}"


def _examine_feedback(gimbal: MavsdkGimbal, link: MavsdkLink, config: Config, findings: Findings) -> None:
    assert gimbal.found is not None
    kind = "none" if gimbal.known.echo else gimbal.found.feedback
    why = f" ({gimbal.known.echo})" if gimbal.known.echo else ""
    text, advice = f"{kind}: {_KINDS[kind]}{why}", advise("feedback", findings.autopilot)
    if kind in ("earth", "vehicle"):
        findings.ok("gimbal", "feedback", text)
    elif kind == "body":
        findings.warning(
            "gimbal", "feedback", text, needed="measured angles: servos report what is demanded", advice=advice
        )
    elif config.gimbal.feedback == "none":
        findings.warning(
            "gimbal", "feedback", f"{text}; [gimbal] feedback disables pointing verification", advice=advice
        )
    else:
        findings.missing(
            "gimbal", "feedback", text, needed="measured angles", advice=f'{advice}; or [gimbal] feedback = "none"'
        )
    gimbal.feed.ingest()
    sample = gimbal.feed.latest
    problems = attitude_problems(sample, now_s=link.clock.monotonic(), silence_s=config.guards.attitude_silence_s)
    if problems:
        findings.missing(
            "gimbal",
            "attitude",
            "; ".join(problems),
            needed="recent and complete reports",
            advice=advise("gimbal", findings.autopilot),
        )
    else:
        findings.ok("gimbal", "attitude", "recent and complete")


async def _examine_plan(gimbal: MavsdkGimbal, config: Config, findings: Findings, planner: Planner) -> None:
    """Plan the configured panorama and check that the gimbal reaches all poses."""
    try:
        spec = configured_spec(config, configured_profile(config))
        limits = effective_limits(gimbal.limits, configured_gimbal(config))
        spec = replace(spec, constraints=replace(spec.constraints, gimbal=limits))
        plan = await planner(spec)
    except PanoexecError as error:
        advice = f"[mission] elevation_deg, or {advise('limits', findings.autopilot)}"
        findings.missing("mission", "plan", str(error), needed="the configured panorama", advice=advice)
        return
    # yaw limits are relative to the nose, and the heading of the mission is unknown: check the pitch only
    beyond = limit_problems(plan.shots, replace(limits, yaw_endless=True))
    certificate, estimate = plan.certificate, plan.estimate
    duration = "" if estimate is None else f", {estimate.duration_s:.0f} s"
    text = f"{len(plan.shots)} images{duration}"
    if beyond:
        advice = advise("limits", findings.autopilot)
        findings.missing("mission", "plan", f"{text}: {'; '.join(beyond)}", needed="reachable poses", advice=advice)
    elif certificate is None or not certificate.certified:
        findings.warning("mission", "plan", f"{text}, not certified", advice="panoexec plan gives the reasons")
    else:
        findings.ok("mission", "plan", f"{text}, certified, all within the gimbal's limits")


async def check_reports(gimbal: MavsdkGimbal, config: Config, findings: Findings, *, since_s: float) -> None:
    """Examine rate, steps and noise of the reports since a time, and what is known of gimbal and north.

    Args:
        gimbal: found, and reporting at the rates of a mission.
        config: the daemon's configuration.
        findings: results are added to it.
        since_s: on the mission's clock.
    """
    gimbal.feed.ingest()
    quality = measured(gimbal.feed.since(since_s))
    if quality is None:
        return  # too few: the check of the rates says so
    settings = quality.settings(config.pointing)
    if settings and config.gimbal.feedback != "none":
        advice = f"[pointing] {', '.join(settings)}"
        needed = "tolerances and times that these reports can prove"
        findings.warning("gimbal", "reports", quality.text(), needed=needed, advice=advice)
    else:
        findings.ok("gimbal", "reports", quality.text())
    known = gimbal.known
    if known.steady_error is not None:
        why = cannot_hold(known.steady_error, configured_spec(config, configured_profile(config)).constraints.tolerance)
        if why:
            findings.missing("gimbal", "steady error", why, needed="tolerances that it can hold")
    if abs(known.north_off_deg) > config.pointing.tolerance_yaw_deg:
        findings.warning(
            "gimbal",
            "north",
            f"{known.north_off_deg:+.1f}° from that of the autopilot; its reports are corrected by it",
            needed=f"the same north within {config.pointing.tolerance_yaw_deg:g}°",
            advice="calibrate the gimbal's compass",
        )


async def check_control(gimbal: MavsdkGimbal, findings: Findings) -> None:
    """Acquire gimbal control and release it, unless another component has it."""
    holder = gimbal.controlled_by
    if holder not in (None, (0, 0)) and not gimbal.in_control:
        assert holder is not None
        findings.warning(
            "gimbal",
            "control",
            f"system {holder[0]} component {holder[1]} has it; not taken from it",
            needed="primary control for a mission",
            advice=advise("control", findings.autopilot),
        )
        return
    try:
        await gimbal.acquire()
    except DeviceError as error:
        findings.missing(
            "gimbal", "control", str(error), needed="primary control", advice=advise("control", findings.autopilot)
        )
        return
    finally:
        await gimbal.release()
    findings.ok("gimbal", "control", "acquired and released")
