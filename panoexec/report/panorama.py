"""The panorama in a report: the stitched one, else a quick look.

The quick look projects each accepted photo by its measured attitude and blends it by feathering, without control
points: seams and holes are visible, and Hugin is not required.
"""

from __future__ import annotations

import io
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from panoexec.angles import FloatArray, rotation_from_quaternion
from panoexec.exports.from_manifest import camera_of, export_set
from panoexec.optics import Camera
from panoexec.report.source import Source

QUICK_WIDTH_PX: Final = 2048
STITCHED_WIDTH_PX: Final = 4096
_WARM_UP_PHOTOS: Final = 2
"""Number of photos before the duration of a quick look is estimated; the first ones are slower."""
_EMPTY: Final = (30, 33, 39)


@dataclass(frozen=True, slots=True, kw_only=True)
class Panorama:
    """An equirectangular JPEG of the whole sphere, with the plan's yaw 0 at its centre.

    Attributes:
        jpeg: the file's content.
        kind: `stitched` or `quick` (quick look).
        left_out: photos of a quick look that could not be read.
    """

    jpeg: bytes
    kind: Literal["stitched", "quick"]
    left_out: tuple[str, ...] = ()


def best_picture(source: Source, *, max_cpu_s: float = math.inf) -> tuple[Panorama | None, str]:
    """The best available panorama, or None and the reason.

    Args:
        source: the mission.
        max_cpu_s: CPU time limit of a quick look; one that is expected to take longer is aborted.
    """
    stitched = _stitched(source)
    if stitched is not None:
        return stitched, ""
    return _quick_look(source, max_cpu_s)


def _stitched_path(source: Source) -> Path | None:
    if source.stitch is None:
        return None
    # only the base name: stitch.json must not refer to another directory
    path = source.folder / "stitch" / Path(str(source.stitch.get("preview", "panorama.jpg"))).name
    return path if path.is_file() else None


