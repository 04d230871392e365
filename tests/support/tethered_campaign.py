"""Captures with a camera that loses events, stalls and is unplugged, compared with what it really took."""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass, field
from pathlib import Path

from panoexec.adapters.camera.tethered.camera import TetheredCamera
from panoexec.adapters.camera.tethered.files import TakenFile
from panoexec.adapters.camera.tethered.patience import Patience
from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel
from panoexec.errors import DeviceError
from tests.support.tethered import TestCamera, tethered_camera
from tests.waiting import eventually

QUICK = Patience(open_s=8.0, call_s=0.4, list_s=8.0, back_s=4.0, late_s=1.2, missing_s=0.3, look_s=0.05)


@dataclass
class Result:
    """What was accepted, and what it cost.

    Attributes:
        accepted: file and label by shot.
        wrong: shots whose file shows another one.
        files: what arrived, by its path in the camera.
        failures: attempts that were not accepted.
    """

    accepted: dict[int, tuple[str, str]] = field(default_factory=dict)
    wrong: list[int] = field(default_factory=list)
    files: dict[str, TakenFile] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    on_card: int = 0
    surplus: int = 0
    restarts: int = 0
    lost_events: int = 0


async def run_campaign(
    folder: Path, *, captures: int, stall_s: float, patience: Patience, seed: int, lose: float = 0.05
) -> Result:
    """Take photos until each shot has one; three stalls and two unplugs come at random moments."""
    draw = random.Random(seed)
    at = draw.sample(range(2, captures - 2), 5)
    faults = dict(zip(at, ("stall", "stall", "stall", "unplug", "unplug"), strict=True))
    result = Result()
    async with (
        tethered_camera(folder / "card", lose=lose, seed=seed) as sim,
        TetheredCamera(clock=SystemClock(), port=sim.address, patience=patience, spool=folder / "incoming") as camera,
    ):
        await camera.discover(30)

        async with asyncio.TaskGroup() as group:
            for shot in range(captures):
                if fault := faults.get(shot):
                    group.create_task(_strike(sim, fault, stall_s, draw.choice((0.0, 0.01, 0.03))))
                    await asyncio.sleep(0.005)
                await _shoot(camera, sim, shot, result, patience)
            await eventually(lambda: not camera.files.pending)
        result.files = {taken.told: taken for taken in camera.files.arrived}
        assert len(result.files) == len(camera.files.arrived)
        result.surplus, result.restarts = camera.surplus_photos, camera.restarts
    result.on_card, result.lost_events = len(sim.shown), sim.lost_events
    result.wrong = [
        shot for shot, (file, label) in result.accepted.items() if sim.shown[file.rsplit("/", 1)[1]] != label
    ]
    return result


async def _strike(sim: TestCamera, fault: str, stall_s: float, after_s: float) -> None:
    await asyncio.sleep(after_s)
    if fault == "stall":
        await sim.stall(stall_s)
    else:
        sim.server.unplug()


async def _shoot(camera: TetheredCamera, sim: TestCamera, shot: int, result: Result, patience: Patience) -> None:
    attempt = 0
    while shot not in result.accepted:
        attempt += 1
        assert attempt < 50, result.failures[-5:]
        sim.label = f"{shot}.{attempt}"
        try:
            capture = await camera.trigger()
        except DeviceError as error:
            result.failures.append(f"{shot}: {error}")
            await asyncio.sleep(0.05)
            continue
        found = await capture.evidence(EvidenceLevel.FILE_SEEN, 4 * patience.late_s)
        if found.level >= EvidenceLevel.FILE_SEEN and not found.contradiction:
            result.accepted[shot] = (found.file_url, sim.label)
        else:
            result.failures.append(f"{shot}: {found.level.name} {found.contradiction}")
