"""Validation of planning requests: a request that no plan can satisfy is rejected before the search, in one line."""

from __future__ import annotations

from panoexec.azimuths import azimuth_range
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.model import AngleBox, Band, Constraints, GimbalLimits

MAX_IMAGES = 100_000
"""A request for more images than this is treated as a mistake."""

_NARROWEST_BAND_DEG = 1e-6
_SMALLEST_FOV_DEG = 0.05
_LARGEST_FOV_DEG = 179.0


def check_request(camera: Camera, constraints: Constraints) -> None:
    """Reject invalid or impossible requests, whatever the method.

    Raises:
        PlanningError: the message names the constraint, its value and the accepted range.
    """
    _check_camera(camera)
    _check_overlap("horizontal overlap", constraints.overlap_h)
    _check_overlap("vertical overlap", constraints.overlap_v)
    _check_band(constraints.band)
    for mask in constraints.masks:
        _check_box("mask", mask)
    for name, value in (
        ("pitch", constraints.tolerance.pitch_deg),
        ("roll", constraints.tolerance.roll_deg),
        ("yaw", constraints.tolerance.yaw_deg),
    ):
        if not 0 <= value < 90:
            raise PlanningError(f"{name} tolerance {value:g}° is out of range: give degrees from 0 to below 90")
    if constraints.gimbal is not None:
        _check_limits(constraints.gimbal)


def _check_camera(camera: Camera) -> None:
    try:
        camera.image_area  # noqa: B018  (computed once)
    except ValueError as error:
        raise PlanningError(f"the lens of {camera.name}: {error}") from error
    for side, fov in (("horizontal", camera.hfov_deg), ("vertical", camera.vfov_deg)):
        if not _SMALLEST_FOV_DEG <= fov <= _LARGEST_FOV_DEG:
            raise PlanningError(
                f"the {side} field of view of {camera.name} is {fov:.3g}°: "
                f"the planner supports pinhole images of {_SMALLEST_FOV_DEG:g}° to {_LARGEST_FOV_DEG:g}°"
            )


def _check_overlap(name: str, value: float) -> None:
    if not 0 <= value < 1:
        hint = f" (as a fraction, {value:g} % is {value / 100:g})" if 1 < value < 100 else ""
        raise PlanningError(f"{name} {value:g} is out of range: give a fraction from 0 to below 1{hint}")


def _check_band(band: Band) -> None:
    low, high = band.elevation_min_deg, band.elevation_max_deg
    if not (-90 <= low <= 90 and -90 <= high <= 90):
        raise PlanningError(f"elevation {low:g} to {high:g}° is out of range: give degrees from -90 to 90")
    if high - low < _NARROWEST_BAND_DEG:
        raise PlanningError(f"elevation {low:g} to {high:g}° is reversed or empty: give the lower end first")
    _check_azimuths("azimuth", band)


def _check_box(name: str, box: AngleBox) -> None:
    low, high = box.elevation_min_deg, box.elevation_max_deg
    if not -90 <= low < high <= 90:
        raise PlanningError(f"{name} elevation {low:g} to {high:g}° is not a range within -90 to 90")
    _check_azimuths(f"{name} azimuth", box)


def _check_azimuths(name: str, box: Band | AngleBox) -> None:
    try:
        azimuth_range(box.azimuth_min_deg, box.azimuth_max_deg)
    except ValueError as error:
        raise PlanningError(f"{name} {error}") from error
    if box.azimuth_span_deg < _NARROWEST_BAND_DEG:
        raise PlanningError(f"{name} {box.azimuth_min_deg:g} to {box.azimuth_max_deg:g}° is empty")


def _check_limits(gimbal: GimbalLimits) -> None:
    if not gimbal.pitch_min_deg <= gimbal.pitch_max_deg:
        raise PlanningError(f"gimbal pitch limits {gimbal.pitch_min_deg:g} to {gimbal.pitch_max_deg:g}° are reversed")
    if not gimbal.yaw_min_deg <= gimbal.yaw_max_deg:
        raise PlanningError(f"gimbal pan limits {gimbal.yaw_min_deg:g} to {gimbal.yaw_max_deg:g}° are reversed")
