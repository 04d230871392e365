"""The plan file (docs/contract.md), `"format": "panoexec.plan/1"`: read with every problem told, written whole.

A file of another planner needs only `shots[].pitch_deg` and `yaw_deg`; the caller supplies missing parts (camera,
constraints), or they are derived (rows). Unknown keys are ignored, so that other programs can add their own.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import Field, Strict, ValidationError, field_validator, model_validator

from panoexec.angles import wrap_180
from panoexec.errors import InputFileError, UsageError
from panoexec.files import write_atomically
from panoexec.inputs.plan_options import (
    ConstraintsModel,
    Degrees,
    Elevation,
    Finite,
    PlanFileModel,
    constraints_to_data,
)
from panoexec.inputs.validation import problem_lines
from panoexec.optics import Camera
from panoexec.planning.model import (
    Certificate,
    Constraints,
    Estimate,
    Hole,
    Method,
    Plan,
    Shot,
)

FORMAT = "panoexec.plan/1"
MAX_SHOTS = 100_000
_SAME_PITCH_DEG = 1e-3
_MOST_IN_ROW_DEG = 3.0
"""Largest step between the pitches of photos of one row."""

_CLEAR_GROWTH = 3.0
_FOV_AGREES_DEG = 0.5

Whole: TypeAlias = Annotated[int, Strict()]
Positive: TypeAlias = Annotated[Finite, Field(gt=0)]


class _DistortionModel(PlanFileModel):
    k1: Finite = 0.0
    k2: Finite = 0.0
    k3: Finite = 0.0
    p1: Finite = 0.0
    p2: Finite = 0.0


class _CameraModel(PlanFileModel):
    name: str = "camera"
    sensor_width_mm: Positive
    sensor_height_mm: Positive
    image_width_px: Annotated[Whole, Field(gt=0, le=1_000_000)]
    image_height_px: Annotated[Whole, Field(gt=0, le=1_000_000)]
    focal_length_mm: Positive
    calibrated_focal_length_mm: Positive | None = None
    distortion: _DistortionModel | None = None
    principal_point_px: tuple[Positive, Positive] | None = None
    fov_margin: Annotated[Finite, Field(ge=0, lt=0.5)] = 0.0
    lens: Literal["calibrated", "nominal"] = "calibrated"
    hfov_deg: Finite | None = None
    vfov_deg: Finite | None = None

    @model_validator(mode="after")
    def _fov_agrees(self) -> Self:
        camera = self.camera()
        try:
            views = {"hfov_deg": camera.hfov_deg, "vfov_deg": camera.vfov_deg}
        except ValueError as error:
            raise ValueError(f"distortion: {error}") from error
        if "lens" not in self.model_fields_set:  # of an earlier version, which computed them for the nominal lens
            nominal = camera.with_lens("nominal")
            views = {"hfov_deg": nominal.hfov_deg, "vfov_deg": nominal.vfov_deg}
        for name, computed in views.items():
            stated = getattr(self, name)
            if stated is not None and abs(stated - computed) > _FOV_AGREES_DEG:
                raise ValueError(f"{name} is {stated:g}, but sensor and lens give {computed:.2f}")
        return self

    def camera(self) -> Camera:
        return Camera.from_plain(self.model_dump())


class _ShotModel(PlanFileModel):
    index: Annotated[Whole, Field(ge=0, lt=MAX_SHOTS)] | None = None
    row: Annotated[Whole, Field(ge=0, lt=MAX_SHOTS)] | None = None
    pitch_deg: Elevation
    yaw_deg: Degrees
    roll_deg: Annotated[Finite, Field(ge=-180, le=180)] = 0.0


class _PlanModel(PlanFileModel):
    format: str | None = None
    method: str | None = None
    camera: _CameraModel | None = None
    constraints: ConstraintsModel | None = None
    shots: Annotated[tuple[_ShotModel, ...], Field(min_length=1, max_length=MAX_SHOTS)]

    @field_validator("format")
    @classmethod
    def _known_format(cls, value: str | None) -> str | None:
        if value is not None and value != FORMAT:
            raise ValueError(f"{value!r} is not supported: use {FORMAT!r}, or omit the key")
        return value

    @field_validator("shots")
    @classmethod
    def _indices_are_an_order(cls, shots: tuple[_ShotModel, ...]) -> tuple[_ShotModel, ...]:
        indices = [shot.index for shot in shots if shot.index is not None]
        if not indices:
            return shots
        if len(indices) < len(shots):
            raise ValueError("some shots have an index and some do not: give all or none")
        if sorted(indices) != list(range(len(shots))):
            raise ValueError(f"the indices must be 0 to {len(shots) - 1}, each once, in shooting order")
        return tuple(sorted(shots, key=lambda shot: shot.index or 0))


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFile:
    """The contents of a plan file; None for missing parts.

    Attributes:
        source: path of the file as given by the user.
        method: planning method; `foreign` if not given.
        camera: camera of the plan.
        constraints: constraints of the plan.
        shots: shots in shooting order; rows are numbered from the lowest pitch up.
    """

    source: str
    method: Method
    camera: Camera | None
    constraints: Constraints | None
    shots: tuple[Shot, ...]

    def plan(self, *, camera: Camera | None = None, constraints: Constraints | None = None) -> Plan:
        """The plan with the given camera and constraints, or with those of the file.

        Raises:
            UsageError: neither the caller nor the file gives the camera or the constraints.
        """
        use_camera = self.camera_for(camera)
        use_constraints = constraints or self.constraints
        if use_constraints is None:
            raise UsageError(f"{self.source} contains no constraints: give --overlap and --elevation MIN MAX")
        return Plan(method=self.method, camera=use_camera, constraints=use_constraints, shots=self.shots)

    def camera_for(self, camera: Camera | None) -> Camera:
        """The camera given, else that of the file.

        Raises:
            UsageError: neither the caller nor the file names one.
        """
        use_camera = camera or self.camera
        if use_camera is None:
            raise UsageError(f"{self.source} contains no camera: give --camera NAME or FILE.toml")
        return use_camera


def read_plan_file(path: Path) -> PlanFile:
    """Read a plan file of panoexec or of another planner.

    Raises:
        InputFileError: the file cannot be read, is not JSON, or is invalid; the error lists every problem.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputFileError(str(path), [f"cannot be read: {error.strerror or error}"]) from error
    except UnicodeDecodeError as error:
        raise InputFileError(str(path), [f"is not UTF-8 text: byte {error.start}: {error.reason}"]) from error
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InputFileError(str(path), [f"is not valid JSON (truncated?): {error.msg} at {where}"]) from error
    except (ValueError, RecursionError) as error:
        raise InputFileError(str(path), [f"is not a plan: {error}"]) from error
    return plan_from_data(data, source=str(path))


