"""From configuration and request to a plan and to the settings that it is flown with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from panoexec.adapters.link.connection_url import parse_connection
from panoexec.devices import EvidenceLevel
from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.camera_profiles import CameraProfile, load_profile, profile_from_mapping
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import PlanFile, plan_from_data
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.mqtt.credentials import credential_problems
from panoexec.mqtt.requests import PlanRequest, RefusedRequestError
from panoexec.planning.job import Job
from panoexec.planning.model import Band, Constraints, GimbalLimits, Plan, Timing, Tolerance, Turning
from panoexec.planning.order.shot_order import Order


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """A panorama as asked for, with nothing left open.

    Attributes:
        profile: the camera.
        constraints: to satisfy.
        method, order: how to plan.
        timing: what a shot costs.
        reference: what yaw 0 means.
        file: a given plan instead of one to be computed.
    """

    profile: CameraProfile
    constraints: Constraints
    method: str
    order: Order
    timing: Timing
    reference: Literal["north", "heading"]
    file: PlanFile | None = None

    def job(self) -> Job:
        """What is to be planned.

        Raises:
            InputFileError: the given plan lacks something.
        """
        camera, constraints = self.profile.camera, self.constraints
        given = None if self.file is None else self.file.plan(camera=camera, constraints=constraints)
        return Job(
            camera=camera,
            constraints=constraints,
            method=self.method,
            order=self.order,
            timing=self.timing,
            plan=given,
        )

    def plan(self) -> Plan:
        """Compute, here and now.

        Raises:
            PlanningError: no plan can satisfy the constraints.
        """
        return self.job().done()


def configured_profile(config: Config) -> CameraProfile:
    """The camera that the configuration names.

    Raises:
        UsageError: there is no such profile, or it does not fit.
    """
    section = config.camera
    return load_profile(section.profile, orientation=section.orientation, focal_length_mm=section.focal_length_mm)


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
            return load_profile(camera, orientation=orientation)
        return profile_from_mapping(camera, source="camera")
    except InputFileError as error:
        first = error.problems[0].partition(" ")[0].rstrip(":")
        raise RefusedRequestError("invalid", str(error), field=f"camera.{first}") from error
    except UsageError as error:
        raise RefusedRequestError("invalid", str(error), field="camera") from error


def wish_of(config: Config, request: PlanRequest, *, camera: str | Mapping[str, Any] | None = None) -> Wish:
    """What a request asks for; what it leaves out comes from its plan, then from the configuration.

    Args:
        config: of the daemon.
        request: `plan` or `start`.
        camera: set by an earlier request, instead of the configured one.

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
    if request.camera is None and file is not None and file.camera is not None:
        profile = replace(profile, camera=file.camera)
    return Wish(
        profile=profile,
        constraints=_constraints(config, request, file.constraints if file else None),
        method=request.method or config.mission.method,
        order=request.order or config.mission.order,
        timing=timing_of(config, profile),
        reference=request.reference or config.mission.reference,
        file=file,
    )


def _constraints(config: Config, request: PlanRequest, base: Constraints | None) -> Constraints:
    section, pointing = config.mission, config.pointing
    band = (
        base.band
        if base
        else Band(
            elevation_min_deg=section.elevation_deg[0],
            elevation_max_deg=section.elevation_deg[1],
            azimuth_min_deg=section.azimuth_deg[0],
            azimuth_max_deg=section.azimuth_deg[1],
        )
    )
    if request.elevation_deg is not None:
        low, high = request.elevation_deg
        band = replace(band, elevation_min_deg=low, elevation_max_deg=high)
    if request.azimuth_deg is not None:
        low, high = request.azimuth_deg
        band = replace(band, azimuth_min_deg=low, azimuth_max_deg=high)
    tolerance = (
        base.tolerance
        if base
        else Tolerance(
            pitch_deg=pointing.tolerance_pitch_deg,
            roll_deg=pointing.tolerance_roll_deg,
            yaw_deg=pointing.tolerance_yaw_deg,
        )
    )
    if request.tolerance_deg is not None:
        asked = {f"{axis}_deg": value for axis, value in request.tolerance_deg if value is not None}
        tolerance = replace(tolerance, **asked)
    overlap_h, overlap_v = (base.overlap_h, base.overlap_v) if base else (section.overlap_h, section.overlap_v)
    return Constraints(
        overlap_h=_first(request.overlap_h, request.overlap, overlap_h),
        overlap_v=_first(request.overlap_v, request.overlap, overlap_v),
        band=band,
        tolerance=tolerance,
        guarantee=request.guarantee or (base.guarantee if base else section.guarantee),
        masks=base.masks if base else (),
        gimbal=gimbal_limits(config),
    )


