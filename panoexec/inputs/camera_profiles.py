"""Camera profiles: the camera properties that planner and mission need, from TOML files or inline tables.

A profile describes the camera in landscape format, with the longer side as the width; `orientation` is its mounting
orientation. The field of view is computed from sensor and focal length. The included profiles are in
`panoexec/profiles` (`config/cameras`).
"""

from __future__ import annotations

import importlib.resources
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, field_validator, model_validator

from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.config import Config
from panoexec.inputs.lens_choice import with_lens
from panoexec.inputs.validation import problem_lines, read_toml
from panoexec.lens.distortion import Distortion
from panoexec.optics import Camera
from panoexec.suggestions import did_you_mean

Orientation: TypeAlias = Literal["landscape", "portrait"]
Millimetres: TypeAlias = Annotated[FiniteFloat, Field(gt=0, le=10_000)]
Pixels: TypeAlias = Annotated[int, Field(gt=0, le=1_000_000)]
Coefficient: TypeAlias = Annotated[FiniteFloat, Field(ge=-100, le=100)]
FovMargin: TypeAlias = Annotated[FiniteFloat, Field(ge=0, lt=0.5)]
Seconds: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=600)]

_ASPECT_AGREES = 0.03
_LARGEST_FOV_DEG = 179.0
_NO_FOCAL_LENGTH = "focal_length_mm is missing (or zoom_range_mm = [shortest, longest])"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraProfile:
    """A mounted camera: optics, timing and source of the data.

    Attributes:
        camera: optics in the mounting orientation.
        orientation: mounting orientation.
        min_interval_s: minimum time between two photos.
        max_exposure_s: maximum exposure time set on the camera; the pose must be held for this time.
        source: source of the data.
        zoom_range_mm: shortest and longest focal length, or None for a fixed lens.
    """

    camera: Camera
    orientation: Orientation
    min_interval_s: float
    max_exposure_s: float
    source: str
    zoom_range_mm: tuple[float, float] | None = None


