"""Photos that `doctor --photo` takes: what proves them, how late the shutter is, how soon the next can follow."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from panoexec.clock import Clock
from panoexec.devices import Camera, CaptureEvidence, EvidenceLevel
from panoexec.doctor.advice import advise
from panoexec.doctor.findings import Findings
from panoexec.errors import DeviceError, PanoexecError
from panoexec.inputs.camera_profiles import configured_profile
from panoexec.inputs.config import Config
from panoexec.mission.dated_exposure import is_dated
from panoexec.mission.protocols import MayFireLate, PacesPhotos

PHOTOS: Final = 3
_EVIDENCE_S: Final = 10.0
_REFUSALS: Final = 6
_RETRY_S: Final = 0.5
_SLACK_S: Final = 0.1
_DEFAULT_INTERVAL_S: Final = 1.0


@dataclass(kw_only=True)
class _Measured:
    """What the photos showed; times in seconds."""

    proofs: list[CaptureEvidence] = field(default_factory=list)
    took_s: list[float] = field(default_factory=list)
    lags_s: list[float] = field(default_factory=list)
    latest_s: float = 0.0
    refused: int = 0


async def measure_photos(camera: Camera, clock: Clock, config: Config, findings: Findings) -> None:
    """Take a few photos at the configured interval and report evidence, shutter lag and interval."""
    wanted = EvidenceLevel[config.camera.evidence.upper()]
    measured = _Measured()
    next_s = -math.inf
    try:
        while len(measured.proofs) < PHOTOS:
            if isinstance(camera, PacesPhotos):
                next_s = max(next_s, camera.ready_s)
            await clock.sleep(max(0.0, next_s - clock.monotonic()))
            sent_s = clock.monotonic()
            try:
                await _take(camera, measured, max(wanted, EvidenceLevel.CAPTURE_MESSAGE))
            except DeviceError:
                measured.refused += 1
                next_s = clock.monotonic() + _RETRY_S
                if not measured.proofs or measured.refused >= _REFUSALS:
                    raise
            else:
                next_s = sent_s + configured_interval_s(config)
    except DeviceError as error:
        findings.missing("camera", "photo", str(error), advice=advise("camera", findings.autopilot))
        if not measured.proofs:
            return
    _report_proof(measured, wanted, findings)
    _report_lag(measured, config, findings)
    if isinstance(camera, PacesPhotos):
        examine_interval(camera.interval_s, config, findings, refused=measured.refused)


async def _take(camera: Camera, measured: _Measured, level: EvidenceLevel) -> None:
    pending = await camera.trigger()
    if isinstance(pending, MayFireLate):
        await pending.fired()
    proof = await pending.evidence(level, _EVIDENCE_S)
    measured.proofs.append(proof)
    measured.took_s.append(proof.received_s - pending.commanded_s)
    if is_dated(proof) and proof.level >= EvidenceLevel.FEEDBACK_PIN:
        lag_s = max(0.0, proof.exposed_s - pending.commanded_s)
        measured.lags_s.append(lag_s)
        measured.latest_s = max(measured.latest_s, lag_s + proof.exposed_error_s)


def _report_proof(measured: _Measured, wanted: EvidenceLevel, findings: Findings) -> None:
    weakest = min(measured.proofs, key=lambda proof: proof.level)
    problem = next((proof.contradiction for proof in measured.proofs if proof.contradiction), "")
    where = f", {weakest.file_url}" if weakest.file_url else ""
    count, took_ms = len(measured.proofs), 1000 * max(measured.took_s)
    text = f"{count} taken, {weakest.level.name.lower()} after {took_ms:.0f} ms{where}"
    findings.judge(
        "camera",
        "photo",
        weakest.level >= wanted and not problem,
        f"{text}; {problem}" if problem else text,
        needed=wanted.name.lower(),
        advice=advise("evidence", findings.autopilot),
    )


def _report_lag(measured: _Measured, config: Config, findings: Findings) -> None:
    """Compare when the shutter opened with the configured bound."""
    bound_s = config.camera.latency_s
    if not measured.lags_s:
        findings.note(
            "camera",
            "shutter lag",
            f"not measured: the camera does not date its photos; [camera] latency_s = {bound_s:g} is assumed",
        )
        return
    least_s, most_s = min(measured.lags_s), max(measured.lags_s)
    span = f"{most_s:.2f} s" if most_s - least_s < 0.05 else f"{least_s:.2f} to {most_s:.2f} s"
    count = len(measured.lags_s)
    text = f"the shutter opens {span} after the trigger ({count} photos); [camera] latency_s = {bound_s:g}"
    if most_s <= bound_s + _SLACK_S:
        findings.ok("camera", "shutter lag", text)
        return
    advised_s = math.ceil(10 * measured.latest_s - 1e-6) / 10
    findings.warning(
        "camera",
        "shutter lag",
        text,
        needed="a bound of the shutter's lag: without it the first photos are taken again",
        advice=f"set [camera] latency_s = {advised_s:g}",
    )


def configured_interval_s(config: Config) -> float:
    """The least time between two photos by configuration or profile."""
    if config.camera.interval_s is not None:
        return config.camera.interval_s
    try:
        return configured_profile(config).min_interval_s
    except PanoexecError:  # reported with the profile
        return _DEFAULT_INTERVAL_S


def examine_interval(known_s: float, config: Config, findings: Findings, *, refused: int = 0) -> None:
    """Compare what is known of the camera's least interval with the configured one.

    Args:
        known_s: told by a parameter or learned; 0 if nothing is known.
        config: the daemon's.
        findings: the result is added to it.
        refused: how many triggers were refused.
    """
    configured_s = configured_interval_s(config)
    if known_s <= configured_s + _SLACK_S:
        if refused:
            text = f"{refused} triggers were refused, {configured_s:g} s between two photos are configured"
            findings.warning("camera", "interval", text, advice="raise [camera] interval_s")
        elif known_s:
            findings.ok("camera", "interval", f"{configured_s:g} s configured, the camera needs {known_s:.1f} s")
        return
    text = f"the camera needs {known_s:.1f} s between two photos, {configured_s:g} s are configured"
    findings.warning(
        "camera",
        "interval",
        f"{text}; {refused} triggers were refused" if refused else text,
        needed="an interval that the camera keeps: each photo that is asked for sooner costs time",
        advice=f"set [camera] interval_s = {math.ceil(10 * known_s - 1e-6) / 10:g}",
    )