def _first(*values: float | None) -> float:
    return next(value for value in values if value is not None)


def gimbal_limits(config: Config) -> GimbalLimits:
    """Where the gimbal can point and how fast, as configured, and whether the vehicle pans in its place."""
    section, default = config.gimbal, GimbalLimits()
    pitch = section.pitch_deg or (default.pitch_min_deg, default.pitch_max_deg)
    yaw = section.yaw_deg or (default.yaw_min_deg, default.yaw_max_deg)
    endless = section.yaw_endless if section.yaw_endless is not None else section.yaw_deg is None
    turning = None
    if section.yaw != "gimbal":
        vehicle = config.vehicle
        turning = Turning(rate_deg_s=vehicle.yaw_rate_deg_s, acceleration_deg_s2=vehicle.yaw_acceleration_deg_s2)
    if section.yaw == "vehicle":
        yaw, endless = (0.0, 0.0), False
    return GimbalLimits(
        pitch_min_deg=pitch[0],
        pitch_max_deg=pitch[1],
        yaw_min_deg=yaw[0],
        yaw_max_deg=yaw[1],
        pitch_rate_deg_s=section.pitch_rate_deg_s,
        yaw_rate_deg_s=section.yaw_rate_deg_s,
        pitch_acceleration_deg_s2=section.pitch_acceleration_deg_s2,
        yaw_acceleration_deg_s2=section.yaw_acceleration_deg_s2,
        yaw_endless=endless,
        turning=turning,
    )


def timing_of(config: Config, profile: CameraProfile) -> Timing:
    """What a shot costs besides the slew."""
    camera = config.camera
    return Timing(
        settle_s=config.pointing.settle_s,
        exposure_s=profile.max_exposure_s if camera.exposure_s is None else camera.exposure_s,
        trigger_latency_s=camera.latency_s,
        interval_s=profile.min_interval_s if camera.interval_s is None else camera.interval_s,
    )


def settings_of(config: Config, wish: Wish) -> MissionSettings:
    """How to fly it.

    Raises:
        UsageError: no mission could be flown so.
    """
    pointing, camera, guards = config.pointing, config.camera, config.guards
    return MissionSettings(
        tolerance=wish.constraints.tolerance,
        settle_s=pointing.settle_s,
        max_rate_deg_s=pointing.max_rate_deg_s,
        patience_s=pointing.settle_timeout_s,
        attempts=pointing.attempts,
        exposure_s=wish.timing.exposure_s,
        latency_s=camera.latency_s,
        interval_s=wish.timing.interval_s,
        brackets=camera.bracket,
        min_evidence=EvidenceLevel[camera.evidence.upper()],
        accept=pointing.accept,
        feedback="none" if config.gimbal.feedback == "none" else "auto",
        gimbal=wish.constraints.gimbal or GimbalLimits(),
        guards=GuardSettings(
            battery_floor_frac=guards.battery_floor_frac,
            hover_s=60 * guards.hover_min,
            position_drift_m=guards.position_drift_m,
            allowed_modes=guards.allowed_modes,
            attitude_silence_s=guards.attitude_silence_s,
            position_hold=guards.require_in_air,
            reclaim="ask" if config.gimbal.when_taken == "reclaim" else "never",
        ),
    )


def configuration_problems(config: Config) -> list[str]:
    """What a checked configuration can still have wrong: files it names, and what this version cannot do."""
    problems = credential_problems(config.mqtt)
    try:
        profile = configured_profile(config)
        settings_of(config, wish_of(config, PlanRequest(transaction="check")))
        del profile
    except (RefusedRequestError, UsageError) as error:
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
