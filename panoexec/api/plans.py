"""Plans for Python programs: compute, save, load, verify. The defaults are those of the command line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final, Literal, Self, TypeAlias, TypeVar

from panoexec.errors import UsageError
from panoexec.inputs.camera_profiles import CameraProfile, load_profile
from panoexec.inputs.lens_choice import with_lens
from panoexec.inputs.plan_file import read_plan_file, write_plan
from panoexec.inputs.plan_options import PlanOptions
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.inputs.skyline import skyline_of
from panoexec.optics import Camera, Lens
from panoexec.planning import model
from panoexec.planning.baselines.published import PUBLISHED, published_plan
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.make_plan import METHODS
from panoexec.planning.model import (
    AngleBox,
    Band,
    Certificate,
    Constraints,
    GimbalLimits,
    Guarantee,
    Timing,
    Tolerance,
)
from panoexec.planning.order.shot_order import ORDERS, Order
from panoexec.planning.request import check_request
from panoexec.planning.skyline import Skyline

CameraLike: TypeAlias = str | os.PathLike[str] | Camera | CameraProfile
"""Name of a shipped profile, path of a profile file, a loaded profile, or a camera."""
Range: TypeAlias = tuple[float, float]
Mask: TypeAlias = AngleBox | tuple[float, float, float, float]
"""A box, or its elevation_min, elevation_max, azimuth_min, azimuth_max in degrees."""
T = TypeVar("T")

_DEFAULTS: Final = Constraints(
    overlap_h=0.15,
    overlap_v=0.15,
    band=Band(elevation_min_deg=-90.0, elevation_max_deg=30.0),
    tolerance=Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7),
)
_VEHICLE_YAW_TOLERANCE_DEG: Final = 2.0
"""Where the vehicle pans a gimbal that cannot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan(model.Plan):
    """Shots in shooting order for a camera and constraints, with the certificate and the estimate where made.

    Attributes:
        method: planner that made it.
        camera: that it is for.
        constraints: overlaps, band, tolerances, masks that it was made for.
        shots: poses of the gimbal, in shooting order.
        certificate: the proof; None for a plan that was loaded and not verified.
        estimate: duration (s), slews (degrees), size of the panorama (px); None for a plan that was loaded.
        lower_bound: no plan in rows for these constraints can have fewer images; None where unknown.
        notes: remarks of the planner.
    """

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan file (`panoexec.plan/1`); readers see the old file or the new one.

        Raises:
            UsageError: it cannot be written.
        """
        write_plan(Path(path), self)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, camera: CameraLike | None = None) -> Self:
        """Read a plan file, of panoexec or of another planner.

        A certificate in the file is not believed, so `certificate` and `estimate` are None: `verify` proves the plan.

        Args:
            path: of the file.
            camera: instead of the file's; needed where the file names none.

        Raises:
            InputFileError: the file cannot be read or is wrong, with every problem.
            UsageError: neither the caller nor the file names a camera.
        """
        file = read_plan_file(Path(path))
        if camera is None and file.camera is None:
            raise UsageError(f"{path} names no camera: give camera=")
        plan_ = file.plan(
            camera=_optics(camera)[0] if camera is not None else None, constraints=file.constraints or _DEFAULTS
        )
        return cls._of(plan_)

    @classmethod
    def _of(cls, plan_: model.Plan) -> Self:
        return cls(**{field.name: getattr(plan_, field.name) for field in fields(plan_)})


def plan(
    camera: CameraLike,
    *,
    lens: Lens | None = None,
    overlap: float | None = None,
    overlap_h: float | None = None,
    overlap_v: float | None = None,
    elevation_deg: Range | None = None,
    azimuth_deg: Range | None = None,
    tolerance_deg: Tolerance | Mapping[str, float] | None = None,
    guarantee: Guarantee | None = None,
    masks: Sequence[Mask] | None = None,
    textured_below: float | Sequence[tuple[float, float]] | None = None,
    gimbal: GimbalLimits | None = None,
    method: Literal["certified", "paper", "hdrpano"] = "certified",
    order: Order = "fastest",
    columns: int | None = None,
    rows: int | None = None,
    budget_s: float | None = None,
) -> Plan:
    """Compute the gimbal poses that cover a panorama, with their certificate.

    Args:
        camera: name of a profile (`panoexec cameras`), path of a profile file, `CameraProfile` or `Camera`.
        lens: which lens of it counts; the calibrated one, where it is known.
        overlap: least overlap in rows and between rows, fraction of the image area, [0, 1); 0.15.
        overlap_h: of neighbours in a row, instead of `overlap`.
        overlap_v: of neighbouring rows, instead of `overlap`.
        elevation_deg: band to cover, (min, max), -90 is the nadir; (-90, 30).
        azimuth_deg: sector to cover, clockwise from min to max; the full circle.
        tolerance_deg: largest pointing error of each gimbal axis, a `Tolerance` or any of `pitch`, `roll`, `yaw`;
            0.1, 0.1 and 0.7, or 2.0 of yaw where the vehicle alone pans.
        guarantee: `coverage`: coverage and connectivity hold for every error; `all`: the overlaps too.
        masks: directions that need no coverage, such as the landing gear.
        textured_below: where the sky begins, which ties no images: an elevation, or (azimuth, elevation) pairs.
        gimbal: limits and rates; a gimbal that reaches every pose by default.
        method: planner; `paper` and `hdrpano` are for comparison.
        order: of shooting.
        columns: for `hdrpano`: images at the horizon.
        rows: for `hdrpano`.
        budget_s: processor time of the search, which then ends with the best plan so far; 20.

    Returns:
        The plan; its `certificate.certified` says whether it is proven, `certificate.failures` what is not.

    Raises:
        PlanningError: no plan can satisfy the request.
        InputFileError: the profile file is unreadable or wrong.
        UsageError: no such profile, or an argument is wrong.
    """
    _check_choice("method", method, METHODS)
    _check_choice("order", order, ORDERS)
    used, timing = _optics(camera)
    default = _DEFAULTS
    if gimbal is not None and gimbal.turning is not None and not gimbal.pans:
        default = replace(default, tolerance=replace(default.tolerance, yaw_deg=_VEHICLE_YAW_TOLERANCE_DEG))
    options = _options(
        overlap=overlap,
        overlap_h=overlap_h,
        overlap_v=overlap_v,
        elevation_deg=elevation_deg,
        azimuth_deg=azimuth_deg,
        tolerance_deg=tolerance_deg,
        guarantee=guarantee,
        masks=masks,
        textured_below=textured_below,
    )
    options = replace(options, lens=lens, gimbal=gimbal, method=method, order=order, columns=columns, rows=rows)
    if budget_s is not None:
        if not budget_s > 0:
            raise UsageError(f"budget_s {budget_s:g} is out of range: give seconds above 0")
        options = replace(options, budget_s=budget_s)
    made = options.over(PlanSpec(camera=used, constraints=default, timing=timing)).plan()
    return Plan._of(made)  # noqa: SLF001  (the class is this module's own)


def verify(
    plan: model.Plan | str | os.PathLike[str],
    *,
    camera: CameraLike | None = None,
    lens: Lens | None = None,
    overlap: float | None = None,
    overlap_h: float | None = None,
    overlap_v: float | None = None,
    elevation_deg: Range | None = None,
    azimuth_deg: Range | None = None,
    tolerance_deg: Tolerance | Mapping[str, float] | None = None,
    guarantee: Guarantee | None = None,
    masks: Sequence[Mask] | None = None,
    textured_below: float | Sequence[tuple[float, float]] | None = None,
) -> Certificate:
    """Prove or refute a plan, whoever made it; what is not given comes from the plan, then from the defaults.

    Args:
        plan: a plan, the path of a plan file, or the name of one of the paper's plans (docs/certificate.md).
        camera: as in `plan`; instead of the plan's.
        lens: as in `plan`; that of the plan's camera.
        overlap: as in `plan`, as are all below.
        overlap_h: of neighbours in a row.
        overlap_v: of neighbouring rows.
        elevation_deg: band that must be covered.
        azimuth_deg: sector that must be covered.
        tolerance_deg: pointing errors that the plan must survive.
        guarantee: what must hold for every error.
        masks: directions that need no coverage.
        textured_below: where the sky begins.

    Returns:
        The certificate: `certified`, or `failures` and `holes`.

    Raises:
        InputFileError: the file is unreadable or wrong.
        PlanningError: the constraints make no sense.
        UsageError: an argument is wrong, or nobody names the camera.
    """
    if not isinstance(plan, model.Plan):
        name = os.fspath(plan)
        published = name in PUBLISHED and not Path(name).exists()
        plan = published_plan(name) if published else Plan.load(plan, camera=camera)
    options = _options(
        overlap=overlap,
        overlap_h=overlap_h,
        overlap_v=overlap_v,
        elevation_deg=elevation_deg,
        azimuth_deg=azimuth_deg,
        tolerance_deg=tolerance_deg,
        guarantee=guarantee,
        masks=masks,
        textured_below=textured_below,
    )
    used = with_lens(plan.camera if camera is None else _optics(camera)[0], lens)
    constraints = options.over(PlanSpec(camera=used, constraints=plan.constraints)).constraints
    check_request(used, constraints)
    return certify(replace(plan, camera=used, constraints=constraints))


def _options(
    *,
    overlap: float | None,
    overlap_h: float | None,
    overlap_v: float | None,
    elevation_deg: Range | None,
    azimuth_deg: Range | None,
    tolerance_deg: Tolerance | Mapping[str, float] | None,
    guarantee: Guarantee | None,
    masks: Sequence[Mask] | None,
    textured_below: float | Sequence[tuple[float, float]] | None,
) -> PlanOptions:
    """What the arguments say of the constraints."""
    if guarantee is not None:
        _check_choice("guarantee", guarantee, ("coverage", "all"))
    tolerance = _tolerance(tolerance_deg)
    return PlanOptions(
        overlap=overlap,
        overlap_h=overlap_h,
        overlap_v=overlap_v,
        elevation_deg=_pair("elevation_deg", elevation_deg),
        azimuth_deg=_pair("azimuth_deg", azimuth_deg),
        tolerance_pitch_deg=tolerance.get("pitch"),
        tolerance_roll_deg=tolerance.get("roll"),
        tolerance_yaw_deg=tolerance.get("yaw"),
        guarantee=guarantee,
        masks=None if masks is None else tuple(_mask(mask) for mask in masks),
        textured_below=None if textured_below is None else _skyline(textured_below),
    )


def _optics(camera: CameraLike) -> tuple[Camera, Timing]:
    """The optics, and what a shot costs with them."""
    if isinstance(camera, Camera):
        return camera, Timing()
    if isinstance(camera, CameraProfile):
        profile = camera
    elif isinstance(camera, str):
        profile = load_profile(camera)
    else:  # a path, even where it is a bare name
        profile = load_profile(os.path.join(".", os.fspath(camera)))  # noqa: PTH118  (a Path would drop the dot)
    return profile.camera, Timing(exposure_s=profile.max_exposure_s, interval_s=profile.min_interval_s)


def _tolerance(given: Tolerance | Mapping[str, float] | None) -> Mapping[str, float]:
    """The largest errors that are given, degrees by axis."""
    if given is None:
        return {}
    if isinstance(given, Tolerance):
        return {"pitch": given.pitch_deg, "roll": given.roll_deg, "yaw": given.yaw_deg}
    for axis in given:
        _check_choice("tolerance_deg", axis, ("pitch", "roll", "yaw"))
    return given


def _mask(mask: Mask) -> AngleBox:
    if isinstance(mask, AngleBox):
        return mask
    if len(mask) != 4:
        raise UsageError(f"mask {mask!r}: give elevation_min, elevation_max, azimuth_min, azimuth_max in degrees")
    low, high, left, right = mask
    return AngleBox(elevation_min_deg=low, elevation_max_deg=high, azimuth_min_deg=left, azimuth_max_deg=right)


def _pair(name: str, given: Range | None) -> Range | None:
    if given is None:
        return None
    if len(given) != 2:
        raise UsageError(f"{name} {given!r}: give (min, max) in degrees")
    return given[0], given[1]


def _check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    if value not in choices:
        raise UsageError(f"{name} {value!r} is not known: one of {', '.join(choices)}")


def _skyline(value: float | Sequence[tuple[float, float]]) -> Skyline:
    try:
        return skyline_of(value)
    except (TypeError, ValueError) as error:
        raise UsageError(f"textured_below {error}") from error