def plan_from_data(data: object, *, source: str) -> PlanFile:
    """A plan from parsed JSON.

    Args:
        data: the document.
        source: name of the document in error messages.

    Raises:
        InputFileError: the document is invalid; the error lists every problem.
    """
    if not isinstance(data, dict):
        raise InputFileError(source, ["is not a plan: expected a JSON object with a list `shots`"])
    try:
        model = _PlanModel.model_validate(data)
    except ValidationError as error:
        raise InputFileError(source, problem_lines(error, _PlanModel)) from error
    methods: tuple[Method, ...] = ("certified", "paper", "hdrpano", "published")
    return PlanFile(
        source=source,
        method=next((method for method in methods if method == model.method), "foreign"),
        camera=model.camera.camera() if model.camera else None,
        constraints=model.constraints.constraints() if model.constraints else None,
        shots=_shots(model.shots),
    )


def plan_to_data(plan: Plan) -> dict[str, Any]:
    """The plan as the JSON document of a plan file."""
    return {
        "format": FORMAT,
        "method": plan.method,
        "camera": camera_to_data(plan.camera),
        "constraints": constraints_to_data(plan.constraints),
        "shots": [
            {"index": shot.index, "row": shot.row, "pitch_deg": shot.pitch_deg, "yaw_deg": shot.yaw_deg}
            | ({"roll_deg": shot.roll_deg} if shot.roll_deg else {})
            | ({"geometry_only": True} if shot.geometry_only else {})
            for shot in plan.shots
        ],
        "certificate": certificate_to_data(plan.certificate) if plan.certificate else None,
        "estimate": estimate_to_data(plan.estimate) if plan.estimate else None,
        "lower_bound": plan.lower_bound,
        "notes": list(plan.notes),
    }


