"""The steps of the stitcher; the result of each is stored, so that an interrupted run can be resumed.

1. *match*: every photo is examined (`panoexec.stitching.examination`); control points are what ties it to the others,
   or `cpfind`'s. Photos that do not count are left out from here on.
2. *align*: one adjustment of all images (`panoexec.stitching.adjustment`).
3. *render*: `nona` and blending, block by block.
4. *finish*: TIFF, preview, completeness.

A step is complete when its result is on disk and `state.json` has the fingerprint of its input: photos, measured
angles, options, and the results of the previous steps.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import PIL.Image

from panoexec.errors import UsageError
from panoexec.files import write_atomically, write_atomically_with
from panoexec.formats.hugin_pto import PtoProject, parse_pto, render_pto
from panoexec.formats.xmp import gpano_properties, packet, with_xmp
from panoexec.stitching.adjustment import Adjustment, Lens, Points, adjust, spread_points, tied_group
from panoexec.stitching.completeness import Ground
from panoexec.stitching.examination import (
    Examination,
    examination_from_json,
    examination_path,
    examine_photos,
    without,
)
from panoexec.stitching.matching import as_control_points, believable, find_points
from panoexec.stitching.mission import StitchInput
from panoexec.stitching.place import exif_of
from panoexec.stitching.rendering import PanoramaRenderer, Rendered
from panoexec.stitching.result import StitchResult, result_from_json
from panoexec.stitching.tools import StitchError, ToolError, check_tools, disk_error

STEPS: Final = ("match", "align", "render", "finish")
_POINTS_A_PAIR: Final = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class StitchOptions:
    """Options of the stitcher.

    Attributes:
        width_px: width of the whole sphere; None for the photos' resolution.
        horizon_deg: elevation up to which the ground reaches, for completeness.
        refine_lens: whether focal length and distortion are adjusted.
        memory_bytes: memory limit for blending.
        restart: whether to discard the results of earlier runs.
        matcher: what finds control points: the ties of the examination, or Hugin's `cpfind`.
    """

    width_px: int | None = None
    horizon_deg: float = 0.0
    refine_lens: bool = True
    memory_bytes: int = 1 << 30
    restart: bool = False
    matcher: Literal["own", "cpfind"] = "own"


class ContentRefusedError(StitchError):
    """Most photos contradict what they should show.

    Attributes:
        examined: what the examination found.
    """

    def __init__(self, text: str, examined: Examination) -> None:
        super().__init__(text)
        self.examined = examined


Progress = Callable[[str, float, str], None]
"""Called with a step's name, the fraction of it that is done, and a text."""


