"""Checks of the camera: discovery, profile, storage, and the evidence available for its photos."""

from __future__ import annotations

import math
from typing import Final

from panoexec.adapters.camera.camera_kind import CameraFound, OpenCamera
from panoexec.adapters.camera.mavsdk_camera import MavsdkCamera
from panoexec.adapters.camera.open_camera import KINDS, open_camera
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.devices import EvidenceLevel
from panoexec.doctor.advice import advise
from panoexec.doctor.camera_photos import examine_interval, measure_photos
from panoexec.doctor.findings import Findings
from panoexec.errors import DeviceError, PanoexecError
from panoexec.inputs.camera_profiles import configured_profile
from panoexec.inputs.config import Config
from panoexec.mission.protocols import PacesPhotos, PreparesForPhotos

_ENOUGH_PHOTOS: Final = 100


async def check_camera(link: MavsdkLink, config: Config, findings: Findings, *, patience_s: float, photo: bool) -> None:
    """Look for the camera that the configuration names, as the daemon does; with `photo` take some to measure it."""
    try:
        async with open_camera(config.camera, link) as camera:
            try:
                found = await camera.discover(patience_s)
            except DeviceError:
                _list_others(camera, findings)
                raise
            findings.ok("camera", "found", f"{found.label} ({found.why})" if found.why else found.label)
            _list_others(camera, findings)
            if found.is_two_way:
                _examine_size(found, config, findings)
                _examine_room(camera.storage_free_images, findings)
            is_ready = await _examine_mode(camera, findings)
            try:
                _examine_evidence(await camera.best_evidence(), config, findings, may_tell_files=found.may_tell_files)
                if photo and is_ready:
                    await measure_photos(camera, link.clock, config, findings)
                elif isinstance(camera, PacesPhotos):
                    examine_interval(camera.interval_s, config, findings)
            finally:
                if isinstance(camera, PreparesForPhotos):
                    await camera.restore()
    except DeviceError as error:
        kind = KINDS[config.camera.trigger]
        if "component = 1" in str(error):  # PX4's own trigger: its parameters may have been set already
            advice = "set [camera] component = 1 if TRIG_MODE is 1, or connect a MAVLink camera"
        elif "set TRIG_MODE" in str(error):
            advice = "TRIG_MODE = 1"
        else:
            parameters = [advise("camera", findings.autopilot)] if kind.set_by_autopilot else []
            advice = "; ".join([*parameters, kind.settings])
        findings.missing("camera", "found", str(error), needed=kind.needed, advice=advice)


def _list_others(camera: OpenCamera, findings: Findings) -> None:
    """Every other camera, with what it can do."""
    if not isinstance(camera, MavsdkCamera):
        return
    used = None if camera.found is None else camera.found.component
    for one in camera.candidates:
        if one.component == used:
            continue
        advice = f"[camera] component = {one.component} to use it" if one.takes_photos else ""
        findings.note("camera", f"component {one.component}", f"{one.summary}; not used", advice=advice)


async def _examine_mode(camera: OpenCamera, findings: Findings) -> bool:
    """Try photo mode where the camera is in another; whether photos can be taken."""
    if not isinstance(camera, MavsdkCamera) or camera.mode is None or camera.mode.mode is None:
        return True
    before = camera.mode.text
    if camera.mode.takes_photos:
        findings.ok("camera", "mode", before)
        return True
    problem = await camera.prepare()
    if problem:
        findings.missing("camera", "mode", problem, needed="photo mode", advice="set the camera itself to photos")
        return False
    findings.note("camera", "mode", f"{before}; photo mode works, and is set for each mission and restored after it")
    return True


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