def camera_to_data(camera: Camera) -> dict[str, Any]:
    """A camera as written in plan files and manifests."""
    data: dict[str, Any] = {
        "name": camera.name,
        "sensor_width_mm": camera.sensor_width_mm,
        "sensor_height_mm": camera.sensor_height_mm,
        "image_width_px": camera.image_width_px,
        "image_height_px": camera.image_height_px,
        "focal_length_mm": camera.focal_length_mm,
        "lens": camera.lens_used,
        "hfov_deg": round(camera.hfov_deg, 6),
        "vfov_deg": round(camera.vfov_deg, 6),
    }
    if camera.calibrated_focal_length_mm is not None:
        data["calibrated_focal_length_mm"] = camera.calibrated_focal_length_mm
    if camera.distortion is not None:
        data["distortion"] = asdict(camera.distortion)
    if camera.principal_point_px is not None:
        data["principal_point_px"] = list(camera.principal_point_px)
    if camera.fov_margin:
        data["fov_margin"] = camera.fov_margin
    return data


def certificate_to_data(certificate: Certificate) -> dict[str, Any]:
    """A certificate as written in plan files and manifests."""
    data = asdict(certificate)
    data["holes"] = [_hole_to_data(hole) for hole in certificate.holes]
    for key in ("failures", "bridges", "weakest_h"):
        if data[key] is not None:
            data[key] = [list(item) if isinstance(item, tuple) else item for item in data[key]]
    return data


def estimate_to_data(estimate: Estimate) -> dict[str, Any]:
    """An estimate as written in plan files."""
    return asdict(estimate) | {
        "panorama_px": list(estimate.panorama_px),
        "band_px": list(estimate.band_px),
    }


def write_plan(path: Path, plan: Plan) -> None:
    """Write the plan file atomically.

    Raises:
        UsageError: the file cannot be written.
    """
    write_atomically(path, json.dumps(plan_to_data(plan), indent=1, allow_nan=False) + "\n")


def _hole_to_data(hole: Hole) -> dict[str, float]:
    return {"elevation_deg": hole.elevation_deg, "azimuth_deg": hole.azimuth_deg, "size_deg": hole.size_deg}


def _shots(models: Sequence[_ShotModel]) -> tuple[Shot, ...]:
    shots = [
        Shot(
            index=i,
            row=model.row or 0,
            pitch_deg=model.pitch_deg,
            yaw_deg=_wrapped(model.yaw_deg),
            roll_deg=model.roll_deg,
        )
        for i, model in enumerate(models)
    ]
    if all(model.row is not None for model in models):
        return tuple(shots)
    return tuple(_with_rows(shots))


def _wrapped(yaw_deg: float) -> float:
    """The yaw in [-180, 180); unchanged if already in this range, because wrapping may round the last digit."""
    return yaw_deg if -180.0 <= yaw_deg < 180.0 else float(wrap_180(yaw_deg))


def _with_rows(shots: Sequence[Shot]) -> list[Shot]:
    """Number rows from the lowest pitch up; the pitches of a row may differ, see `row_gap_deg`."""
    ordered = sorted(shots, key=lambda s: s.pitch_deg)
    limit = row_gap_deg([shot.pitch_deg for shot in ordered])
    rows: dict[int, int] = {}
    row, last = -1, -1000.0
    for shot in ordered:
        if shot.pitch_deg - last > limit:
            row += 1
        last = shot.pitch_deg
        rows[shot.index] = row
    return [replace(shot, row=rows[shot.index]) for shot in shots]


def row_gap_deg(pitches_deg: Sequence[float]) -> float:
    """The step between ascending pitches (n,) above which a new row begins.

    Photos of a row, as measured or optimised, differ by a degree or two. Steps within rows are small and those between
    rows large: the limit lies where the steps, in order of size, grow by the largest factor. Without a clear such
    place pitches that differ by less than 0.001° are a row.
    """
    steps = sorted(max(b - a, _SAME_PITCH_DEG) for a, b in pairwise(pitches_deg))
    growth, limit = max(
        ((larger / smaller, smaller) for smaller, larger in pairwise(steps) if smaller <= _MOST_IN_ROW_DEG),
        default=(1.0, 0.0),
    )
    return limit if growth >= _CLEAR_GROWTH else _SAME_PITCH_DEG
