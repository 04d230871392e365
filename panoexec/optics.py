"""Pinhole camera model: field of view from sensor and focal length, panorama size, ground resolution."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """An ideal pinhole camera; the planner ignores distortion, which the stitcher corrects.

    Width runs along the image's right, height along its bottom, as mounted: a portrait camera has width < height.

    Attributes:
        name: name for users.
        sensor_width_mm: width of the sensor area in use, along the image's width.
        sensor_height_mm: likewise along its height.
        image_width_px: pixels of a full image.
        image_height_px: likewise.
        focal_length_mm: nominal focal length, from which the field of view follows.
        calibrated_focal_length_mm: measured focal length if known; only sizes in pixels (panorama, ground resolution)
            use it.
    """

    name: str
    sensor_width_mm: float
    sensor_height_mm: float
    image_width_px: int
    image_height_px: int
    focal_length_mm: float
    calibrated_focal_length_mm: float | None = None

    @property
    def half_width(self) -> float:
        """Tangent of half the horizontal field of view: the image plane at distance 1 spans ± this."""
        return self.sensor_width_mm / (2 * self.focal_length_mm)

    @property
    def half_height(self) -> float:
        """Tangent of half the vertical field of view."""
        return self.sensor_height_mm / (2 * self.focal_length_mm)

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view ψ_h, through the middle of the image."""
        return math.degrees(2 * math.atan(self.half_width))

    @property
    def vfov_deg(self) -> float:
        """Vertical field of view ψ_v, through the middle of the image."""
        return math.degrees(2 * math.atan(self.half_height))

    @property
    def solid_angle_sr(self) -> float:
        """Solid angle of one image (a rectangular pyramid), steradians."""
        a, b = self.half_width, self.half_height
        return 4 * math.asin(a * b / math.sqrt((1 + a * a) * (1 + b * b)))

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels of the image, calibrated if known; the same for portrait and landscape."""
        focal_mm = self.calibrated_focal_length_mm or self.focal_length_mm
        # pixels are square, stated sensor sizes are rounded: the longer side has the smaller relative error
        return (
            focal_mm * max(self.image_width_px, self.image_height_px) / max(self.sensor_width_mm, self.sensor_height_mm)
        )

    @property
    def equivalent_focal_length_mm(self) -> float:
        """35 mm equivalent by the diagonal (43.27 mm)."""
        return self.focal_length_mm * math.hypot(36, 24) / math.hypot(self.sensor_width_mm, self.sensor_height_mm)

    @property
    def is_portrait(self) -> bool:
        """Whether the image is higher than wide."""
        return self.sensor_height_mm > self.sensor_width_mm

    def rotated(self) -> Camera:
        """The same camera turned by 90° about its boresight: portrait for landscape and back."""
        return replace(
            self,
            sensor_width_mm=self.sensor_height_mm,
            sensor_height_mm=self.sensor_width_mm,
            image_width_px=self.image_height_px,
            image_height_px=self.image_width_px,
        )

    def panorama_px(self) -> tuple[int, int]:
        """Width and height of the whole equirectangular sphere at full resolution: 2π times the focal length.

        The paper's Table 3 widths come out within 0.5 % with calibrated focal lengths.
        """
        width = round(2 * math.pi * self.focal_length_px)
        return width, round(width / 2)

    def ground_resolution_cm(self, distance_m: float) -> float:
        """Centimetres per pixel at the image's centre, on a surface that faces the camera `distance_m` away."""
        return 100 * distance_m / self.focal_length_px

    @staticmethod
    def from_fov(hfov_deg: float, vfov_deg: float, *, name: str = "", image_width_px: int = 4000) -> Camera:
        """A camera of 36 mm sensor width with the given fields of view, each in (0, 180): for tests and comparisons."""
        focal = 18.0 / math.tan(math.radians(hfov_deg) / 2)
        height = 2 * focal * math.tan(math.radians(vfov_deg) / 2)
        return Camera(
            name=name or f"{hfov_deg:g}x{vfov_deg:g}",
            sensor_width_mm=36.0,
            sensor_height_mm=height,
            image_width_px=image_width_px,
            image_height_px=max(1, round(image_width_px * height / 36.0)),
            focal_length_mm=focal,
        )
