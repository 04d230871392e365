"""The gimbal: found, its limits, what its reports are worth, whether it lets itself be controlled."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Final

from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.doctor.advice import advise
from panoexec.doctor.findings import Findings
from panoexec.errors import DeviceError, PanoexecError
from panoexec.inputs.camera_profiles import configured_profile
from panoexec.inputs.config import Config
from panoexec.inputs.plan_options import configured_gimbal, configured_spec
from panoexec.mission.preflight import attitude_problems, effective_limits, limit_problems
from panoexec.planning.model import GimbalLimits

_PARAMETERS: Final = {"ardupilot": ("MNT1_TYPE",), "px4": ("MNT_MODE_IN", "MNT_MODE_OUT")}
_KINDS: Final = {
    "earth": "measured, relative to the earth",
    "vehicle": "measured, relative to the vehicle's heading",
    "body": "the servo angles that were demanded",
    "none": "an echo of what was commanded",
}


async def check_gimbal(
    gimbal: MavsdkGimbal, link: MavsdkLink, config: Config, findings: Findings, *, patience_s: float
) -> bool:
    """Look for it, and at what it says of itself; whether it is there."""
    try:
        found = await gimbal.discover(patience_s)
    except DeviceError as error:
        set_now = await _parameters(link, findings.autopilot)
        told = f"{error}{f' (now {set_now})' if set_now else ''}"
        findings.missing(
            "gimbal", "found", told, needed="a MAVLink gimbal manager", advice=advise("gimbal", findings.autopilot)
        )
        return False
    name = f"{found.vendor} {found.model}".strip() or "without a name"
    set_now = await _parameters(link, findings.autopilot)
    findings.ok(
        "gimbal",
        "found",
        f"{name}, manager {found.manager_component}, device {found.device_id}{f', {set_now}' if set_now else ''}",
    )
    _examine_limits(gimbal, config, findings)
    _examine_feedback(gimbal, link, config, findings)
    await _examine_plan(gimbal, config, findings)
    return True


async def _parameters(link: MavsdkLink, autopilot: str) -> str:
    """The mount's parameters as they are set: `MNT1_TYPE = 6`."""
    out = []
    for name in _PARAMETERS.get(autopilot, ()):
        value = await link.requests.parameter(name)
        if value is not None:
            out.append(f"{name} = {value:g}")
    return ", ".join(out)


def _examine_limits(gimbal: MavsdkGimbal, config: Config, findings: Findings) -> None:
    own, configured = gimbal.limits, config.gimbal.pitch_deg
    if own is None:
        text = "not stated by its manager (280)"
        if configured is None:
            findings.warning(
                "gimbal",
                "limits",
                text,
                needed="to refuse what it cannot reach",
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
        f"{_range(own)}: it does not pan",
        needed="all yaws of a panorama",
        advice='[gimbal] yaw = "vehicle": the vehicle turns in its place',
    )


def _range(limits: GimbalLimits) -> str:
    yaw = f"{limits.yaw_min_deg:.0f} to {limits.yaw_max_deg:.0f}°"
    if limits.yaw_endless:
        yaw = "endless"
    elif not limits.pans:
        yaw = "none (two axes: the vehicle must pan, [gimbal] yaw)"
    return f"pitch {limits.pitch_min_deg:.0f} to {limits.pitch_max_deg:.0f}°, yaw {yaw}"


def _examine_feedback(gimbal: MavsdkGimbal, link: MavsdkLink, config: Config, findings: Findings) -> None:
    assert gimbal.found is not None
    kind = gimbal.found.feedback
    text, advice = f"{kind}: {_KINDS[kind]}", advise("feedback", findings.autopilot)
    if kind in ("earth", "vehicle"):
        findings.ok("gimbal", "feedback", text)
    elif kind == "body":
        findings.warning(
            "gimbal", "feedback", text, needed="measured angles: nothing tells how far off the camera is", advice=advice
        )
    elif config.gimbal.feedback == "none":
        findings.warning(
            "gimbal", "feedback", f"{text}; [gimbal] feedback says that nothing is verified", advice=advice
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
            needed="fresh and whole",
            advice=advise("gimbal", findings.autopilot),
        )
    else:
        findings.ok("gimbal", "attitude", "fresh and whole")


async def _examine_plan(gimbal: MavsdkGimbal, config: Config, findings: Findings) -> None:
    """Plan the configured panorama, and see whether this gimbal reaches all of it."""
    try:
        spec = configured_spec(config, configured_profile(config))
        limits = effective_limits(gimbal.limits, configured_gimbal(config))
        spec = replace(spec, constraints=replace(spec.constraints, gimbal=limits))
        plan = await asyncio.to_thread(spec.plan)
    except PanoexecError as error:
        advice = f"[mission] elevation_deg, or {advise('limits', findings.autopilot)}"
        findings.missing("mission", "plan", str(error), needed="the configured panorama", advice=advice)
        return
    # limits of yaw are relative to the nose: what is in reach depends on where it will look
    beyond = limit_problems(plan.shots, replace(limits, yaw_endless=True))
    certificate, estimate = plan.certificate, plan.estimate
    duration = "" if estimate is None else f", {estimate.duration_s:.0f} s"
    text = f"{len(plan.shots)} images{duration}"
    if beyond:
        advice = advise("limits", findings.autopilot)
        findings.missing("mission", "plan", f"{text}: {'; '.join(beyond)}", needed="poses in reach", advice=advice)
    elif certificate is None or not certificate.certified:
        findings.warning("mission", "plan", f"{text}, not certified", advice="panoexec plan tells why")
    else:
        findings.ok("mission", "plan", f"{text}, certified, all within the gimbal's limits")


async def check_control(gimbal: MavsdkGimbal, findings: Findings) -> None:
    """Take control and give it back, unless somebody has it."""
    holder = gimbal.controlled_by
    if holder not in (None, (0, 0)) and not gimbal.in_control:
        assert holder is not None
        findings.warning(
            "gimbal",
            "control",
            f"system {holder[0]} component {holder[1]} has it; it was left there",
            needed="primary control, which a mission takes",
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
    findings.ok("gimbal", "control", "taken and given back")
