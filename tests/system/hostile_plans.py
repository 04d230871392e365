"""Plan requests that are valid and cost as much as possible, from several kinds that are hard on the planner."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator
from math import radians, tan
from typing import Any

from panoexec.mqtt.requests import MAX_PAYLOAD

Fields = dict[str, Any]


def requests(count: int, seed: int) -> Iterator[tuple[str, Fields]]:
    """So many hostile requests, each with the name of its kind; the worst known comes first."""
    if count:
        yield "worst", WORST
    rng = random.Random(seed)
    for number in range(count - 1):
        kind = _KINDS[number % len(_KINDS)]
        yield kind.__name__.strip("_"), kind(rng)


def _camera(hfov_deg: float, vfov_deg: float) -> Fields:
    """A camera with about these fields of view, as a table in the request."""
    focal = 10.0
    width, height = (2 * focal * tan(radians(fov) / 2) for fov in (hfov_deg, vfov_deg))
    return {
        "name": "hostile",
        "sensor_width_mm": width,
        "sensor_height_mm": height,
        "image_width_px": 4000,
        "image_height_px": max(1, min(4000, round(4000 * height / width))),
        "focal_length_mm": focal,
        "source": "none",
    }


def _asked(
    rng: random.Random, fov_deg: tuple[float, float], overlap: tuple[float, float], tolerance_deg: float
) -> Fields:
    high = rng.uniform(-60, 90)
    low = rng.uniform(-90, high - 1)
    start, span = rng.uniform(-180, 180), rng.choice([360.0, rng.uniform(1, 359)])
    return {
        "camera": _camera(max(fov_deg), min(fov_deg)),
        "overlap_h": overlap[0],
        "overlap_v": overlap[1],
        "elevation_deg": [low, high],
        "azimuth_deg": [start, min(start + span, 360.0)] if span < 360 else [-180, 180],
        "tolerance_deg": {axis: rng.choice([0, tolerance_deg]) for axis in ("pitch", "roll", "yaw")},
        "guarantee": rng.choice(["coverage", "all"]),
        "method": rng.choice(["certified"] * 5 + ["paper"]),
    }


def _tiny_images(rng: random.Random) -> Fields:
    return _asked(rng, (rng.uniform(0.05, 3), rng.uniform(0.05, 3)), (rng.random() * 0.5, rng.random() * 0.5), 0.01)


def _large_overlap(rng: random.Random) -> Fields:
    fov = rng.uniform(20, 150), rng.uniform(20, 100)
    return _asked(rng, fov, (rng.uniform(0.7, 0.99), rng.uniform(0.1, 0.95)), rng.choice([0.1, 1.0, 5.0]))


def _large_tolerance(rng: random.Random) -> Fields:
    fov = rng.uniform(20, 170), rng.uniform(20, 150)
    return _asked(rng, fov, (rng.uniform(0, 0.9), rng.uniform(0, 0.9)), rng.uniform(1, 20)) | {"guarantee": "all"}


def _long_images(rng: random.Random) -> Fields:
    fov = rng.uniform(60, 178), rng.uniform(0.05, 20)
    return _asked(rng, fov, (rng.uniform(0, 0.9), rng.uniform(0, 0.9)), rng.choice([0.01, 0.1, 1.0]))


def _long_sectors(rng: random.Random) -> Fields:
    fields = _asked(rng, (rng.uniform(5, 90), rng.uniform(5, 70)), (rng.uniform(0.3, 0.98), rng.uniform(0.1, 0.5)), 2.0)
    low = rng.uniform(-30, 10)
    return fields | {"elevation_deg": [low, low + rng.uniform(1, 20)], "azimuth_deg": [-40, rng.uniform(-20, 300)]}


def _shots(rng: random.Random, most: int) -> list[Fields]:
    style = rng.randrange(5)
    shots = []
    for number in range(rng.randint(most // 2, most)):
        match style:
            case 0:
                pose = 0.0, 0.0
            case 1:
                pose = rng.uniform(-90, 90), rng.uniform(-180, 180)
            case 2:
                pose = round(rng.uniform(-5, 5), 2), round(rng.uniform(-5, 5), 2)
            case 3:
                pose = -90.0 + number % 9 * 20, number * 7.7 % 360 - 180
            case _:
                pose = -90.0 + number * 180 / most, 0.0
        shots.append({"pitch_deg": round(pose[0], 2), "yaw_deg": round(pose[1], 2)})
    return shots


def _plan_file(rng: random.Random, most: int, masks: list[Fields]) -> Fields:
    shots = _shots(rng, most)
    if rng.random() < 0.4:
        for shot in shots:
            shot["row"] = rng.choice([0, round(shot["pitch_deg"]) + 90])
    tolerance = rng.choice([0, 0.1, 1.0, 10.0])
    constraints = {
        "overlap_h": 0.1,
        "overlap_v": 0.1,
        "elevation_deg": [-90, 90] if rng.random() < 0.5 else [-20, 20],
        "azimuth_deg": [-180, 180] if rng.random() < 0.5 else [-60, 60],
        "tolerance_deg": {"pitch": tolerance, "roll": tolerance, "yaw": tolerance},
        "guarantee": rng.choice(["coverage", "all"]),
        "masks": masks,
    }
    fov = rng.choice([(60.0, 47.0), (175.0, 170.0), (5.0, 4.0), (0.1, 0.1)])
    fields: Fields = {"plan": {"shots": shots, "constraints": constraints}, "camera": _camera(*fov)}
    while len(json.dumps({"transaction": "x"} | fields)) > MAX_PAYLOAD:
        del shots[len(shots) * 9 // 10 :]
    return fields


def _long_plans(rng: random.Random) -> Fields:
    return _plan_file(rng, 1900, [])


def _many_masks(rng: random.Random) -> Fields:
    masks = []
    for number in range(rng.randint(20, 700)):
        low, left = rng.uniform(-90, 85), rng.uniform(-180, 180)
        if number % 2:
            low, left = -90 + number % 37 * 4.8, -180 + number * 7 % 360
        high, right = min(low + rng.uniform(0.01, 20), 90), left + rng.uniform(0.01, 40)
        masks.append(
            {"elevation_deg": [round(low, 2), round(high, 2)], "azimuth_deg": [round(left, 2), round(right, 2)]}
        )
    return _plan_file(rng, 300, [mask for mask in masks if mask["elevation_deg"][0] < mask["elevation_deg"][1]])


def _wide(rng: random.Random) -> Fields:
    return _loose(rng) | {
        "camera": _camera(rng.uniform(40, 110), rng.uniform(30, 60)),
        "overlap_h": rng.uniform(0.5, 0.85),
        "overlap_v": rng.uniform(0.0, 0.6),
        "elevation_deg": [-rng.uniform(5, 90), rng.uniform(5, 90)],
        "azimuth_deg": [-rng.uniform(20, 180), rng.uniform(20, 180)],
    }


def _tele(rng: random.Random) -> Fields:
    fov_deg, fields = rng.uniform(0.5, 6.0), _loose(rng)
    return fields | {
        "camera": _camera(fov_deg, 2 * fov_deg / 3),
        "elevation_deg": [-90, rng.uniform(-80, 90)],
        "overlap": rng.uniform(0.0, 0.5),
        "tolerance_deg": {axis: value / 20 for axis, value in fields["tolerance_deg"].items()},
    }


def _scattered_shots(rng: random.Random) -> Fields:
    shots = [
        {"pitch_deg": round(rng.uniform(-90, 90), 2), "yaw_deg": round(rng.uniform(-180, 180), 2)}
        for _ in range(rng.randrange(200, 1300))
    ]
    return _loose(rng) | {"camera": _camera(rng.uniform(5, 110), rng.uniform(5, 60)), "plan": {"shots": shots}}


def _sphere_with_masks(rng: random.Random) -> Fields:
    masks = []
    for _ in range(rng.randrange(20, 400)):
        low, left = rng.uniform(-90, 80), rng.uniform(-180, 170)
        masks.append({"elevation_deg": [low, low + rng.uniform(0.1, 9)], "azimuth_deg": [left, left + 9.0]})
    fields = _loose(rng)
    constraints = {
        "overlap_h": 0.2,
        "overlap_v": 0.2,
        "elevation_deg": [-90, 90],
        "tolerance_deg": fields["tolerance_deg"],
        "masks": masks,
    }
    shots = [{"pitch_deg": pitch, "yaw_deg": yaw} for pitch in range(-80, 81, 20) for yaw in range(-180, 180, 15)]
    return fields | {"camera": _camera(40, 30), "plan": {"shots": shots, "constraints": constraints}}


def _loose(rng: random.Random) -> Fields:
    """Tolerances and what they guarantee."""
    tolerance = {axis: rng.choice([0.0, 0.5, 2.0, 5.0]) for axis in ("pitch", "roll", "yaw")}
    return {"guarantee": rng.choice(["coverage", "all"]), "tolerance_deg": tolerance}


_KINDS: tuple[Callable[[random.Random], Fields], ...] = (
    _tiny_images,
    _wide,
    _tele,
    _scattered_shots,
    _sphere_with_masks,
    _large_overlap,
    _large_tolerance,
    _long_images,
    _long_sectors,
    _long_plans,
    _many_masks,
)

WORST: Fields = {
    "camera": _camera(60, 47),
    "elevation_deg": [-10, 10],
    "azimuth_deg": [-40, 40],
    "overlap_h": 0.7,
    "tolerance_deg": {"pitch": 5, "roll": 5, "yaw": 5},
    "guarantee": "all",
}
