"""Camera model: which directions an image shows, panorama size, ground resolution.

A camera may be known in two ways. The *nominal* lens is an ideal pinhole with the engraved focal length; the
*calibrated* one has the focal length, the distortion and the principal point that a calibration found. Planning and
certificate count the *frame*: a rectangle about the boresight that the image is proven to show (`panoexec.lens.frame`),
smaller by `fov_margin`, what is not known of the lens.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from panoexec.lens.distortion import Distortion, FloatArray
from panoexec.lens.frame import Frame, Sides, frame_of

Lens: TypeAlias = Literal["calibrated", "nominal"]


@dataclass(frozen=True, kw_only=True)  # without slots: the search asks for the frame very often, so it is kept
class Camera:
    """A camera as mounted: width along the image's right, height along its bottom; portrait has width < height.

    Attributes:
        name: name for users.
        sensor_width_mm: width of the sensor area in use, along the image's width.
        sensor_height_mm: likewise along its height.
        image_width_px: pixels of a full image.
        image_height_px: likewise.
        focal_length_mm: nominal focal length.
        calibrated_focal_length_mm: measured focal length, if known. Sizes in pixels (panorama, ground resolution) use
            it with either lens.
        distortion: of Brown and Conrady, if known.
        principal_point_px: where the boresight meets the image, from its upper left corner (right, down); None: in the
            middle.
        fov_margin: by which fraction the true border of the image may be nearer to the boresight, or farther from it,
            than the calibrated lens says, in the ideal image plane; [0, 0.5).
        lens: which lens counts; `calibrated` is the nominal one where nothing is known.
    """

    name: str
    sensor_width_mm: float
    sensor_height_mm: float
    image_width_px: int
    image_height_px: int
    focal_length_mm: float
    calibrated_focal_length_mm: float | None = None
    distortion: Distortion | None = None
    principal_point_px: tuple[float, float] | None = None
    fov_margin: float = 0.0
    lens: Lens = "calibrated"

    @property
    def is_calibrated(self) -> bool:
        """Whether a calibrated lens is known."""
        return (
            self.calibrated_focal_length_mm is not None
            or self.distortion is not None
            or self.principal_point_px is not None
            or self.fov_margin > 0
        )

    @property
    def lens_used(self) -> Lens:
        """The lens that counts: `calibrated` only where something of it is known."""
        return "calibrated" if self.lens == "calibrated" and self.is_calibrated else "nominal"

    def with_lens(self, lens: Lens) -> Camera:
        """The same camera with another lens counting."""
        return replace(self, lens=lens)

    @property
    def focal_length_used_mm(self) -> float:
        """The focal length of the lens that counts."""
        if self.lens == "calibrated" and self.calibrated_focal_length_mm is not None:
            return self.calibrated_focal_length_mm
        return self.focal_length_mm

    @property
    def pinhole_half_width(self) -> float:
        """Half the sensor's width in focal lengths: without distortion and margin, about its middle."""
        return self.sensor_width_mm / (2 * self.focal_length_used_mm)

    @property
    def pinhole_half_height(self) -> float:
        """Half the sensor's height in focal lengths, likewise."""
        return self.sensor_height_mm / (2 * self.focal_length_used_mm)

    @property
    def pinhole_hfov_deg(self) -> float:
        """Horizontal field of view of the sensor and the focal length alone, as stitchers mean it."""
        return math.degrees(2 * math.atan(self.pinhole_half_width))

    @property
    def pinhole_vfov_deg(self) -> float:
        """Vertical field of view, likewise."""
        return math.degrees(2 * math.atan(self.pinhole_half_height))

    @property
    def distortion_used(self) -> Distortion | None:
        """The distortion of the lens that counts; None without."""
        if self.lens != "calibrated" or self.distortion is None or self.distortion.is_none:
            return None
        return self.distortion

    @property
    def principal_point_used_px(self) -> tuple[float, float]:
        """Where the boresight of the lens that counts meets the image, from its upper left corner (right, down)."""
        if self.lens == "calibrated" and self.principal_point_px is not None:
            return self.principal_point_px
        return self.image_width_px / 2, self.image_height_px / 2

    @property
    def sides(self) -> Sides:
        """Where the image ends in the distorted plane, in focal lengths of the lens that counts."""
        across, down = self.principal_point_used_px
        left, top = 2 * across / self.image_width_px, 2 * down / self.image_height_px
        w, h = self.pinhole_half_width, self.pinhole_half_height
        return Sides(left=left * w, right=(2 - left) * w, top=top * h, bottom=(2 - top) * h)

    def places(self, across: FloatArray, down: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where in the image the lens that counts shows points of the ideal image plane at distance 1.

        Args:
            across: to the right; any shape, any floating type.
            down: likewise.

        Returns:
            Each in [-1, 1] within the image, from left to right and from top to bottom; of the same type.
        """
        lens, sides = self.distortion_used, self.sides
        if lens is not None:
            # beyond where a lens turns back nothing is seen
            near = across * across + down * down < lens.radius_for(sides.corner) ** 2
            distorted = lens.apply(np.stack([np.where(near, across, 0.0), np.where(near, down, 0.0)], axis=-1))
            far = np.where(near, 1.0, np.inf)
            across, down = (
                np.asarray(np.where(near, distorted[..., axis], far), dtype=across.dtype) for axis in range(2)
            )
        wide, high = (sides.left + sides.right) / 2, (sides.top + sides.bottom) / 2
        return (across - (sides.right - wide)) / wide, (down - (sides.bottom - high)) / high

    def rays(self, across: ArrayLike, down: ArrayLike) -> FloatArray:
        """Points (..., 2) of the ideal image plane that are shown at places of the image; inverse of `places`."""
        sides = self.sides
        wide, high = (sides.left + sides.right) / 2, (sides.top + sides.bottom) / 2
        y = np.asarray(across, dtype=np.float64) * wide + (sides.right - wide)
        z = np.asarray(down, dtype=np.float64) * high + (sides.bottom - high)
        distorted = np.stack(np.broadcast_arrays(y, z), axis=-1)
        lens = self.distortion_used
        return distorted if lens is None else lens.undo(distorted)

    @cached_property
    def _frame(self) -> Frame:
        if self.lens_used == "nominal":
            w, h = self.pinhole_half_width, self.pinhole_half_height
            return Frame(w, h, 4 * w * h)
        known = frame_of(self.sides, self.distortion_used or Distortion())
        less, more = 1 - self.fov_margin, 1 + self.fov_margin
        return Frame(known.half_width * less, known.half_height * less, known.image_area * more * more)

    @cached_property
    def half_width(self) -> float:
        """Half the frame's width: in the ideal image plane at distance 1 the frame spans ± this.

        Raises:
            ValueError: the distortion is not that of a lens (see `panoexec.lens.frame`); likewise the next ones.
        """
        return self._frame.half_width

    @cached_property
    def half_height(self) -> float:
        """Half the frame's height, likewise."""
        return self._frame.half_height

    @cached_property
    def image_area(self) -> float:
        """Upper bound of the whole image's area in the ideal image plane at distance 1: overlaps are shares of it."""
        return self._frame.image_area

    @cached_property
    def hfov_deg(self) -> float:
        """Horizontal field of view ψ_h of the frame, through its middle."""
        return math.degrees(2 * math.atan(self.half_width))

    @cached_property
    def vfov_deg(self) -> float:
        """Vertical field of view ψ_v of the frame, through its middle."""
        return math.degrees(2 * math.atan(self.half_height))

    @property
    def solid_angle_sr(self) -> float:
        """Solid angle of the frame (a rectangular pyramid), steradians."""
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
        """The same camera turned by 90° about its boresight: what was at the right of the image is at its bottom."""
        point = self.principal_point_px
        return replace(
            self,
            distortion=None if self.distortion is None else self.distortion.rotated(),
            principal_point_px=None if point is None else (self.image_height_px - point[1], point[0]),
            sensor_width_mm=self.sensor_height_mm,
            sensor_height_mm=self.sensor_width_mm,
            image_width_px=self.image_height_px,
            image_height_px=self.image_width_px,
        )

    @staticmethod
    def from_plain(data: Mapping[str, Any]) -> Camera:
        """A camera from the dictionary that `dataclasses.asdict` makes of it, also after JSON; other keys are ignored.

        Raises:
            TypeError: a key is missing.
        """
        known: dict[str, Any] = {field.name: data[field.name] for field in fields(Camera) if field.name in data}
        if known.get("distortion") is not None:
            known["distortion"] = Distortion(**known["distortion"])
        if known.get("principal_point_px") is not None:
            across, down = known["principal_point_px"]
            known["principal_point_px"] = (across, down)
        return Camera(**known)

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
