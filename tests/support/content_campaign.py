"""Measures the examination of photos on rendered missions with random faults, against the truth.

Scenes are made of the seeds from 1000 on; thresholds were chosen on scenes 1 to 12. One scene serves several missions,
because painting it takes longer than photographing it.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from panoexec.angles import FloatArray, rotation
from panoexec.api import plans
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.model import BAD, PhotoToCheck
from panoexec.planning.model import Plan
from tests.support.photo_sets import PhotoSet, photo_set

FAULTS = (
    "photo-black",
    "photo-swapped",
    "photo-stale",
    "photo-truncated",
    "photo-damaged",
    "attitude-lie=1",
    "photo-blur=4",
    "photo-blur=6",
    "photo-defocus=4",
    "photo-dark=3",
)
MISSIONS_A_SCENE = 6
FALSE_TIE_DEG = 0.3
PLACE_HEIGHTS = 0.015
"""Standard deviation of each recorded coordinate, heights above the ground: half a metre at 30 m."""


@dataclass
class Tally:
    """Counts over missions.

    Attributes:
        put_in, found: photos by fault.
        clean, alarms: clean photos, and those of them that were condemned, with the reasons.
        ties, false_ties: ties found, and those farther from the truth than `FALSE_TIE_DEG` and four sigma.
        pairs, tied: pairs of clean photos with texture and at least 8 % of mutual overlap, and those of them tied.
        tilt_deg: errors of the estimated attitudes of clean photos in tilt.
        cpu_s: processor time of each photo, decoding included.
    """

    missions: int = 0
    put_in: Counter[str] = field(default_factory=Counter)
    found: Counter[str] = field(default_factory=Counter)
    clean: int = 0
    alarms: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    ties: int = 0
    false_ties: list[str] = field(default_factory=list)
    pairs: int = 0
    tied: int = 0
    tilt_deg: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)

    def share(self, *faults: str) -> float:
        """Share of the photos with these faults that were found; 1 without any."""
        names = [name for name in self.put_in if name.split("=")[0] in faults or name in faults]
        total = sum(self.put_in[name] for name in names)
        return sum(self.found[name] for name in names) / total if total else 1.0

    def lines(self) -> Iterator[str]:
        """The figures, for a person."""
        yield f"{self.missions} missions, {self.clean} clean photos, {sum(self.put_in.values())} bad ones"
        for name in sorted(self.put_in):
            yield f"  {name}: {self.found[name]} of {self.put_in[name]} found"
        yield f"  needless retakes: {len(self.alarms)} {self.alarms[:8]}"
        yield f"  missed: {self.missed[:8]}"
        yield f"  ties: {self.ties}, false: {len(self.false_ties)} {self.false_ties[:6]}"
        yield f"  pairs of at least 8 % overlap with texture: {self.pairs}, tied: {self.tied}"
        if self.tilt_deg:
            yield f"  estimated tilt: {np.sqrt(np.mean(np.square(self.tilt_deg))):.4f} deg rms"
        yield f"  processor time: {np.mean(self.cpu_s):.3f} s a photo, at most {np.max(self.cpu_s):.3f} s"


def campaign_plans() -> list[Plan]:
    """Plans of several cameras and bands."""
    asked: tuple[tuple[str, float, tuple[float, float], tuple[float, float]], ...] = (
        ("dji-x5s-15mm", 0.15, (-90, 30), (-180, 180)),
        ("dji-x5s-15mm", 0.25, (-90, 0), (-180, 180)),
        ("dji-x5s-15mm", 0.3, (-60, 10), (-100, 100)),
    )
    return [
        plans.plan(camera, overlap=overlap, elevation_deg=elevation, azimuth_deg=azimuth)
        for camera, overlap, elevation, azimuth in asked
    ]


def run(
    missions: int, *, seed: int = 1000, width_px: int = 800, kinds: tuple[str, ...] = ("city", "city", "snow")
) -> Tally:
    """Photograph and examine missions.

    Args:
        missions: how many.
        seed: of the first scene, and of the faults.
        width_px: of the photos.
        kinds: of scenes, in turn.
    """
    tally = Tally()
    rng = random.Random(seed)
    flown = campaign_plans()
    for number in range(missions):
        scene = number // MISSIONS_A_SCENE
        plan = flown[number % len(flown)]
        # every sixth mission is clean
        faults = {} if number % MISSIONS_A_SCENE == 0 else _draw(rng, len(plan.shots))
        photos = photo_set(
            plan,
            scene_seed=seed + scene,
            seed=seed * 7919 + number,
            width_px=width_px,
            kind=kinds[scene % len(kinds)],
            faults=faults,
        )
        examine(plan, photos, tally, f"{seed + scene}/{number}")
    return tally


def _draw(rng: random.Random, count: int) -> dict[int, str]:
    """About a tenth of the photos are bad; not neighbours in time, so that each fault stands for itself."""
    faults: dict[int, str] = {}
    for _ in range(max(1, round(0.12 * count))):
        place = rng.randrange(1, count - 2)
        if not any(abs(place - other) < 4 for other in faults):
            faults[place] = rng.choice(FAULTS)
    return faults


def examine(plan: Plan, photos: PhotoSet, tally: Tally, name: str) -> None:
    """Examine one mission as it arrives, and compare with the truth."""
    examiner = Examiner(plan.camera, {shot.index: rotation(shot.yaw_deg, shot.pitch_deg) for shot in plan.shots})
    places = random.Random(name)
    for photo in photos.photos:
        started = time.process_time()
        # recorded positions that the photos do not have: they must tie nothing that is not there
        place = np.array([places.gauss(0, PLACE_HEIGHTS) for _ in range(3)])
        given = PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s, place=place)
        examiner.add(given, photo.content)
        examiner.verdicts()
        tally.cpu_s.append(time.process_time() - started)
    verdicts = examiner.verdicts(final=True)
    tally.missions += 1
    by_shot = {photo.shot: photo for photo in photos.photos}
    for photo in photos.photos:
        judged = verdicts.photos[photo.shot]
        bad = judged.verdict in BAD
        if photo.fault:
            tally.put_in[photo.fault] += 1
            tally.found[photo.fault] += bad
            if not bad:
                tally.missed.append(f"{name} shot {photo.shot} {photo.fault} {judged.verdict.value}")
        else:
            tally.clean += 1
            if bad:
                tally.alarms.append(f"{name} shot {photo.shot} {judged.verdict.value}: {judged.reason}")
    clean = {shot for shot, photo in by_shot.items() if not photo.fault}
    for (a, b), tie in examiner.ties.items():
        one, other = by_shot[a], by_shot[b]
        if {a, b} <= clean:
            if tie.textured and tie.searched >= 20:
                tally.pairs += 1
                tally.tied += tie.tied
        elif any(by_shot[shot].fault.startswith(("photo-swapped", "photo-stale")) for shot in (a, b)):
            # the picture is another one: a tie is false wherever it is
            if tie.tied:
                tally.ties += 1
                tally.false_ties.append(f"{name} {a}-{b} of a wrong file, {tie.points} points")
            continue
        if tie.tied:
            tally.ties += 1
            off = float(
                np.linalg.norm(true_turn(one.measured, other.measured, one.truth, other.truth) - tie.turn_world_deg)
            )
            if off > FALSE_TIE_DEG + 4 * tie.sigma_deg:
                tally.false_ties.append(f"{name} {a}-{b} {off:.2f} deg, {tie.points} points")
    for shot in clean:
        if verdicts.photos[shot].ties:
            error = by_shot[shot].measured @ by_shot[shot].truth.T
            axis = np.degrees([error[2, 1] - error[1, 2], error[0, 2] - error[2, 0]]) / 2
            told = verdicts.photos[shot].error_deg
            tally.tilt_deg.append(float(np.hypot(told[0] - axis[0], told[1] - axis[1])))


def true_turn(first: FloatArray, second: FloatArray, true_first: FloatArray, true_second: FloatArray) -> FloatArray:
    """Measured minus true attitude of the second, if the first's were right; world frame, degrees."""
    error = second @ (first @ true_first.T @ true_second).T
    axis = np.array([error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]])
    return np.asarray(np.degrees(axis / 2))


if __name__ == "__main__":
    import sys

    for text in run(int(sys.argv[1]) if len(sys.argv) > 1 else 30).lines():
        print(text)
