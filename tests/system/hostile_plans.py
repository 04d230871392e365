"""Plan requests that are valid and cost as much as possible: `python -m tests.system.hostile_plans COUNT [SEED]`.

Each is read as the daemon reads it and planned in a process of its own, whose peak memory and processor time are told.
"""

from __future__ import annotations

import json
import os
import random
import resource
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from panoexec.daemon.mission_request import spec_of
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.mqtt.requests import PlanRequest

LARGEST_BYTES = 64 * 1024
"""Of a request, by the daemon."""

MOST_CPU_S = 60
"""Planning is ended after this much processor time; the daemon ends it too."""

Fields = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What one request took: peak memory (MB), processor time (s), and how it ended."""

    peak_mb: float
    cpu_s: float
    end: str


def requests(count: int, seed: int) -> Iterator[tuple[str, Fields]]:
    """So many hostile requests, each with the name of its kind."""
    rng = random.Random(seed)
    for number in range(count):
        kind = _KINDS[number % len(_KINDS)]
        yield kind.__name__.strip("_"), kind(rng)


def cost_of(fields: Fields, *, most_cpu_s: int = MOST_CPU_S) -> Cost:
    """Plan a request in a child process of this one."""
    assert len(json.dumps({"transaction": "x"} | fields)) <= LARGEST_BYTES
    read, write = os.pipe()
    child = os.fork()
    if not child:
        os.close(read)
        resource.setrlimit(resource.RLIMIT_CPU, (most_cpu_s, most_cpu_s + 5))
        try:
            end = _planned(fields)
        except MemoryError:
            end = "out of memory"
        os.write(write, end.encode()[:2000])
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        end = pipe.read()
    _, status, usage = os.wait4(child, 0)
    if not end:
        end = f"ended by signal {os.waitstatus_to_exitcode(status)}"
    return Cost(peak_mb=usage.ru_maxrss / 1024, cpu_s=usage.ru_utime + usage.ru_stime, end=end)


def _planned(fields: Fields) -> str:
    try:
        request = PlanRequest.model_validate({"transaction": "x"} | fields)
        plan = spec_of(Config(), request).plan()
    except (PanoexecError, ValueError) as error:
        return f"refused: {' '.join(str(error).split())}"
    certified = plan.certificate is not None and plan.certificate.certified
    return f"{len(plan.shots)} images, {'' if certified else 'not '}certified"


def _camera(hfov_deg: float, vfov_deg: float) -> Fields:
    """A camera with about these fields of view, as a table in the request."""
    from math import radians, tan  # noqa: PLC0415

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
    while len(json.dumps({"transaction": "x"} | fields)) > LARGEST_BYTES:
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


_KINDS: tuple[Callable[[random.Random], Fields], ...] = (
    _tiny_images,
    _large_overlap,
    _large_tolerance,
    _long_images,
    _long_sectors,
    _long_plans,
    _many_masks,
)


def main() -> None:
    """Tell what each request takes, and the largest peaks at the end."""
    count, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1
    only = sys.argv[3] if len(sys.argv) > 3 else ""
    found = []
    for number, (kind, fields) in enumerate(requests(count, seed)):
        if only and only not in (kind, str(number)):
            continue
        cost = cost_of(fields)
        found.append((cost.peak_mb, number, kind, cost))
        print(f"{number:4} {kind:16} {cost.peak_mb:6.0f} MB {cost.cpu_s:5.1f} s  {cost.end[:150]}", flush=True)
    print("largest:")
    for peak_mb, number, kind, cost in sorted(found, key=lambda each: -each[0])[:10]:
        print(f"{number:4} {kind:16} {peak_mb:6.0f} MB {cost.cpu_s:5.1f} s  {cost.end[:150]}")


if __name__ == "__main__":
    main()