def _stitched(source: Source) -> Panorama | None:
    import PIL.Image  # noqa: PLC0415  (for missions that have photos)

    path = _stitched_path(source)
    if path is None:
        return None
    try:
        with PIL.Image.open(path) as picture:
            picture.draft("RGB", (STITCHED_WIDTH_PX, STITCHED_WIDTH_PX // 2))
            small = picture.convert("RGB")
    except (OSError, SyntaxError, ValueError):
        return None
    if small.width > STITCHED_WIDTH_PX:
        small = small.resize((STITCHED_WIDTH_PX, STITCHED_WIDTH_PX // 2))
    return Panorama(jpeg=_encoded(small), kind="stitched")


def _quick_look(source: Source, max_cpu_s: float) -> tuple[Panorama | None, str]:
    shots = [shot for shot in _poses(source) if not source.photos[shot[0]].problem]
    if not shots:
        return None, "there are no usable photos"
    canvas = _Canvas(camera_of(source.manifest), QUICK_WIDTH_PX)
    turns = {shot.index: shot.orientation for shot in export_set(source.manifest, source.folder).shots}
    left_out: list[str] = []
    # CPU time of this thread only, so that other load does not matter
    started = time.thread_time()
    for done, (index, pose) in enumerate(shots):
        name = source.photos[index].name
        try:
            canvas.add(source.folder / name, pose, turns.get(index, 1))
        except (OSError, SyntaxError, ValueError):
            left_out.append(name)
        expected_s = (time.thread_time() - started) / (done + 1) * len(shots)
        if expected_s > max_cpu_s and _WARM_UP_PHOTOS <= done < len(shots) / 2:
            return None, "the photos are too large for a quick look now: run `panoexec report` or `panoexec stitch`"
    if len(left_out) == len(shots):
        return None, "no photo could be read"
    return Panorama(jpeg=canvas.jpeg(), kind="quick", left_out=tuple(left_out)), ""


def _poses(source: Source) -> list[tuple[int, FloatArray]]:
    """Index and attitude (3, 3) of each accepted shot: measured, else planned."""
    found = []
    for shot in source.manifest["shots"]:
        attempt = next((a for a in shot["attempts"] if a["number"] == shot.get("accepted_attempt")), None)
        if attempt is not None:
            pose = attempt.get("measured") or shot["target"]
            found.append((int(shot["index"]), rotation_from_quaternion(pose["quaternion"])))
    return found


class _Canvas:
    """Blends photos on an equirectangular canvas; a pixel's weight falls towards the photo's border."""

    def __init__(self, camera: Camera, width_px: int) -> None:
        self._camera = camera
        # where it looks at most: barrel distortion shows more than the sensor and the focal length alone tell
        self._half_width = 1.2 * camera.pinhole_half_width
        self._half_height = 1.2 * camera.pinhole_half_height
        self._width, self._height = width_px, width_px // 2
        self._sum = np.zeros((self._height, self._width, 3), dtype=np.float32)
        self._weight = np.zeros((self._height, self._width), dtype=np.float32)
        self._elevation = np.radians(90 - (np.arange(self._height) + 0.5) / self._height * 180).astype(np.float32)
        self._azimuth = np.radians((np.arange(self._width) + 0.5) / self._width * 360 - 180).astype(np.float32)

    def add(self, path: Path, pose: FloatArray, orientation: int) -> None:
        """Add a photo whose pixels are turned as EXIF's `orientation` says.

        Raises:
            OSError, SyntaxError, ValueError: it cannot be read.
        """
        picture = self._read(path, orientation)
        rows, columns = self._window(pose)
        elevation, azimuth = self._elevation[rows][:, None], self._azimuth[columns][None, :]
        r = pose.astype(np.float32)
        flat, down = np.cos(elevation), -np.sin(elevation)
        north, east = np.cos(azimuth), np.sin(azimuth)
        x, y, z = (flat * (r[0, k] * north + r[1, k] * east) + r[2, k] * down for k in range(3))
        ahead = np.maximum(x, np.float32(1e-6))
        across, along = self._camera.places(y / ahead, z / ahead)
        inside = np.flatnonzero((x > 0) & (np.abs(across) < 1) & (np.abs(along) < 1))
        across, along = across.ravel()[inside], along.ravel()[inside]
        height, width = picture.shape[:2]
        # positions just inside the border may round to the border
        row = np.minimum(((along + 1) / 2 * height).astype(np.intp), height - 1)
        column = np.minimum(((across + 1) / 2 * width).astype(np.intp), width - 1)
        pixels = picture[row, column]
        weight = ((1 - np.abs(across)) * (1 - np.abs(along)) + np.float32(1e-4)) ** 2
        target = (rows[inside // len(columns)], columns[inside % len(columns)])
        self._sum[target] += pixels * weight[:, None]
        self._weight[target] += weight

    def jpeg(self) -> bytes:
        """The canvas as JPEG."""
        import PIL.Image  # noqa: PLC0415  (for missions that have photos)

        out = (self._sum / np.maximum(self._weight, np.float32(1e-12))[..., None] + np.float32(0.5)).astype(np.uint8)
        out[self._weight == 0] = _EMPTY
        return _encoded(PIL.Image.fromarray(out))

    def _read(self, path: Path, orientation: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """A photo, upright, at about the resolution of the canvas."""
        import PIL.Image  # noqa: PLC0415  (for missions that have photos)

        wanted = max(32, round(self._width / math.pi * max(self._half_width, self._half_height)))
        with PIL.Image.open(path) as picture:
            picture.draft("RGB", (wanted, wanted))
            turn = {3: PIL.Image.Transpose.ROTATE_180, 6: PIL.Image.Transpose.ROTATE_270}
            turn[8] = PIL.Image.Transpose.ROTATE_90
            upright = picture.transpose(turn[orientation]) if orientation in turn else picture
            return np.asarray(upright.convert("RGB"))

    def _window(self, pose: FloatArray) -> tuple[np.ndarray[Any, np.dtype[np.intp]], np.ndarray[Any, Any]]:
        """Rows and columns of the canvas that the photo may cover."""
        reach = math.atan(math.hypot(self._half_width, self._half_height))
        level = math.asin(max(-1.0, min(1.0, -float(pose[2, 0]))))
        rows = np.flatnonzero(np.abs(self._elevation - level) <= reach)
        if abs(level) + reach >= math.pi / 2 - 0.01:
            return rows, np.arange(self._width)
        spread = math.asin(min(1.0, math.sin(reach) / math.cos(level)))
        middle = math.atan2(float(pose[1, 0]), float(pose[0, 0]))
        away = np.abs((self._azimuth - middle + math.pi) % (2 * math.pi) - math.pi)
        return rows, np.flatnonzero(away <= spread)


def _encoded(picture: Any) -> bytes:
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=84)
    return out.getvalue()
