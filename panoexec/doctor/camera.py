"""Checks of the camera: discovery, profile, storage, and the evidence available for its photos."""

from __future__ import annotations

import contextlib
import math
from collections.abc import AsyncIterator
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
from panoexec.inputs.vehicle_sections import LockSection
from panoexec.mission.protocols import PacesPhotos, PreparesForPhotos

_ENOUGH_PHOTOS: Final = 100


async def check_camera(
    link: MavsdkLink,
    config: Config,
    findings: Findings,
    *,
    patience_s: float,
    photo: bool,
    camera: OpenCamera | None = None,
    in_use: bool = False,
) -> None:
    """Look for the camera that the configuration names, as the daemon does; with `photo` take some to measure it.

    Args:
        link: to the autopilot.
        config: the daemon's configuration.
        findings: results are added to it.
        patience_s: timeout for the camera, seconds of real time.
        photo: take photos.
        camera: the open camera, which stays open; None: open the configured one.
        in_use: a mission uses the camera: its mode is left alone.
    """
    opened = open_camera(config.camera, link) if camera is None else contextlib.nullcontext(camera)
    try:
        async with opened as one:
            try:
                found = await one.discover(patience_s)
            finally:
                _list_others(one, findings)
            findings.ok("camera", "found", f"{found.label} ({found.why})" if found.why else found.label)
            if found.is_two_way:
                _examine_size(found, config, findings)
                _examine_room(one.storage_free_images, findings)
            async with contextlib.nullcontext(True) if in_use else _photo_mode(one, findings) as is_ready:
                _examine_evidence(await one.best_evidence(), config, findings, may_tell_files=found.may_tell_files)
                if photo and is_ready:
                    await measure_photos(one, link.clock, config, findings)
                elif isinstance(one, PacesPhotos):
                    examine_interval(one.interval_s, config, findings)
            if not in_use:
                await _examine_lock(one, config, findings)
    except DeviceError as error:
        kind = KINDS[config.camera.trigger]
        parameters = [advise("camera", findings.autopilot)] if kind.set_by_autopilot else []
        advice = error.advice or "; ".join([*parameters, kind.settings])
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


@contextlib.asynccontextmanager
async def _photo_mode(camera: OpenCamera, findings: Findings) -> AsyncIterator[bool]:
    """Try photo mode where the camera is in another, for the block; whether photos can be taken."""
    mode = camera.mode if isinstance(camera, MavsdkCamera) else None
    if mode is None or mode.mode is None:
        yield True
        return
    before = mode.text
    if mode.takes_photos:
        findings.ok("camera", "mode", before)
        yield True
        return
    assert isinstance(camera, MavsdkCamera)
    problem = await camera.prepare()
    if problem:
        findings.missing("camera", "mode", problem, needed="photo mode", advice="set the camera itself to photos")
    else:
        text = f"{before}; photo mode works, and is set for each mission and restored after it"
        findings.note("camera", "mode", text)
    try:
        yield not problem
    finally:
        await camera.restore()


async def _examine_lock(camera: OpenCamera, config: Config, findings: Findings) -> None:
    """Make the settings of `[camera.lock]`, and put them back."""
    if config.camera.lock == LockSection() or not isinstance(camera, PreparesForPhotos):
        return
    try:
        problem = await camera.prepare()
    except DeviceError as error:
        problem = str(error)
    finally:
        await camera.restore()
    if problem:
        findings.missing("camera", "lock", problem, needed="the settings of [camera.lock]", advice="[camera.lock]")
    else:
        findings.ok("camera", "lock", "the settings of [camera.lock] can be made, and were put back")


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
