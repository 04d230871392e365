"""Runs cases: renders, stitches and evaluates them, stores each result, and resumes an interrupted run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from panoexec.angles import FloatArray
from panoexec.errors import UsageError
from panoexec.experiment.capture import PointingErrors, Spread, true_rotations, write_capture
from panoexec.experiment.cases import DEFAULT_WIDTH_PX, Case, plan_of
from panoexec.files import write_atomically
from panoexec.formats.hugin_pto import parse_pto
from panoexec.planning.baselines.published import PAPER_TOLERANCE
from panoexec.planning.model import Plan
from panoexec.sim.photos.scene import DEFAULT_WIDTH_PX as SCENE_WIDTH_PX
from panoexec.sim.photos.scene import Scene, load_scene, procedural_scene
from panoexec.stitching.mission import load_mission
from panoexec.stitching.pipeline import Stitcher, StitchOptions
from panoexec.stitching.result import StitchResult
from panoexec.stitching.tools import check_tools, disk_error

FORMAT: Final = "panoexec.experiment/1"
_SCENE_SEED: Final = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Settings of all cases.

    Attributes:
        output: output folder, with one folder per case.
        width_px: width of the photos; None: the scenario's default.
        spread: distribution of the pointing errors.
        scene: an equirectangular image; None: the generated landscape.
        memory_bytes: memory limit for blending.
        keep: whether to keep photos and panoramas.
        restart: whether to discard results of earlier runs.
    """

    output: Path
    width_px: int | None = None
    spread: Spread = "uniform"
    scene: Path | None = None
    memory_bytes: int = 1 << 30
    keep: bool = False
    restart: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The result of a case.

    Attributes:
        scenario, plan, seed, repeat: the case.
        images: number of images of the plan.
        photo_width_px: width of the photos.
        completeness: equation (8).
        holes: number of holes in the ground; `hole_px` its pixels, `ground_px` the ground's.
        hole_elevations_deg: elevations of the largest holes.
        untied: images without control points to the others.
        misalignment_deg: root mean square of the angles between the aligned and the true attitudes of the tied images,
            after the best global rotation.
        seconds: duration of stitching.
    """

    scenario: int
    plan: str
    seed: int
    repeat: int
    images: int
    photo_width_px: int
    completeness: float
    holes: int
    hole_px: int
    ground_px: int
    hole_elevations_deg: tuple[float, ...]
    untied: int
    misalignment_deg: float
    seconds: float


Progress = Callable[[Case, str, float, str], None]
"""Called with a case, its step, the fraction of the step that is done, and a text."""


def run_cases(wanted: Sequence[Case], setting: Setting, progress: Progress) -> list[Outcome]:
    """Run cases one after the other.

    Args:
        wanted: from `cases`.
        setting: settings of all cases.
        progress: called at every step.

    Raises:
        ToolError: Hugin's tools are missing or failed, or the disk is full; finished cases are kept.
        UsageError: the scene cannot be read, or the folder not written.
    """
    check_tools()
    scene: Scene | None = None
    outcomes = []
    for case in wanted:
        plan = plan_of(case.scenario, case.plan)
        work = _Work(case, plan, setting)
        outcome = None if setting.restart else work.known()
        if outcome is None:
            scene = scene or _scene(setting)
            outcome = work.run(scene, progress)
        else:
            progress(case, "done", 1.0, "done before")
        outcomes.append(outcome)
    return outcomes


def _scene(setting: Setting) -> Scene:
    return load_scene(setting.scene) if setting.scene else procedural_scene(_SCENE_SEED, 2 * SCENE_WIDTH_PX)


class _Work:
    """One case in its folder."""

    def __init__(self, case: Case, plan: Plan, setting: Setting) -> None:
        self._case = case
        self._plan = plan
        self._setting = setting
        self._folder = setting.output / case.name
        self._result = self._folder / "outcome.json"
        self._width_px = setting.width_px or DEFAULT_WIDTH_PX[case.scenario]
        self._errors = PointingErrors(size=PAPER_TOLERANCE, spread=setting.spread, seed=case.seed)
        # the result depends on these settings
        self._key = {
            "images": len(plan.shots),
            "photo_width_px": self._width_px,
            "spread": setting.spread,
            "scene": str(setting.scene.resolve()) if setting.scene else None,
        }

    def known(self) -> Outcome | None:
        """The result of an earlier run with the same settings."""
        document = self._read(self._result)
        if document is None or document.get("key") != self._key:
            return None
        try:
            found = document["outcome"]
            return Outcome(**{**found, "hole_elevations_deg": tuple(found["hole_elevations_deg"])})
        except (KeyError, TypeError):
            return None

    def run(self, scene: Scene, progress: Progress) -> Outcome:
        """Render, stitch and evaluate."""
        self._photograph(scene, progress)
        mission = load_mission(self._folder)
        options = StitchOptions(memory_bytes=self._setting.memory_bytes, restart=self._setting.restart)
        result = Stitcher(mission, options, lambda step, part, text: progress(self._case, step, part, text)).run()
        outcome = self._judged(result)
        document = {"format": FORMAT, "key": self._key, "outcome": asdict(outcome)}
        write_atomically(self._result, json.dumps(document, indent=1) + "\n")
        if not self._setting.keep:
            shutil.rmtree(self._folder / "images", ignore_errors=True)
            (self._folder / "stitch" / "panorama.tif").unlink(missing_ok=True)
        return outcome

    def _photograph(self, scene: Scene, progress: Progress) -> None:
        """Render the capture unless an earlier run completed it."""
        made = self._folder / "capture.json"
        photos = self._folder / "images"
        if not self._setting.restart and self._read(made) == self._key and photos.is_dir():
            return
        progress(self._case, "render", 0.0, f"{len(self._plan.shots)} photos")
        try:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder.mkdir(parents=True)
        except OSError as error:
            reason = error.strerror or type(error).__name__
            raise UsageError(f"--output {self._setting.output}: cannot be written ({reason})") from error
        try:
            write_capture(self._folder, self._plan, scene, width_px=self._width_px, errors=self._errors)
        except OSError as error:
            raise disk_error(self._folder, error) from error
        write_atomically(made, json.dumps(self._key) + "\n")

    def _judged(self, result: StitchResult) -> Outcome:
        verdict, case = result.completeness, self._case
        aligned = parse_pto((self._folder / "stitch" / "aligned.pto").read_text(encoding="utf-8"))
        names = [Path(image.file_name).name for image in aligned.images]
        untied = {Path(name).name for name in result.untied}
        tied = [number for number, name in enumerate(names) if name not in untied]
        places = {f"IMG_{shot.index:04d}.jpg": number for number, shot in enumerate(self._plan.shots)}
        order = [places[names[number]] for number in tied]
        truth = true_rotations(self._plan, self._errors)[order]
        return Outcome(
            **asdict(case),
            images=len(self._plan.shots),
            photo_width_px=self._width_px,
            completeness=verdict.fraction,
            holes=len(verdict.holes),
            hole_px=verdict.hole_px,
            ground_px=verdict.ground_px,
            hole_elevations_deg=tuple(hole.elevation_deg for hole in verdict.holes[:6]),
            untied=len(untied),
            misalignment_deg=misalignment_deg(aligned.rotations()[tied], truth),
            seconds=round(sum(result.seconds.values()), 1),
        )

    @staticmethod
    def _read(path: Path) -> dict[str, Any] | None:
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return document if isinstance(document, dict) else None


def misalignment_deg(found: FloatArray, truth: FloatArray) -> float:
    """Root mean square angle between attitudes (n, 3, 3) and the true ones after the best global rotation; degrees.

    The turn is the rotation nearest to the sum of truth · foundᵀ (the orthogonal Procrustes problem).
    """
    if not len(found):
        return float("nan")
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", truth, found))
    whole = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    left = np.swapaxes(whole @ found, -1, -2) @ truth
    cosine = np.clip((np.trace(left, axis1=1, axis2=2) - 1) / 2, -1.0, 1.0)
    return float(np.sqrt(np.mean(np.degrees(np.arccos(cosine)) ** 2)))


def merged(outcomes: Sequence[Outcome]) -> list[list[Outcome]]:
    """The outcomes by scenario and plan, in the order of their first occurrence."""
    groups: dict[tuple[int, str], list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault((outcome.scenario, outcome.plan), []).append(outcome)
    return [groups[key] for key in sorted(groups, key=lambda key: key[0])]
