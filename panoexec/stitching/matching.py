"""Control points between overlapping images, found by Hugin's `cpfind`."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import PIL.Image

from panoexec.files import write_atomically
from panoexec.formats.hugin_pto import ControlPoint, PtoProject, parse_pto, point_arrays, render_pto
from panoexec.planning.model import Tolerance
from panoexec.stitching.adjustment import Lens, Points, separation_deg
from panoexec.stitching.tools import StitchError, ToolError, disk_error, run_tool

MATCH_WIDTH_PX: Final = 2000
"""Longer side of the images in which points are searched: enough for hundreds of points, in a tenth of the time."""

_ANALYSED: Final = re.compile(r"i\d+ : Analyzing image")
_MATCHED: Final = re.compile(r"i(\d+) <> i(\d+) : Found (\d+) matches")


def find_points(project: PtoProject, folder: Path, work: Path, progress: Callable[[float, str], None]) -> PtoProject:
    """The project with the control points that `cpfind` finds, in pixels of the stored images.

    Args:
        project: images with measured attitudes, file names relative to `folder`.
        folder: the mission directory.
        work: folder for intermediate files.
        progress: called with a fraction and a text.

    Raises:
        StitchError: a photo cannot be read.
        ToolError: `cpfind` failed, or the disk is full.
    """
    small, factor = _search_copies(project, folder, work, progress)
    source, found = work / "match.pto", work / "match_found.pto"
    write_atomically(source, render_pto(small), sync=False)
    count = len(project.images)
    done = {"analysed": 0, "matched": 0}

    def on_line(line: str) -> None:
        if _ANALYSED.match(line):
            done["analysed"] += 1
            progress(0.1 + 0.6 * done["analysed"] / count, f"points in image {done['analysed']} of {count}")
        elif match := _MATCHED.match(line):
            done["matched"] += 1
            # about five neighbours per image
            progress(min(0.99, 0.7 + 0.06 * done["matched"] / count), f"pair {match[1]}-{match[2]}")

    run_tool(
        ["cpfind", "--prealigned", "--fullscale", "--sieve2size=3", "--ransacdist=10", "-o", found.name, source.name],
        work,
        on_line,
    )
    try:
        matched = parse_pto(found.read_text(encoding="utf-8"))
    except OSError as error:
        raise ToolError("cpfind ended without a result") from error
    except ValueError as error:
        raise ToolError(f"cpfind's result {error}") from error
    points = tuple(_scaled(point, factor) for point in matched.control_points)
    return replace(project, control_points=points)


def _scaled(point: ControlPoint, scale: int) -> ControlPoint:
    """The point in an image `scale` times as large; pixel centres are at whole numbers."""
    x1, y1, x2, y2 = ((v + 0.5) * scale - 0.5 for v in (point.x1, point.y1, point.x2, point.y2))
    return replace(point, x1=x1, y1=y1, x2=x2, y2=y2)


def _search_copies(
    project: PtoProject, folder: Path, work: Path, progress: Callable[[float, str], None]
) -> tuple[PtoProject, int]:
    """The project with copies of its images reduced by an integer factor, and the factor; unchanged if that is 1."""
    first = project.images[0]
    longer = max(first.width_px, first.height_px)
    if longer <= MATCH_WIDTH_PX:
        named = tuple(replace(image, file_name=str(folder / image.file_name)) for image in project.images)
        return replace(project, images=named), 1
    factor = -(-longer // MATCH_WIDTH_PX)
    size = (first.width_px // factor, first.height_px // factor)
    copies = work / "match"
    copies.mkdir(exist_ok=True)
    images = []
    for number, image in enumerate(project.images):
        path = copies / f"{number:05d}.jpg"
        if not path.exists():
            _copy(folder / image.file_name, path, size, factor)
        progress(0.1 * (number + 1) / len(project.images), f"smaller copy {number + 1} of {len(project.images)}")
        images.append(replace(image, file_name=f"match/{path.name}", width_px=size[0], height_px=size[1]))
    return replace(project, images=tuple(images)), factor


def _copy(source: Path, target: Path, size: tuple[int, int], factor: int) -> None:
    try:
        with PIL.Image.open(source) as picture:
            stored = picture.size
            # the decoder can reduce JPEGs itself, which is much faster
            picture.draft("RGB", (2 * size[0], 2 * size[1]))
            right, bottom = (factor * size[k] * picture.size[k] / stored[k] for k in (0, 1))
            small = picture.convert("RGB").resize(size, PIL.Image.Resampling.BOX, box=(0.0, 0.0, right, bottom))
    except (OSError, SyntaxError, ValueError) as error:
        raise StitchError(f"{source}: cannot be read as a photo ({error})") from error
    temporary = target.with_suffix(".part")
    try:
        small.save(temporary, "JPEG", quality=92)
        temporary.replace(target)
    except OSError as error:
        raise disk_error(target.parent, error) from error


def believable(project: PtoProject, tolerance: Tolerance, lens: Lens) -> Points:
    """Control points that deviate from the measured attitudes by less than 1° plus six times the tolerance.

    Args:
        project: images with measured attitudes, and all points found.
        tolerance: error bound of the attitudes.
        lens: the nominal lens.
    """
    numbers, pixels = point_arrays(project.control_points)
    points = Points(images=numbers, pixels=pixels)
    if not len(points):
        return points
    limit = 1.0 + 6.0 * max(tolerance.pitch_deg, tolerance.roll_deg, tolerance.yaw_deg)
    return points.only(separation_deg(points, project.rotations(), lens) <= min(limit, 10.0))


def as_control_points(points: Points) -> tuple[ControlPoint, ...]:
    """Points for a project file."""
    return tuple(
        ControlPoint(first=int(a), second=int(b), x1=float(p[0]), y1=float(p[1]), x2=float(p[2]), y2=float(p[3]))
        for (a, b), p in zip(points.images, points.pixels, strict=True)
    )
