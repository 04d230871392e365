"""What each source says of a panorama, and which one comes first: a person, then a plan file, then the defaults.

* A person says it on the command line or in an MQTT request: `PlanOptions`, whose `over` merges it with the rest.
* A plan file says it under `constraints`: `ConstraintsModel`, `constraints_to_data`.
* The configuration says it for the daemon: `configured_spec`. The command line has defaults of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, field_validator

from panoexec.azimuths import azimuth_range
from panoexec.inputs.lens_choice import with_lens
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.inputs.skyline import MOST_POINTS, skyline_of, skyline_to_data
from panoexec.optics import Camera, Lens
from panoexec.planning.model import (
    AngleBox,
    Band,
    Constraints,
    GimbalLimits,
    Guarantee,
    Timing,
    Tolerance,
    Turning,
    TurnLimits,
)
from panoexec.planning.order.shot_order import Order
from panoexec.planning.skyline import Skyline

if TYPE_CHECKING:
    from panoexec.inputs.camera_profiles import CameraProfile
    from panoexec.inputs.config import Config
    from panoexec.inputs.plan_file import PlanFile
    from panoexec.inputs.vehicle_sections import VehicleSection

_T = TypeVar("_T")

UNKNOWN_TURNS = TurnLimits()

# strict: a text or a truth value where a number belongs is a mistake in the program that wrote it
Finite: TypeAlias = Annotated[float, Strict(), Field(allow_inf_nan=False)]
Overlap: TypeAlias = Annotated[Finite, Field(ge=0, lt=1)]
Degrees: TypeAlias = Annotated[Finite, Field(ge=-720, le=720)]
Elevation: TypeAlias = Annotated[Finite, Field(ge=-90, le=90)]
SkylinePoint: TypeAlias = tuple[Degrees, Elevation]


def _is_a_skyline(value: float | tuple[SkylinePoint, ...]) -> float | tuple[SkylinePoint, ...]:
    skyline_of(value)
    return value


SkylineField: TypeAlias = Annotated[
    Elevation | Annotated[tuple[SkylinePoint, ...], Field(min_length=1, max_length=MOST_POINTS)],
    AfterValidator(_is_a_skyline),
]
"""`textured_below`: an elevation, or (azimuth, elevation) pairs."""

AxisTolerance: TypeAlias = Annotated[Finite, Field(ge=0, lt=90)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanOptions:
    """What a person can say of a panorama, on the command line or in a request; None: not said.

    Angles are in degrees: elevation -90 is the nadir, azimuths run clockwise from the reference of yaw.

    Attributes:
        camera: optics, as mounted.
        lens: which lens of the camera counts; not said: that of the camera.
        overlap: least overlap of neighbours, fraction of the image area; for what the next two leave open.
        overlap_h: least overlap of neighbours in a row.
        overlap_v: least overlap of neighbouring rows.
        elevation_deg: band to cover, (min, max).
        azimuth_deg: sector to cover, clockwise from min to max.
        tolerance_pitch_deg: largest pointing error in pitch.
        tolerance_roll_deg: largest pointing error in roll.
        tolerance_yaw_deg: largest pointing error in yaw.
        guarantee: what holds for every pointing error: `coverage`, or `all`, the overlaps too.
        masks: directions that need no coverage.
        textured_below: where the sky begins: only what lies below it ties images.
        gimbal: where the gimbal can point, and how fast.
        method: planner.
        order: of shooting.
        columns: for hdrpano: images at the horizon.
        rows: for hdrpano.
        budget_s: for certified: processor time of the search.
    """

    camera: Camera | None = None
    lens: Lens | None = None
    overlap: float | None = None
    overlap_h: float | None = None
    overlap_v: float | None = None
    elevation_deg: tuple[float, float] | None = None
    azimuth_deg: tuple[float, float] | None = None
    tolerance_pitch_deg: float | None = None
    tolerance_roll_deg: float | None = None
    tolerance_yaw_deg: float | None = None
    guarantee: Guarantee | None = None
    masks: tuple[AngleBox, ...] | None = None
    textured_below: Skyline | None = None
    gimbal: GimbalLimits | None = None
    method: str | None = None
    order: Order | None = None
    columns: int | None = None
    rows: int | None = None
    budget_s: float | None = None

    def over(self, defaults: PlanSpec, file: PlanFile | None = None) -> PlanSpec:
        """The specification: what is said here, else what the plan file says, else the defaults.

        Args:
            defaults: for what nobody says; its timing is taken as it is.
            file: a plan file, which becomes the given plan.

        Raises:
            UsageError: the calibrated lens is asked for, and nothing is known of it.
        """
        camera = _said(self.camera, _said(file.camera if file is not None else None, defaults.camera))
        camera = with_lens(camera, self.lens)
        constraints = self._constraints_over(defaults.constraints, file.constraints if file is not None else None)
        return PlanSpec(
            camera=camera,
            constraints=constraints,
            method=_said(self.method, defaults.method),
            order=_said(self.order, defaults.order),
            timing=defaults.timing,
            columns=_said(self.columns, defaults.columns),
            rows=_said(self.rows, defaults.rows),
            budget_s=_said(self.budget_s, defaults.budget_s),
            given=defaults.given if file is None else file.plan(camera=camera, constraints=constraints),
        )

    def _constraints_over(self, defaults: Constraints, of_file: Constraints | None) -> Constraints:
        base = of_file or defaults  # the constraints of a file are complete, but for the gimbal
        tolerance = base.tolerance
        return Constraints(
            overlap_h=_said(self.overlap_h, _said(self.overlap, base.overlap_h)),
            overlap_v=_said(self.overlap_v, _said(self.overlap, base.overlap_v)),
            band=self._band_over(base.band),
            tolerance=Tolerance(
                pitch_deg=_said(self.tolerance_pitch_deg, tolerance.pitch_deg),
                roll_deg=_said(self.tolerance_roll_deg, tolerance.roll_deg),
                yaw_deg=_said(self.tolerance_yaw_deg, tolerance.yaw_deg),
            ),
            guarantee=_said(self.guarantee, base.guarantee),
            masks=_said(self.masks, base.masks),
            textured_below=_said(self.textured_below, base.textured_below),
            gimbal=_said(self.gimbal, _said(base.gimbal, defaults.gimbal)),
        )

    def _band_over(self, base: Band) -> Band:
        band = base
        if self.elevation_deg is not None:
            low, high = self.elevation_deg
            band = replace(band, elevation_min_deg=low, elevation_max_deg=high)
        if self.azimuth_deg is not None:
            left, right = self.azimuth_deg
            band = replace(band, azimuth_min_deg=left, azimuth_max_deg=right)
        return band


def _said(value: _T | None, otherwise: _T) -> _T:
    return otherwise if value is None else value


# --- in a plan file


class PlanFileModel(BaseModel):
    """A part of a plan file: unknown keys are ignored; what panoexec writes has every key."""

    model_config = ConfigDict(extra="ignore", frozen=True, json_schema_serialization_defaults_required=True)


class ToleranceModel(PlanFileModel):
    """Largest accepted pointing error of each axis, degrees."""

    pitch: AxisTolerance
    roll: AxisTolerance
    yaw: AxisTolerance


class MaskModel(PlanFileModel):
    """A box of directions that needs no coverage."""

    elevation_deg: tuple[Elevation, Elevation]
    azimuth_deg: tuple[Degrees, Degrees]

    @field_validator("azimuth_deg")
    @classmethod
    def _a_sector(cls, value: tuple[float, float]) -> tuple[float, float]:
        azimuth_range(*value)
        return value


class ConstraintsModel(PlanFileModel):
    """`constraints` of a plan file and of the topic `plan`; their JSON Schema is generated from this."""

    overlap_h: Overlap
    overlap_v: Overlap
    elevation_deg: tuple[Elevation, Elevation]
    azimuth_deg: tuple[Degrees, Degrees] = (-180.0, 180.0)
    tolerance_deg: ToleranceModel
    guarantee: Literal["coverage", "all"] = "coverage"
    masks: Annotated[tuple[MaskModel, ...], Field(max_length=1000)] = ()
    textured_below: SkylineField | None = None

    @field_validator("elevation_deg")
    @classmethod
    def _not_upside_down(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not value[0] < value[1]:
            raise ValueError(f"[{value[0]:g}, {value[1]:g}] is empty or reversed: give the lower end first")
        return value

    @field_validator("azimuth_deg")
    @classmethod
    def _a_sector(cls, value: tuple[float, float]) -> tuple[float, float]:
        azimuth_range(*value)
        return value

    def constraints(self) -> Constraints:
        """The same as the planner has it."""
        return Constraints(
            overlap_h=self.overlap_h,
            overlap_v=self.overlap_v,
            band=Band(
                elevation_min_deg=self.elevation_deg[0],
                elevation_max_deg=self.elevation_deg[1],
                azimuth_min_deg=self.azimuth_deg[0],
                azimuth_max_deg=self.azimuth_deg[1],
            ),
            tolerance=Tolerance(
                pitch_deg=self.tolerance_deg.pitch, roll_deg=self.tolerance_deg.roll, yaw_deg=self.tolerance_deg.yaw
            ),
            guarantee=self.guarantee,
            masks=tuple(
                AngleBox(
                    elevation_min_deg=mask.elevation_deg[0],
                    elevation_max_deg=mask.elevation_deg[1],
                    azimuth_min_deg=mask.azimuth_deg[0],
                    azimuth_max_deg=mask.azimuth_deg[1],
                )
                for mask in self.masks
            ),
            textured_below=None if self.textured_below is None else skyline_of(self.textured_below),
        )


def constraints_to_data(constraints: Constraints) -> dict[str, Any]:
    """Constraints as plan files show them; what the gimbal can do is left out, as it belongs to the vehicle."""
    band = constraints.band
    return {
        "overlap_h": constraints.overlap_h,
        "overlap_v": constraints.overlap_v,
        "elevation_deg": [band.elevation_min_deg, band.elevation_max_deg],
        "azimuth_deg": [band.azimuth_min_deg, band.azimuth_max_deg],
        "tolerance_deg": {
            "pitch": constraints.tolerance.pitch_deg,
            "roll": constraints.tolerance.roll_deg,
            "yaw": constraints.tolerance.yaw_deg,
        },
        "guarantee": constraints.guarantee,
        "masks": [
            {
                "elevation_deg": [mask.elevation_min_deg, mask.elevation_max_deg],
                "azimuth_deg": [mask.azimuth_min_deg, mask.azimuth_max_deg],
            }
            for mask in constraints.masks
        ],
        "textured_below": skyline_to_data(constraints.textured_below),
    }


# --- in the configuration


def configured_spec(config: Config, profile: CameraProfile, limits: TurnLimits = UNKNOWN_TURNS) -> PlanSpec:
    """The panorama that the configuration describes: the defaults of requests.

    Args:
        config: of the daemon.
        profile: the camera, configured or not (see `panoexec.inputs.camera_profiles.configured_profile`).
        limits: of the vehicle's turns, if known.
    """
    section, pointing = config.mission, config.pointing
    return PlanSpec(
        camera=profile.camera,
        constraints=Constraints(
            overlap_h=section.overlap_h,
            overlap_v=section.overlap_v,
            band=Band(
                elevation_min_deg=section.elevation_deg[0],
                elevation_max_deg=section.elevation_deg[1],
                azimuth_min_deg=section.azimuth_deg[0],
                azimuth_max_deg=section.azimuth_deg[1],
            ),
            tolerance=Tolerance(
                pitch_deg=pointing.tolerance_pitch_deg,
                roll_deg=pointing.tolerance_roll_deg,
                yaw_deg=pointing.tolerance_yaw_deg,
            ),
            guarantee=section.guarantee,
            textured_below=None if section.textured_below is None else skyline_of(section.textured_below),
            gimbal=configured_gimbal(config, limits),
        ),
        method=section.method,
        order=section.order,
        budget_s=section.budget_s,
        timing=configured_timing(config, profile),
    )


def configured_turning(vehicle: VehicleSection, limits: TurnLimits) -> Turning:
    """How the vehicle turns: as configured, else as its autopilot does by itself, never faster than it can.

    Args:
        vehicle: the configuration.
        limits: of the autopilot, if known.
    """
    own = {}
    if limits.own_rate:
        told = {"rate_deg_s": limits.rate_deg_s, "acceleration_deg_s2": limits.acceleration_deg_s2}
        own = {name: value for name, value in told.items() if math.isfinite(value)}
    configured = {"rate_deg_s": vehicle.yaw_rate_deg_s, "acceleration_deg_s2": vehicle.yaw_acceleration_deg_s2}
    chosen = own | {name: value for name, value in configured.items() if value is not None}
    return Turning(**chosen).within(limits)


def configured_gimbal(config: Config, limits: TurnLimits = UNKNOWN_TURNS) -> GimbalLimits:
    """Where the gimbal can point and how fast, as configured, and whether the vehicle pans in its place.

    Args:
        config: the configuration.
        limits: of the vehicle's turns, if known.
    """
    section, default = config.gimbal, GimbalLimits()
    pitch = section.pitch_deg or (default.pitch_min_deg, default.pitch_max_deg)
    yaw = section.yaw_deg or (default.yaw_min_deg, default.yaw_max_deg)
    endless = section.yaw_endless if section.yaw_endless is not None else section.yaw_deg is None
    turning = None
    if section.yaw != "gimbal":
        turning = configured_turning(config.vehicle, limits)
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


def configured_timing(config: Config, profile: CameraProfile) -> Timing:
    """What a shot costs besides the slew: as configured, else as the camera's profile says."""
    camera = config.camera
    # a camera on a cable hands its files over in flight; of others it is known where somebody says how long it takes
    arrive = camera.transfer_s is not None or camera.trigger == "gphoto2"
    return Timing(
        settle_s=config.pointing.settle_s,
        exposure_s=profile.max_exposure_s if camera.exposure_s is None else camera.exposure_s,
        trigger_latency_s=camera.latency_s,
        interval_s=profile.min_interval_s if camera.interval_s is None else camera.interval_s,
        brackets=camera.bracket,
        transfer_s=camera.transfer_s or 0.0,
        check_s=check_time_s(profile.camera) if arrive and config.pictures.check != "off" else 0.0,
    )


def check_time_s(camera: Camera) -> float:
    """Processor time of examining a photo, by its pixels: measured (docs/content.md)."""
    return 0.08 + 0.11 * camera.image_width_px * camera.image_height_px / 24e6