class DistortionModel(BaseModel):
    """`distortion` of a profile: see `panoexec.lens.distortion`; what is left out is 0."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    k3: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0

    def distortion(self) -> Distortion:
        """The same as the camera has it."""
        return Distortion(**self.model_dump())


class _ProfileModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: Annotated[str, Field(min_length=1, max_length=80)] | None = None
    sensor_width_mm: Millimetres
    sensor_height_mm: Millimetres
    image_width_px: Pixels
    image_height_px: Pixels
    focal_length_mm: Millimetres | None = None
    zoom_range_mm: Annotated[list[Millimetres], Field(min_length=2, max_length=2)] | None = None
    calibrated_focal_length_mm: Millimetres | None = None
    distortion: DistortionModel | None = None
    principal_point_px: Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)] | None = None
    fov_margin: FovMargin = 0.0
    orientation: Orientation = "landscape"
    min_interval_s: Seconds = 1.0
    max_exposure_s: Annotated[Seconds, Field(gt=0)] = 0.02
    source: Annotated[str, Field(min_length=1, max_length=2000)]

    @field_validator("focal_length_mm", mode="before")
    @classmethod
    def _one_length(cls, value: object) -> object:
        if isinstance(value, list):
            raise ValueError(  # noqa: TRY004  (pydantic reports it with the key)
                f"{value} is more than one length: use zoom_range_mm = [shortest, longest] for a zoom lens"
            )
        return value

    @field_validator("zoom_range_mm")
    @classmethod
    def _rising(cls, value: list[float] | None) -> list[float] | None:
        if value is not None and not value[0] < value[1]:
            raise ValueError(f"{value} must be two focal lengths, the shorter first")
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        problems = [*self._size_problems(), *self._lens_problems()]
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _size_problems(self) -> list[str]:
        if self.sensor_width_mm < self.sensor_height_mm or self.image_width_px < self.image_height_px:
            return ['widths must be the longer sides; use `orientation = "portrait"` for portrait mounting']
        sensor = self.sensor_width_mm / self.sensor_height_mm
        image = self.image_width_px / self.image_height_px
        if abs(sensor / image - 1) > _ASPECT_AGREES:
            problem = (
                f"the sensor is {sensor:.3f} times as wide as high, the image {image:.3f} times: "
                "give the size of the sensor area that the image uses"
            )
            return [problem]
        return []

    def _lens_problems(self) -> list[str]:
        if self.focal_length_mm is None and self.zoom_range_mm is None:
            return [_NO_FOCAL_LENGTH]
        shortest = self.focal_length_mm or 0.0
        problems = []
        if self.zoom_range_mm is not None:
            low, high = self.zoom_range_mm
            shortest = low
            if self.focal_length_mm is not None and not low <= self.focal_length_mm <= high:
                problems.append(f"focal_length_mm is {self.focal_length_mm:g}: it must lie within {low:g} to {high:g}")
            problems += [
                f"{key} is for fixed lenses only: remove it for a zoom lens"
                for key in ("calibrated_focal_length_mm", "distortion", "principal_point_px")
                if getattr(self, key) is not None
            ]
        point, size = self.principal_point_px, (self.image_width_px, self.image_height_px)
        if point is not None and not all(0 < at < extent for at, extent in zip(point, size, strict=True)):
            problems.append(
                f"principal_point_px is {point}: it must lie within the image, [0, 0] to [{size[0]}, {size[1]}]"
            )
        return problems or self._view_problems(self.camera("", shortest))

    def _view_problems(self, camera: Camera) -> list[str]:
        try:
            fov = max(camera.hfov_deg, camera.pinhole_hfov_deg, camera.with_lens("nominal").hfov_deg)
        except ValueError as error:
            return [f"distortion: {error}"]
        if fov > _LARGEST_FOV_DEG:
            problem = (
                f"sensor_width_mm and focal length give a field of view of {fov:.2f}°: "
                f"the maximum for pinhole images is {_LARGEST_FOV_DEG:g}°"
            )
            return [problem]
        return []

    def _point(self) -> tuple[float, float]:
        assert self.principal_point_px is not None
        across, down = self.principal_point_px
        return across, down

    def camera(self, name: str, focal_length_mm: float) -> Camera:
        return Camera(
            name=self.name or name,
            sensor_width_mm=self.sensor_width_mm,
            sensor_height_mm=self.sensor_height_mm,
            image_width_px=self.image_width_px,
            image_height_px=self.image_height_px,
            focal_length_mm=focal_length_mm,
            calibrated_focal_length_mm=self.calibrated_focal_length_mm,
            distortion=None if self.distortion is None else self.distortion.distortion(),
            principal_point_px=None if self.principal_point_px is None else self._point(),
            fov_margin=self.fov_margin,
        )


def load_profile(
    name_or_path: str, *, orientation: Orientation | None = None, focal_length_mm: float | None = None
) -> CameraProfile:
    """Load an included profile by name, or any profile by the path of its TOML file.

    Args:
        name_or_path: a path if it ends in .toml or contains a path separator, otherwise a name.
        orientation: mounting orientation that overrides the profile.
        focal_length_mm: focal length of a zoom lens; default: that of the profile, otherwise the shortest.

    Raises:
        UsageError: there is no such profile (similar names are listed), or the focal length is out of range.
        InputFileError: the file is unreadable or invalid; the error lists every problem.
    """
    if name_or_path.endswith(".toml") or os.sep in name_or_path:
        path = Path(name_or_path)
        data = {"source": "not given"} | read_toml(path)
        return _profile(data, name_or_path, path.stem, orientation, focal_length_mm)
    shipped = _shipped()
    path_of_name = shipped.get(name_or_path)
    if path_of_name is None:
        near = did_you_mean(name_or_path, shipped.keys(), cutoff=0.4)
        hint = near and f"{near} "
        raise UsageError(
            f"there is no camera profile {name_or_path!r}: {hint}`panoexec cameras` lists them; "
            "give your own profile as FILE.toml"
        )
    return _profile(read_toml(path_of_name), str(path_of_name), name_or_path, orientation, focal_length_mm)


def configured_profile(config: Config) -> CameraProfile:
    """The camera that the configuration names.

    Raises:
        UsageError: there is no such profile, or it does not fit.
    """
    section = config.camera
    profile = load_profile(section.profile, orientation=section.orientation, focal_length_mm=section.focal_length_mm)
    return replace(profile, camera=with_lens(profile.camera, section.lens))


def profile_from_mapping(
    data: Mapping[str, Any],
    *,
    source: str,
    name: str = "inline",
    orientation: Orientation | None = None,
    focal_length_mm: float | None = None,
) -> CameraProfile:
    """A profile from a table with the keys of a profile file, for example in a request; `source` is optional.

    Args:
        data: keys and values.
        source: name of the table in error messages.
        name: name of the camera, if `data` has none.
        orientation: as in `load_profile`.
        focal_length_mm: as in `load_profile`.

    Raises:
        InputFileError: the table is invalid; the error lists every problem.
        UsageError: the requested focal length is out of range.
    """
    return _profile({"source": "given inline"} | dict(data), source, name, orientation, focal_length_mm)


def list_profiles() -> list[CameraProfile]:
    """All included profiles, sorted by name."""
    return [load_profile(name) for name in _shipped()]


def _profile(
    data: Mapping[str, Any], source: str, name: str, orientation: Orientation | None, focal_length_mm: float | None
) -> CameraProfile:
    try:
        model = _ProfileModel.model_validate(dict(data))
    except ValidationError as error:
        problems = problem_lines(error, _ProfileModel)
        if not {"focal_length_mm", "zoom_range_mm"} & data.keys() and _NO_FOCAL_LENGTH not in problems:
            # conditions on several keys are only checked if each key is valid
            problems.append(_NO_FOCAL_LENGTH)
        raise InputFileError(source, problems) from error
    camera = model.camera(name, _focal_length(model, focal_length_mm, name))
    mounted = orientation or model.orientation
    return CameraProfile(
        camera=camera.rotated() if mounted == "portrait" else camera,
        orientation=mounted,
        min_interval_s=model.min_interval_s,
        max_exposure_s=model.max_exposure_s,
        source=model.source,
        zoom_range_mm=(model.zoom_range_mm[0], model.zoom_range_mm[1]) if model.zoom_range_mm else None,
    )


def _focal_length(model: _ProfileModel, asked_mm: float | None, name: str) -> float:
    if model.zoom_range_mm is None:
        fixed = model.focal_length_mm
        assert fixed is not None
        if asked_mm is not None and asked_mm != fixed:
            raise UsageError(
                f"{name} has a fixed lens of {fixed:g} mm: a focal length of {asked_mm:g} mm is not possible"
            )
        return fixed
    low, high = model.zoom_range_mm
    focal = asked_mm or model.focal_length_mm or low
    if not low <= focal <= high:
        raise UsageError(f"{name} zooms from {low:g} to {high:g} mm: a focal length of {focal:g} mm is not possible")
    return focal


def _shipped() -> dict[str, Path]:
    """Files of the included profiles by name, sorted."""
    folder = importlib.resources.files("panoexec") / "profiles"
    return {path.stem: path for path in sorted(Path(str(folder)).glob("*.toml"))}
