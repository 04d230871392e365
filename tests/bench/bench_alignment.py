"""Ties and refined attitudes on Scenario 1, against the truth and against Hugin's `cpfind`.

Photos of 1200 px with the paper's sensor errors, on a city (seed 950) and on a lake (seed 951); `cpfind`, if it is
installed, gets the same photos and the same measured angles. Its pairs count where at least six of its points agree
with the true attitudes to 0.1°. On a busy machine only processor times mean something, so they are given beside.
"""

from __future__ import annotations

import asyncio
import math
import shutil
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from panoexec.angles import FloatArray, quaternion_from_rotation, rotation
from panoexec.formats.hugin_pto import PtoProject, point_arrays, pto_image
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.model import Content, PhotoToCheck, Verdicts
from panoexec.pictures.process import PictureProcess
from panoexec.pictures.rotations import rotation_of_vector
from panoexec.planning.baselines.published import published_plan
from panoexec.planning.model import Plan
from panoexec.stitching.adjustment import Lens, Points, separation_deg
from panoexec.stitching.matching import find_points
from tests.bench.bench_service import usage
from tests.bench.harness import Measurement
from tests.support.photo_sets import PhotoSet, photo_set

WIDTH_PX: Final = 1200
CITY, LAKE = 950, 951
_AGREE_DEG: Final = 0.1
_POINTS: Final = 6


def measure() -> Iterable[Measurement]:
    """City, then lake."""
    plan = published_plan("scenario-1-proposed")
    city = photo_set(plan, scene_seed=CITY, seed=1, width_px=WIDTH_PX)
    began_s = time.process_time()
    examiner, verdicts = _examined(plan, city)
    cpu_s = (time.process_time() - began_s) / len(city.photos)
    yield Measurement(
        what=f"Scenario 1, {WIDTH_PX} px: processor time of a photo", ours=cpu_s, unit="s", goal="at most 0.25",
        met=cpu_s <= 0.25,
    )  # fmt: skip
    error = _attitude_error_deg(city, verdicts)
    yield Measurement(
        what="refined attitudes, city", ours=error, unit="deg rms", goal="at most 0.015", met=error <= 0.015
    )
    lake = photo_set(plan, scene_seed=LAKE, seed=2, width_px=WIDTH_PX, kind="lake")
    _, on_lake = _examined(plan, lake)
    loose = sum(one.verdict is Content.GEOMETRY_ONLY for one in on_lake.photos.values())
    error = _attitude_error_deg(lake, on_lake)
    yield Measurement(
        what=f"refined attitudes, lake ({loose} of {len(lake.photos)} by geometry only)", ours=error, unit="deg rms",
        goal="at most 0.1", met=error <= 0.1,
    )  # fmt: skip
    latest_s, latest_cpu_s = asyncio.run(_latency_s(plan, city))
    yield Measurement(
        what="latest result after its photo, back to back", ours=latest_s, unit="s", goal="at most 2",
        met=latest_s <= 2,
    )  # fmt: skip
    yield Measurement(what="the same: processor time", ours=latest_cpu_s, unit="s")
    if shutil.which("cpfind"):
        yield _recall(plan, city, examiner)


def _examined(plan: Plan, photos: PhotoSet) -> tuple[Examiner, Verdicts]:
    examiner = Examiner(
        plan.camera, {shot.index: rotation(shot.yaw_deg, shot.pitch_deg) for shot in plan.shots}, longer_px=WIDTH_PX
    )
    for photo in photos.photos:
        told = PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s)
        examiner.add(told, photo.content)
        examiner.verdicts()
    return examiner, examiner.verdicts(final=True)


def _attitude_error_deg(photos: PhotoSet, verdicts: Verdicts) -> float:
    """Angle between true and best known attitudes of all photos, rms, less the rotation that all of them share."""
    errors = []
    for photo in photos.photos:
        known = rotation_of_vector(-np.radians(verdicts.photos[photo.shot].error_deg)) @ photo.measured
        off = known @ photo.truth.T
        errors.append(np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2)
    found = np.degrees(np.array(errors))
    found -= found.mean(axis=0)
    return float(np.sqrt((found**2).sum(axis=1).mean()))


async def _latency_s(plan: Plan, photos: PhotoSet) -> tuple[float, float]:
    """The longest wait for the verdicts after a photo was given to the process, and its processor time for one."""
    longest_s, longest_cpu_s = 0.0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        async with PictureProcess.running(plan.camera) as checker:
            for photo in photos.photos:
                path = Path(folder) / f"{photo.shot}.jpg"
                path.write_bytes(photo.content)
                began_s, before = time.monotonic(), usage(checker.pid)
                await checker.add(photo.shot, path, quaternion_from_rotation(photo.measured).tolist(), photo.time_s)
                longest_s = max(longest_s, time.monotonic() - began_s)
                longest_cpu_s = max(longest_cpu_s, usage(checker.pid).cpu_s - before.cpu_s)
    return longest_s, longest_cpu_s


def _recall(plan: Plan, photos: PhotoSet, examiner: Examiner) -> Measurement:
    """Share of the pairs that `cpfind` ties truly which are tied here, too."""
    height_px = round(WIDTH_PX * plan.camera.half_height / plan.camera.half_width)
    focal_px = WIDTH_PX / (2 * plan.camera.half_width)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for photo in photos.photos:
            (folder / f"{photo.shot}.jpg").write_bytes(photo.content)
        images = tuple(pto_image(f"{photo.shot}.jpg", WIDTH_PX, height_px, photo.measured) for photo in photos.photos)
        project = PtoProject(
            images=images,
            hfov_deg=plan.camera.hfov_deg,
            canvas_px=(2 * round(math.pi * focal_px), round(math.pi * focal_px)),
        )
        began_s = time.monotonic()
        found = find_points(project, folder, folder, lambda _, __: None)
        spent_s = time.monotonic() - began_s
    numbers, pixels = point_arrays(found.control_points)
    points = Points(images=numbers, pixels=pixels)
    truth: FloatArray = np.array([photo.truth for photo in photos.photos])
    lens = Lens(width_px=WIDTH_PX, height_px=height_px, focal_length_px=focal_px)
    true = numbers[separation_deg(points, truth, lens) <= _AGREE_DEG]
    pairs, counts = np.unique(np.sort(true, axis=1), axis=0, return_counts=True)
    shots = [photo.shot for photo in photos.photos]
    wanted = {
        tuple(sorted((shots[a], shots[b]))) for (a, b), count in zip(pairs, counts, strict=True) if count >= _POINTS
    }
    ours = {pair for pair, tie in examiner.ties.items() if tie.tied}
    share = len(wanted & ours) / len(wanted)
    return Measurement(
        what=f"of {len(wanted)} pairs that cpfind ties ({len(ours)} here; it took {spent_s:.0f} s)", ours=100 * share,
        unit="%", goal="at least 98", met=share >= 0.98,
    )  # fmt: skip
