"""From configuration and request to what is planned, and to the settings that it is flown with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from panoexec.adapters.link.connection_url import parse_connection
from panoexec.daemon.presets import preset_problems
from panoexec.devices import EvidenceLevel
from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.camera_profiles import CameraProfile, configured_profile, load_profile, profile_from_mapping
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import plan_from_data
from panoexec.inputs.plan_options import UNKNOWN_TURNS, configured_spec
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.mission.configured_guards import guard_settings
from panoexec.mission.settings import MissionSettings
from panoexec.mission.tour_stop import TourStop
from panoexec.mqtt.credentials import credential_problems
from panoexec.mqtt.requests import PlanRequest, RefusedRequestError
from panoexec.planning.model import GimbalLimits, TurnLimits


def chosen_profile(config: Config, camera: str | Mapping[str, Any] | None) -> CameraProfile:
    """The camera that a request names, else the configured one.

    Raises:
        RefusedRequestError: there is no such profile, or the table is wrong; names the field.
    """
    try:
        if camera is None:
            return configured_profile(config)
        orientation = config.camera.orientation
        if isinstance(camera, str):
            named = load_profile(camera, orientation=orientation)
        else:
            named = profile_from_mapping(camera, source="camera")
        return replace(named, camera=named.camera.with_lens(config.camera.lens or "calibrated"))
    except InputFileError as error:
        first = error.problems[0].partition(" ")[0].rstrip(":")
        raise RefusedRequestError("invalid", str(error), field=f"camera.{first}") from error
    except UsageError as error:
        raise RefusedRequestError("invalid", str(error), field="camera") from error


def spec_of(
    config: Config,
    request: PlanRequest,
    *,
    camera: str | Mapping[str, Any] | None = None,
    limits: TurnLimits = UNKNOWN_TURNS,
) -> PlanSpec:
    """What a request asks for; what it leaves out comes from its plan, then from the configuration.

    Args:
        config: of the daemon.
        request: `plan` or `start`.
        camera: set by an earlier request, instead of the configured one.
        limits: of the vehicle's turns, if known.

    Raises:
        RefusedRequestError: naming the field.
    """
    file = None
    if request.plan is not None:
        try:
            file = plan_from_data(request.plan, source="plan")
        except InputFileError as error:
            first = error.problems[0].partition(" ")[0].rstrip(":")
            raise RefusedRequestError("invalid", str(error), field=f"plan.{first}") from error
    profile = chosen_profile(config, request.camera if request.camera is not None else camera)
    options = request.options()
    if request.camera is not None:
        options = replace(options, camera=profile.camera)
    try:
        return options.over(configured_spec(config, profile, limits), file)
    except UsageError as error:
        raise RefusedRequestError("invalid", str(error), field="lens") from error


def settings_of(config: Config, spec: PlanSpec) -> MissionSettings:
    """How to fly it.

    Raises:
        UsageError: no mission could be flown so.
    """
    pointing, camera = config.pointing, config.camera
    return MissionSettings(
        tolerance=spec.constraints.tolerance,
        settle_s=pointing.settle_s,
        max_rate_deg_s=pointing.max_rate_deg_s,
        max_gap_s=pointing.max_gap_s,
        patience_s=pointing.settle_timeout_s,
        attempts=pointing.attempts,
        exposure_s=spec.timing.exposure_s,
        latency_s=camera.latency_s,
        interval_s=spec.timing.interval_s,
        brackets=camera.bracket,
        min_evidence=EvidenceLevel[camera.evidence.upper()],
        accept=pointing.accept,
        feedback="none" if config.gimbal.feedback == "none" else "auto",
        gimbal=spec.constraints.gimbal or GimbalLimits(),
        guards=guard_settings(config.guards, config.gimbal),
        pictures=config.pictures.check,
    )


def at_stop(settings: MissionSettings, stop: TourStop) -> MissionSettings:
    """The settings for a panorama at a waypoint of the autopilot's mission: in any other mode the pilot has taken over.

    The vehicle must be in the air and know its position, whatever the configuration says.
    """
    guards = replace(settings.guards, allowed_modes=stop.modes, position_hold=True)
    return replace(settings, guards=guards)


def configuration_problems(config: Config) -> list[str]:
    """What a checked configuration can still have wrong: files it names, and what this version cannot do."""
    problems = credential_problems(config.mqtt) + preset_problems(config)
    try:
        settings_of(config, configured_spec(config, configured_profile(config)))
    except UsageError as error:
        problems.append(f"camera.profile or pointing: {error}")
    vehicle = config.vehicle
    if vehicle.connection is None and vehicle.serial is None:
        problems.append('vehicle.connection is missing: give a URL such as "udpin://0.0.0.0:14540", or serial = "auto"')
    if vehicle.connection is not None:
        try:
            parse_connection(vehicle.connection)
        except UsageError as error:
            problems.append(f"vehicle.{error}")
    return problems
