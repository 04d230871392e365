"""Checks of the camera: discovery, profile, storage, and the evidence available for its photos."""

from __future__ import annotations

import math
from typing import Final

from panoexec.adapters.camera.mavsdk_camera import CameraFound, MavsdkCamera
from panoexec.adapters.camera.serial_shutter import SerialShutter
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.daemon.mission_request import configured_profile
from panoexec.devices import Camera, EvidenceLevel
from panoexec.doctor.advice import advise
from panoexec.doctor.findings import Findings
from panoexec.errors import DeviceError, PanoexecError
from panoexec.inputs.config import Config

_ENOUGH_PHOTOS: Final = 100
_EVIDENCE_S: Final = 10.0
_FEEDBACK_PIN: Final = "CAM1_FEEDBAK_PIN"


async def check_camera(link: MavsdkLink, config: Config, findings: Findings, *, patience_s: float, photo: bool) -> None:
    """Check the camera that the configuration names; with `photo`, take a photo to measure its evidence level."""
    if config.camera.trigger == "serial":
        await _examine_shutter(link, config, findings, photo=photo)
        return
    async with MavsdkCamera(link, component=config.camera.component) as camera:
        try:
            found = await camera.discover(patience_s)
        except DeviceError as error:
            findings.missing(
                "camera",
                "found",
                str(error),
                needed="a camera that responds",
                advice=f"{advise('camera', findings.autopilot)}; [camera] component",
            )
            return
        name = f"{found.vendor} {found.model}".strip() or (
            "a shutter of the autopilot" if found.by_autopilot else "unnamed"
        )
        findings.ok("camera", "found", f"{name}, component {found.component}")
        _examine_size(found, config, findings)
        _examine_room(camera.storage_free_images, findings)
        best = EvidenceLevel.CAPTURE_MESSAGE
        if found.by_autopilot:
            best = EvidenceLevel.FEEDBACK_PIN if found.feedback_pin else EvidenceLevel.COUNTED
        _examine_evidence(best, config, findings, may_hand_over=not found.by_autopilot)
        if photo:
            await _take_photo(camera, config, findings)


async def _examine_shutter(link: MavsdkLink, config: Config, findings: Findings, *, photo: bool) -> None:
    section = config.camera
    assert section.serial_port is not None
    payload = (section.serial_bytes or "").encode()
    shutter = SerialShutter(
        section.serial_port,
        clock=link.clock,
        line=section.serial_line,
        payload=payload,
        pulse_s=section.pulse_s,
        feedback=link,
    )
    try:
        async with shutter:
            findings.ok("camera", "found", f"a cable release on {section.serial_port} ({section.serial_line})")
            wired = findings.autopilot == "ardupilot" and (await link.requests.parameter(_FEEDBACK_PIN) or -1) > 0
            _examine_evidence(
                EvidenceLevel.FEEDBACK_PIN if wired else EvidenceLevel.COMMANDED, config, findings, may_hand_over=False
            )
            if photo:
                await _take_photo(shutter, config, findings)
    except DeviceError as error:
        findings.missing(
            "camera", "found", str(error), advice="[camera] serial_port; systemd/serial.conf for the service"
        )


def _examine_size(found: CameraFound, config: Config, findings: Findings) -> None:
    """Check that the camera's image size is the one of the profile."""
    try:
        profile = configured_profile(config)
    except PanoexecError as error:
        findings.missing("camera", "profile", str(error), advice="[camera] profile")
        return
    camera = profile.camera
    size = {camera.image_width_px, camera.image_height_px}
    text = f"{camera.name}: {camera.hfov_deg:.1f}° × {camera.vfov_deg:.1f}°"
    text += f", {camera.image_width_px} × {camera.image_height_px} px"
    if not found.image_width_px:
        findings.note("camera", "profile", f"{text}; the camera does not report its image size")
    elif size != {found.image_width_px, found.image_height_px}:
        findings.warning(
            "camera",
            "profile",
            f"{text}, but the camera reports {found.image_width_px} × {found.image_height_px} px",
            needed="the profile of this camera: a wrong field of view leaves gaps",
            advice="set [camera] profile (see panoexec cameras), or the camera's image size",
        )
    else:
        findings.ok("camera", "profile", text)


def _examine_room(photos: float, findings: Findings) -> None:
    if math.isinf(photos):
        findings.note("camera", "storage", "the camera does not report its free storage")
    elif photos < 1:
        findings.missing(
            "camera", "storage", "no space for a photo", needed="free storage", advice="replace or clear the card"
        )
    elif photos < _ENOUGH_PHOTOS:
        findings.warning("camera", "storage", f"space for {photos:.0f} photos", advice="replace or clear the card")
    else:
        findings.ok("camera", "storage", f"space for {photos:.0f} photos")


def _examine_evidence(best: EvidenceLevel, config: Config, findings: Findings, *, may_hand_over: bool) -> None:
    """Compare the highest evidence level that the camera supports with the configured one."""
    wanted = EvidenceLevel[config.camera.evidence.upper()]
    known = [level.name.lower() for level in EvidenceLevel if level <= best]
    needed = f"{wanted.name.lower()} ([camera] evidence)"
    advice = f"{advise('evidence', findings.autopilot)}; or a lower [camera] evidence"
    text = f"up to {known[-1]}"
    if wanted is EvidenceLevel.FILE_SEEN and may_hand_over:
        findings.warning(
            "camera",
            "evidence",
            f"{text}; file_seen only if the camera reports a file URL that this computer can read",
            needed=needed,
            advice="test it with panoexec doctor --photo",
        )
    else:
        findings.judge("camera", "evidence", wanted <= best, text, needed=needed, advice=advice)


async def _take_photo(camera: Camera, config: Config, findings: Findings) -> None:
    """Take a photo and report its evidence level."""
    wanted = EvidenceLevel[config.camera.evidence.upper()]
    try:
        pending = await camera.trigger()
        proof = await pending.evidence(max(wanted, EvidenceLevel.CAPTURE_MESSAGE), _EVIDENCE_S)
    except DeviceError as error:
        findings.missing("camera", "photo", str(error), advice=advise("camera", findings.autopilot))
        return
    took_ms = 1000 * (proof.received_s - pending.commanded_s)
    where = f", {proof.file_url}" if proof.file_url else ""
    findings.judge(
        "camera",
        "photo",
        proof.level >= wanted,
        f"taken, {proof.level.name.lower()} after {took_ms:.0f} ms{where}",
        needed=wanted.name.lower(),
        advice=advise("evidence", findings.autopilot),
    )