class Stitcher:
    """Stitches one mission.

    Args:
        mission: the input.
        options: the options.
        progress: called at every step.
    """

    def __init__(self, mission: StitchInput, options: StitchOptions, progress: Progress) -> None:
        self._mission = mission
        self._options = options
        self._progress = progress
        self._work = mission.folder / "stitch"
        self._state: dict[str, dict[str, Any]] = {}
        self._examined = Examination()

    def run(self) -> StitchResult:
        """Run the steps that are not complete.

        Raises:
            ToolError: a tool is missing or failed, or the disk is full; completed steps are kept.
            StitchError: a photo cannot be read.
        """
        check_tools(cpfind=self._options.matcher == "cpfind")
        try:
            if self._options.restart:
                shutil.rmtree(self._work, ignore_errors=True)
            self._work.mkdir(exist_ok=True)
        except OSError as error:
            raise disk_error(self._work, error) from error
        try:
            return self._run()
        except UsageError as error:
            # an own file could not be written: an error of the disk, not of the user
            cause = error.__cause__
            raise (disk_error(self._work, cause) if isinstance(cause, OSError) else ToolError(str(error))) from error

    def _run(self) -> StitchResult:
        self._state = self._read_state()
        measured = self._mission.project
        key = self._fingerprint(measured)
        key = _digest(key, self._options.matcher)
        matched = self._step("match", key, self._work / "matched.pto", lambda: self._match(measured))
        self._examined = self._read_examination()
        self._refuse_if_hardly_any_counts(measured)
        measured = without(measured, self._bad_names)
        key = _digest(
            key, matched.read_text(encoding="utf-8"), str(self._options.refine_lens), repr(self._mission.tolerance)
        )
        aligned = self._step("align", key, self._work / "aligned.pto", lambda: self._align(measured, matched))
        project = self._on_canvas(_from_work(parse_pto(aligned.read_text(encoding="utf-8"))))
        renderer = self._renderer(project)
        ground = repr((self._options.horizon_deg, self._mission.band, self._mission.masks, self._examined.gains))
        key = _digest(key, render_pto(project), ground, str(self._options.memory_bytes))
        blocks = self._work / "blocks"
        if self._state.get("render", {}).get("key") != key:
            # blocks of another alignment are invalid
            shutil.rmtree(blocks, ignore_errors=True)
            self._panorama.with_name(self._panorama.name + ".part").unlink(missing_ok=True)
            self._state["render"] = {"key": key, "seconds": 0.0, "done": False}
            self._write_state()
        result = self._work / "stitch.json"
        self._step("render", key, blocks, lambda: renderer.render(self._told("render")))
        self._step("finish", key, result, lambda: self._finish(renderer, project))
        return self._result(json.loads(result.read_text(encoding="utf-8")))

    def _step(self, name: str, key: str, product: Path, work: Callable[[], None]) -> Path:
        """Run a step unless it was completed with the same inputs and its product exists."""
        known = self._state.get(name, {})
        same = known.get("key") == key
        if same and known.get("done") and (product.exists() or self._state.get("finish", {}).get("key") == key):
            self._progress(name, 1.0, "done before")
            return product
        spent = float(known.get("seconds", 0.0)) if same else 0.0
        started = time.monotonic()
        self._progress(name, 0.0, "")
        try:
            work()
        except BaseException:
            self._state[name] = {"key": key, "seconds": round(spent + time.monotonic() - started, 2), "done": False}
            # on a full disk this fails, too; the first error is reported
            with suppress(UsageError):
                self._write_state()
            raise
        spent += time.monotonic() - started
        self._state[name] = {"key": key, "seconds": round(spent, 2), "done": True}
        self._write_state()
        self._progress(name, 1.0, f"{spent:.1f} s")
        return product

    # --- the steps

    def _match(self, measured: PtoProject) -> None:
        """Examine the photos, find control points; write both."""
        own = self._options.matcher == "own"
        told = self._told("match")
        share = 1.0 if own else 0.3
        examined = examine_photos(self._mission, lambda fraction, text: told(share * fraction, text))
        write_atomically(examination_path(self._work), json.dumps(examined.to_json(), indent=1) + "\n")
        if own:
            found = replace(measured, control_points=examined.points)
        else:
            found = find_points(
                measured, self._mission.folder, self._work, lambda fraction, text: told(0.3 + 0.7 * fraction, text)
            )
        write_atomically(self._work / "matched.pto", render_pto(_in_work(found)))

    def _read_examination(self) -> Examination:
        path = examination_path(self._work)
        try:
            return examination_from_json(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ToolError(f"{path}: cannot be read ({error}); stitch with --restart") from error

    @property
    def _bad_names(self) -> frozenset[str]:
        return frozenset(photo.file for photo in self._examined.bad)

    def _refuse_if_hardly_any_counts(self, measured: PtoProject) -> None:
        """Refuse a mission of which most photos are bad: their files belong to other shots, or to another mission."""
        names = [image.file_name for image in measured.images]
        bad = [name for name in names if name in self._bad_names]
        if 2 * len(bad) > len(names):
            raise ContentRefusedError(
                f"{self._mission.folder}: {len(bad)} of {len(names)} photos do not show what their shots should; "
                "the files may belong to other shots or to another mission",
                self._examined,
            )

    def _align(self, measured: PtoProject, matched: Path) -> None:
        """Adjust; write `aligned.pto`, which Hugin can open, and the figures of the alignment."""
        found = without(_from_work(parse_pto(matched.read_text(encoding="utf-8"))), self._bad_names)
        lens = _lens(measured)
        points = believable(replace(measured, control_points=found.control_points), self._mission.tolerance, lens)
        points = spread_points(points, _POINTS_A_PAIR)
        self._progress("align", 0.3, f"{len(points)} points")
        result = adjust(points, measured.rotations(), lens, refine_lens=self._options.refine_lens)
        kept = points.only(result.kept)
        tied = tied_group(kept, len(measured.images))
        aligned = _aligned(measured, result, kept)
        untied = [image.file_name for number, image in enumerate(measured.images) if number not in tied]
        correction = _largest_turn_deg(measured, result)
        facts = {
            "untied": untied,
            "points": len(kept),
            "rms_px": round(result.rms_px, 3) if len(kept) else None,
            "hfov_deg": round(aligned.hfov_deg, 4),
            "correction_deg": round(correction, 4),
        }
        write_atomically(self._work / "alignment.json", json.dumps(facts, indent=1) + "\n")
        write_atomically(self._work / "aligned.pto", render_pto(_in_work(aligned)))

    def _on_canvas(self, project: PtoProject) -> PtoProject:
        """The project on the requested canvas; matching and aligning do not depend on it."""
        width = self._options.width_px
        return project if width is None else replace(project, canvas_px=(2 * (width // 2), width // 2))

    def _renderer(self, project: PtoProject) -> PanoramaRenderer:
        mission = self._mission
        return PanoramaRenderer(
            project,
            mission.folder,
            self._work,
            target=self._panorama,
            ground=Ground(band=mission.band, horizon_deg=self._options.horizon_deg, masks=mission.masks),
            memory_bytes=self._options.memory_bytes,
            xmp=packet(gpano_properties(project.canvas_px[0], heading_deg=mission.place.heading_deg)),
            gains=[self._examined.gains.get(image.file_name, (1.0, 1.0, 1.0)) for image in project.images],
        )

    def _finish(self, renderer: PanoramaRenderer, project: PtoProject) -> None:
        """Finish the TIFF, write preview and result, and remove intermediate files."""
        rendered = renderer.finish()
        preview = self._write_preview(rendered)
        facts = json.loads((self._work / "alignment.json").read_text(encoding="utf-8"))
        result = StitchResult(
            completeness=rendered.completeness,
            images=len(project.images),
            left_out=dict(self._mission.left_out),
            untied=tuple(facts["untied"]),
            points=facts["points"],
            rms_px=float("nan") if facts["rms_px"] is None else facts["rms_px"],
            hfov_deg=facts["hfov_deg"],
            correction_deg=facts["correction_deg"],
            canvas_px=project.canvas_px,
            panorama=self._panorama,
            preview=preview,
            content=self._examined.to_json(),
        )
        write_atomically(self._work / "stitch.json", json.dumps(result.to_json(), indent=1) + "\n")
        for name in ("blocks", "remapped", "match"):
            shutil.rmtree(self._work / name, ignore_errors=True)

    def _write_preview(self, rendered: Rendered) -> Path:
        """The whole sphere as a JPEG with EXIF and GPano tags; its size is the canvas's, or a whole fraction of it."""
        path = self._work / "panorama.jpg"
        width = rendered.preview.shape[1]
        tags = gpano_properties(width, heading_deg=self._mission.place.heading_deg)
        tags["GPano:FullPanoHeightPixels"] = tags["GPano:CroppedAreaImageHeightPixels"] = str(rendered.preview.shape[0])

        def write(temporary: Path) -> None:
            PIL.Image.fromarray(rendered.preview).save(temporary, "JPEG", quality=90, exif=exif_of(self._mission.place))
            temporary.write_bytes(with_xmp(temporary.read_bytes(), packet(tags)))

        write_atomically_with(path, write)
        return path

    def _result(self, document: dict[str, Any]) -> StitchResult:
        """The result from `stitch.json`, to which the durations of all steps are added."""
        seconds = {name: self._state[name]["seconds"] for name in STEPS if name in self._state}
        if document.get("seconds") != seconds:
            document["seconds"] = seconds
            write_atomically(self._work / "stitch.json", json.dumps(document, indent=1) + "\n")
        return result_from_json(document, self._work)

    # --- bookkeeping

    @property
    def _panorama(self) -> Path:
        return self._work / "panorama.tif"

    def _told(self, step: str) -> Callable[[float, str], None]:
        return lambda fraction, text: self._progress(step, fraction, text)

    def _fingerprint(self, project: PtoProject) -> str:
        """Fingerprint of the photos and their measured angles."""
        parts = [render_pto(project)]
        for image in project.images:
            status = (self._mission.folder / image.file_name).stat()
            parts.append(f"{image.file_name} {status.st_size} {status.st_mtime_ns}")
        return _digest(*parts)

    def _read_state(self) -> dict[str, dict[str, Any]]:
        try:
            state = json.loads((self._work / "state.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return state if isinstance(state, dict) else {}

    def _write_state(self) -> None:
        write_atomically(self._work / "state.json", json.dumps(self._state, indent=1) + "\n")


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def _lens(project: PtoProject) -> Lens:
    image = project.images[0]
    return Lens(width_px=image.width_px, height_px=image.height_px, focal_length_px=project.focal_length_px)


def _aligned(measured: PtoProject, result: Adjustment, kept: Points) -> PtoProject:
    lens = result.lens
    distortion = {"b": lens.distortion} if abs(lens.distortion) > 1e-9 else {}
    return replace(
        measured.with_rotations(result.rotations),
        hfov_deg=float(np.degrees(2 * np.arctan(lens.width_px / 2 / lens.focal_length_px))),
        lens=distortion,
        control_points=as_control_points(kept),
        optimise=tuple((name, number) for number in range(1, len(measured.images)) for name in "ypr"),
    )


def _in_work(project: PtoProject) -> PtoProject:
    """The project for the folder `stitch`: Hugin resolves file names relative to the project file."""
    images = (
        image if Path(image.file_name).is_absolute() else replace(image, file_name=f"../{image.file_name}")
        for image in project.images
    )
    return replace(project, images=tuple(images))


def _from_work(project: PtoProject) -> PtoProject:
    """The project with names relative to the mission directory again."""
    images = (replace(image, file_name=image.file_name.removeprefix("../")) for image in project.images)
    return replace(project, images=tuple(images))


def _largest_turn_deg(measured: PtoProject, result: Adjustment) -> float:
    """The largest angle between an image's adjusted and measured attitude."""
    relative = np.swapaxes(measured.rotations(), -1, -2) @ result.rotations
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).max())
