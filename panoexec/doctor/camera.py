"""Checks of the camera: discovery, profile, storage, and the evidence available for its photos."""

from __future__ import annotations

import contextlib
import math
from typing import Final

from panoexec.adapters.camera.camera_kind import CameraFound, OpenCamera
from panoexec.adapters.camera.open_camera import KINDS, open_camera
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.devices import Camera, EvidenceLevel
from panoexec.doctor.advice import advise
from panoexec.doctor.findings import Findings
from panoexec.errors import DeviceError, PanoexecError
from panoexec.inputs.camera_profiles import configured_profile
from panoexec.inputs.config import Config

_ENOUGH_PHOTOS: Final = 100
_EVIDENCE_S: Final = 10.0


async def check_camera(
    link: MavsdkLink,
    config: Config,
    findings: Findings,
    *,
    patience_s: float,
    photo: bool,
    camera: OpenCamera | None = None,
) -> None:
    """Look for the camera that the configuration names; with `photo` take one to see what proves it.

    Args:
        link: to the autopilot.
        config: the daemon's configuration.
        findings: results are added to it.
        patience_s: timeout for the camera, seconds of real time.
        photo: take one photo.
        camera: the open camera, which stays open; None: open the configured one.
    """
    opened = open_camera(config.camera, link) if camera is None else contextlib.nullcontext(camera)
    try:
        async with opened as one:
            found = await one.discover(patience_s)
            findings.ok("camera", "found", found.label)
            if found.is_two_way:
                _examine_size(found, config, findings)
                _examine_room(one.storage_free_images, findings)
            _examine_evidence(await one.best_evidence(), config, findings, may_tell_files=found.may_tell_files)
            if photo:
                await _take_photo(one, config, findings)
    except DeviceError as error:
        kind = KINDS[config.camera.trigger]
        parameters = [advise("camera", findings.autopilot)] if kind.set_by_autopilot else []
        advice = "; ".join([*parameters, kind.settings])
        findings.missing("camera", "found", str(error), needed=kind.needed, advice=advice)


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


def _examine_evidence(best: EvidenceLevel, config: Config, findings: Findings, *, may_tell_files: bool) -> None:
    """What can prove a photo, and whether that is as much as the configuration asks for."""
    wanted = EvidenceLevel[config.camera.evidence.upper()]
    known = [level.name.lower() for level in EvidenceLevel if level <= best]
    needed = f"{wanted.name.lower()} ([camera] evidence)"
    advice = f"{advise('evidence', findings.autopilot)}; or a lower [camera] evidence"
    text = f"up to {known[-1]}"
    if wanted is EvidenceLevel.FILE_SEEN and may_tell_files:
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
