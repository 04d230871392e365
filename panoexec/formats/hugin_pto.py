"""Hugin's project files (.pto): the data that panoexec needs, rendering and parsing.

Angles. Hugin's y, p, r of an image are the camera-to-world rotation in the 3-2-1 order, Rz(y) · Ry(p) · Rx(r), with
the same signs: yaw to the right, pitch up, roll positive when the right of the image goes down. Azimuth 0 is the middle
of the canvas. They are computed from the rotation matrix (`panoexec.angles.yaw_pitch_roll_321`), which is exact at the
nadir too. A test compares this with `nona`.

Hugin's tools ignore the EXIF orientation (6, 8 or 3: a camera mounted upright) and read pixels as stored. `turn_deg` is
the resulting difference in roll.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray, rotation_321, wrap_180, yaw_pitch_roll_321

LENS_VARIABLES: Final = ("a", "b", "c", "d", "e")
"""Radial distortion a, b, c and shift of the centre d, e of Hugin's lens model."""

_TOKEN: Final = re.compile(r'([A-Za-z]+)(?:"([^"]*)"|(=?)(-?[0-9][^\s]*))')


@dataclass(frozen=True, slots=True, kw_only=True)
class PtoImage:
    """One image: its file and Hugin's angles.

    Attributes:
        file_name: as in the file, relative to the project's folder.
        width_px: stored pixels across.
        height_px: stored pixels down.
        yaw_deg: Hugin's y.
        pitch_deg: Hugin's p.
        roll_deg: Hugin's r.
    """

    file_name: str
    width_px: int
    height_px: int
    yaw_deg: float
    pitch_deg: float
    roll_deg: float

    @property
    def rotation(self) -> FloatArray:
        """Camera-to-world rotation (3, 3) of the pixels as stored."""
        return rotation_321(self.yaw_deg, self.pitch_deg, self.roll_deg)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoint:
    """The same point in two images, in Hugin's pixel coordinates (0 at the first pixel's centre)."""

    first: int
    second: int
    x1: float
    y1: float
    x2: float
    y2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PtoProject:
    """A project of images that share one rectilinear lens, on an equirectangular canvas of the whole sphere.

    Attributes:
        images: in order; control points count them from 0.
        hfov_deg: field of view of the lens across the images' stored width.
        canvas_px: width and height of the canvas; twice as wide as high.
        crop_px: (left, right, top, bottom) of the part of it that is output; None for all.
        lens: values of `LENS_VARIABLES` that are not 0.
        control_points: any number.
        optimise: variables that the optimiser may change, by image number ("y", "p", "r"), and lens variables at 0.
    """

    images: tuple[PtoImage, ...]
    hfov_deg: float
    canvas_px: tuple[int, int]
    crop_px: tuple[int, int, int, int] | None = None
    lens: Mapping[str, float] = field(default_factory=dict)
    control_points: tuple[ControlPoint, ...] = ()
    optimise: tuple[tuple[str, int], ...] = ()

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels of the stored images."""
        return self.images[0].width_px / (2 * math.tan(math.radians(self.hfov_deg) / 2))

    def rotations(self) -> FloatArray:
        """Camera-to-world rotations (n, 3, 3) of the pixels as stored."""
        return rotation_321(
            [i.yaw_deg for i in self.images], [i.pitch_deg for i in self.images], [i.roll_deg for i in self.images]
        )

    def with_rotations(self, rotations: ArrayLike) -> PtoProject:
        """The project with other attitudes (n, 3, 3)."""
        yaw, pitch, roll = yaw_pitch_roll_321(rotations)
        images = tuple(
            replace(image, yaw_deg=float(y), pitch_deg=float(p), roll_deg=float(r))
            for image, y, p, r in zip(self.images, yaw, pitch, roll, strict=True)
        )
        return replace(self, images=images)

    def rays(self, image: ArrayLike, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """World directions (n, 3) of pixels of images, without lens distortion.

        Args:
            image: image numbers (n,).
            x: pixel coordinates (n,), 0 at the first pixel's centre.
            y: likewise.
        """
        number = np.asarray(image, dtype=np.intp)
        width, height = self.images[0].width_px, self.images[0].height_px
        camera = np.stack(
            [
                np.full(number.shape, self.focal_length_px),
                np.asarray(x, dtype=np.float64) + 0.5 - width / 2,
                np.asarray(y, dtype=np.float64) + 0.5 - height / 2,
            ],
            axis=-1,
        )
        camera /= np.linalg.norm(camera, axis=-1, keepdims=True)
        return np.asarray(np.einsum("nij,nj->ni", self.rotations()[number], camera))


def pto_image(file_name: str, width_px: int, height_px: int, rotation: ArrayLike, *, turn_deg: float = 0.0) -> PtoImage:
    """An image with the attitude given.

    Args:
        file_name: relative to the project's folder.
        width_px: of the stored pixels.
        height_px: likewise.
        rotation: camera-to-world rotation (3, 3) of the upright image.
        turn_deg: by how much the stored pixels' roll differs (`turn_of_orientation`).
    """
    yaw, pitch, roll = (float(angle) for angle in yaw_pitch_roll_321(rotation))
    return PtoImage(
        file_name=file_name,
        width_px=width_px,
        height_px=height_px,
        yaw_deg=yaw,
        pitch_deg=pitch,
        roll_deg=float(wrap_180(roll + turn_deg)),
    )


def turn_of_orientation(exif_orientation: int) -> float:
    """Roll of the stored pixels by EXIF orientation, degrees; 0 for upright and mirrored ones."""
    return {3: 180.0, 6: 90.0, 8: -90.0}.get(exif_orientation, 0.0)


def render_pto(project: PtoProject) -> str:
    """The project as text, which Hugin's tools read without warnings.

    Raises:
        ValueError: no images, or a file name that the format does not allow.
    """
    if not project.images:
        raise ValueError("a project needs at least one image")
    width, height = project.canvas_px
    crop = f" S{','.join(str(v) for v in project.crop_px)}" if project.crop_px else ""
    lines = [
        "# hugin project file",
        "#hugin_ptoversion 2",
        f'p f2 w{width} h{height} v360  k0 E0 R0{crop} n"TIFF_m c:LZW r:CROP"',
        "m i0",
        "",
        "# image lines",
    ]
    for number, image in enumerate(project.images):
        lines.append("#-hugin  cropFactor=1" if number == 0 else "#-hugin  cropFactor=1 autoCenterCrop=1")
        lines.append(_image_line(project, number, image))
    lines += ["", "# specify variables that should be optimized", *_optimise_lines(project.optimise), "v", ""]
    lines += ["# control points"]
    lines += [
        f"c n{c.first} N{c.second} x{_number(c.x1)} y{_number(c.y1)} X{_number(c.x2)} Y{_number(c.y2)} t0"
        for c in project.control_points
    ]
    return "\n".join(lines) + "\n"


def _image_line(project: PtoProject, number: int, image: PtoImage) -> str:
    if re.search(r'["\n\r]', image.file_name):
        raise ValueError(f"file name {image.file_name!r} cannot be written into a Hugin project")
    linked = ["v", "Ra", "Rb", "Rc", "Rd", "Re", *LENS_VARIABLES, "g", "t", "Va", "Vb", "Vc", "Vd", "Vx", "Vy"]
    if number == 0:
        values = {"v": project.hfov_deg, "Va": 1.0, **project.lens}
        lens = " ".join(f"{name}{_number(values.get(name, 0.0))}" for name in linked)
    else:
        lens = " ".join(f"{name}=0" for name in linked)
    angles = f"r{_number(image.roll_deg)} p{_number(image.pitch_deg)} y{_number(image.yaw_deg)}"
    return (
        f"i w{image.width_px} h{image.height_px} f0 {lens} Eev0 Er1 Eb1 {angles} "
        f'TrX0 TrY0 TrZ0 Tpy0 Tpp0 j0 Vm5 n"{image.file_name}"'
    )


def _optimise_lines(variables: Iterable[tuple[str, int]]) -> list[str]:
    by_image: dict[int, list[str]] = {}
    for name, image in variables:
        by_image.setdefault(image, []).append(f"{name}{image}")
    return ["v " + " ".join(names) for _, names in sorted(by_image.items())]


def _number(value: float) -> str:
    """Nine decimals (a millionth of a pixel anywhere), no exponent, no -0."""
    return f"{round(value, 9) + 0.0:.9f}".rstrip("0").rstrip(".")


def parse_pto(text: str) -> PtoProject:
    """Parse a project with one lens and an equirectangular canvas, written by `render_pto` or Hugin's tools.

    Raises:
        ValueError: it is not such a project.
    """
    lines = [line.rstrip() for line in text.splitlines()]
    panorama = next((_fields(line) for line in lines if line.startswith("p ")), None)
    images = [_fields(line) for line in lines if re.match(r"[io]\s", line)]
    if panorama is None or not images:
        raise ValueError("is not a Hugin project with images")
    if panorama.get("f") != "2":
        raise ValueError("is not a Hugin project with an equirectangular canvas")
    try:
        crop = tuple(int(v) for v in panorama["S"].split(",")) if "S" in panorama else None
        return PtoProject(
            images=tuple(_parse_image(fields) for fields in images),
            hfov_deg=float(images[0]["v"]),
            canvas_px=(int(panorama["w"]), int(panorama["h"])),
            crop_px=crop if crop is None else (crop[0], crop[1], crop[2], crop[3]),
            lens={name: float(images[0].get(name, 0)) for name in LENS_VARIABLES if float(images[0].get(name, 0))},
            control_points=tuple(
                _parse_point(_fields(line)) for line in lines if line.startswith("c ") and line.endswith(" t0")
            ),
            optimise=tuple(
                (name, int(image))
                for line in lines
                if line.startswith("v ")
                for name, image in re.findall(r"([A-Za-z]+)(\d+)", line[2:])
            ),
        )
    except (KeyError, ValueError, IndexError) as error:
        raise ValueError(f"is a Hugin project with an invalid line ({error})") from error


def _fields(line: str) -> dict[str, str]:
    return {m[1]: m[2] if m[2] is not None else m[3] + m[4] for m in _TOKEN.finditer(line[1:])}


def _parse_image(fields: Mapping[str, str]) -> PtoImage:
    return PtoImage(
        file_name=fields["n"],
        width_px=int(fields["w"]),
        height_px=int(fields["h"]),
        yaw_deg=float(fields["y"]),
        pitch_deg=float(fields["p"]),
        roll_deg=float(fields["r"]),
    )


def _parse_point(fields: Mapping[str, str]) -> ControlPoint:
    return ControlPoint(
        first=int(fields["n"]),
        second=int(fields["N"]),
        x1=float(fields["x"]),
        y1=float(fields["y"]),
        x2=float(fields["X"]),
        y2=float(fields["Y"]),
    )


def point_arrays(
    points: Sequence[ControlPoint],
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], FloatArray]:
    """Control points as arrays: image numbers (n, 2) and pixels (n, 4) as x1, y1, x2, y2."""
    numbers = np.array([(c.first, c.second) for c in points], dtype=np.intp).reshape(-1, 2)
    return numbers, np.array([(c.x1, c.y1, c.x2, c.y2) for c in points], dtype=np.float64).reshape(-1, 4)
