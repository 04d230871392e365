"""Whether the lens on the camera is the one that the panorama was planned for."""

from __future__ import annotations

from typing import Final

from panoexec.inputs.camera_profiles import list_profiles
from panoexec.optics import Camera

TOLERANCE: Final = 0.02
"""Relative difference of focal lengths up to which a lens is the planned one: makers round them."""


def lens_problem(told_mm: float, planned: Camera) -> str:
    """Why a focal length contradicts the plan, with the profile that would fit; "" if it does not.

    Args:
        told_mm: focal length as the camera tells it; NaN or 0 if it does not.
        planned: the camera of the plan.
    """
    if not told_mm > 0 or abs(told_mm - planned.focal_length_mm) <= TOLERANCE * planned.focal_length_mm:
        return ""
    return (
        f"the camera's lens has {told_mm:g} mm, the plan is for {planned.name} with {planned.focal_length_mm:g} mm: "
        f"{_advice(told_mm, planned)}"
    )


def _advice(told_mm: float, planned: Camera) -> str:
    """What to set: a shipped profile of a camera with this sensor and that lens, if there is one."""
    sensor = sorted((planned.sensor_width_mm, planned.sensor_height_mm))
    pixels = sorted((planned.image_width_px, planned.image_height_px))
    for profile in list_profiles():
        camera = profile.camera
        same_pixels = sorted((camera.image_width_px, camera.image_height_px)) == pixels
        if not same_pixels or sorted((camera.sensor_width_mm, camera.sensor_height_mm)) != sensor:
            continue
        if profile.zoom_range_mm and profile.zoom_range_mm[0] <= told_mm <= profile.zoom_range_mm[1]:
            return f'set [camera] profile = "{camera.name}" and focal_length_mm = {told_mm:g}, and plan again'
        if abs(camera.focal_length_mm - told_mm) <= TOLERANCE * told_mm:
            return f'set [camera] profile = "{camera.name}", and plan again'
    return f"write a profile with focal_length_mm = {told_mm:g} (examples/camera.toml), and plan again"
