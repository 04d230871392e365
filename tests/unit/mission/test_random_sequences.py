"""Thousands of missions under random commands, faults, stops and kills; every invariant is checked after each.

`PANOEXEC_SEQUENCES` sets how many (default 1000); a failing one prints its seed, `PANOEXEC_SEED` repeats just that one.
"""

from __future__ import annotations

import asyncio
import os
import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from panoexec.devices import EvidenceLevel
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.log.states import FINISHED
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mission.settings import GuardSettings
from panoexec.planning.model import GimbalLimits, Turning
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.process import Process
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_plan, a_world, some_settings

COUNT = int(os.environ.get("PANOEXEC_SEQUENCES", "1000"))
CHUNK = 50
METRE = 1 / 111_194.9
FAST = GimbalLimits(
    pitch_rate_deg_s=400.0,
    yaw_rate_deg_s=720.0,
    pitch_acceleration_deg_s2=4000.0,
    yaw_acceleration_deg_s2=4000.0,
)

NOSE = replace(
    FAST,
    yaw_min_deg=0.0,
    yaw_max_deg=0.0,
    yaw_endless=False,
    turning=Turning(rate_deg_s=720.0, acceleration_deg_s2=4000.0, settle_s=0.05),
)
"""Two axes: the vehicle pans."""


def _set(target: str, **values: Any) -> Callable[[World], None]:
    def change(world: World) -> None:
        thing = getattr(world, target)
        if target == "vehicle":
            thing.change(**values)
        else:
            for name, value in values.items():
                setattr(thing, name, value)

    return change


def _wander(world: World) -> None:
    world.gimbal.drift = lambda at_s: (0.0, 0.4 if int(at_s * 3) % 3 == 0 else 0.0, 0.0)


def _shutter_open(world: World, at_s: float) -> bool:
    return bool(world.camera.photos) and 0 <= at_s - world.camera.photos[-1].triggered_s < 0.15


def _kick(world: World) -> None:
    """The shutter shakes the camera: out of tolerance exactly while it is open."""
    world.gimbal.drift = lambda at_s: (0.0, 0.3 if _shutter_open(world, at_s) else 0.0, 0.0)


def _blink(world: World) -> None:
    """No attitude gets through while the shutter is open."""
    world.gimbal.mute = lambda at_s: _shutter_open(world, at_s)


def _prove_as_usual(world: World) -> None:
    """A camera that can be asked later is in no hurry: there is time to die between the pose and the proof."""
    world.camera.proof_after_s = 0.5 if world.camera.counts else 0.05


FAULTS: dict[str, tuple[Callable[[World], None], Callable[[World], None]]] = {
    "link": (_set("vehicle", connected=False), _set("vehicle", connected=True)),
    "silent": (_set("gimbal", silent=True), _set("gimbal", silent=False)),
    "nan": (_set("gimbal", nan=True), _set("gimbal", nan=False)),
    "frozen": (_set("gimbal", frozen=True), _set("gimbal", frozen=False)),
    "flags": (_set("gimbal", failure_flags=32), _set("gimbal", failure_flags=0)),
    "stuck": (_set("gimbal", stuck=True), _set("gimbal", stuck=False)),
    "drift": (_wander, _set("gimbal", drift=None)),
    "kick": (_kick, _set("gimbal", drift=None)),
    "blink": (_blink, _set("gimbal", mute=None)),
    "steal": (_set("gimbal", in_control=False), lambda _: None),
    "refused": (_set("gimbal", refusals=4), _set("gimbal", refusals=0)),
    "no control": (_set("gimbal", in_control=False, refuse_control=2), _set("gimbal", refuse_control=0)),
    "pilot": (_set("vehicle", mode="STABILIZED"), _set("vehicle", mode="OFFBOARD")),
    "cannot turn": (_set("vehicle", mode="HOLD"), _set("vehicle", mode="OFFBOARD")),
    "no turn": (lambda w: setattr(w.vehicle, "refusals", 4), lambda w: setattr(w.vehicle, "refusals", 0)),
    "landed": (_set("vehicle", in_air=False), _set("vehicle", in_air=True)),
    "battery": (_set("vehicle", battery_frac=0.1), _set("vehicle", battery_frac=0.9)),
    "position": (_set("vehicle", latitude_deg=47.0 + 4 * METRE), _set("vehicle", latitude_deg=47.0)),
    "reboot": (_set("vehicle", boot_count=1), lambda _: None),
    "storage": (_set("camera", storage_free_images=0), _set("camera", storage_free_images=1e9)),
    "lost proof": (_set("camera", lost_proofs=1), _set("camera", lost_proofs=0)),
    "late proof": (_set("camera", proof_after_s=0.7), _prove_as_usual),
    "lost command": (_set("camera", lost_commands=1), _set("camera", lost_commands=0)),
    "refused photo": (_set("camera", refusals=1), _set("camera", refusals=0)),
    "slow disk": (_set("journal", delay_s=0.8), _set("journal", delay_s=0.004)),
}
OF_ATTEMPTS = ["kick", "blink", "drift", "stuck", "nan", "lost proof", "lost command", "refused", "refused photo"]
"""Faults that spoil attempts and do not hold the mission."""
COMMANDS = ["pause", "resume", "skip", "repeat", "finish", "abort", "interrupt"]
WEIGHTS = [6, 8, 3, 3, 1, 1, 1]


@dataclass
class Tally:
    """What the sequences reached, so that the test knows that it tested something."""

    states: set[str]
    codes: set[str]
    kills: int = 0
    settled: int = 0
    filed: int = 0
    resumed: int = 0
    accepted: int = 0
    rejected: int = 0
    paused: set[str] | None = None


def _command(rng: random.Random, mission: Mission, name: str) -> None:
    verb = getattr(mission.commands, name)
    try:
        if name in {"skip", "repeat"} and rng.random() < 0.5:
            verb(rng.randrange(5))
        else:
            verb()
    except CommandRefusedError:
        pass


async def _stir(rng: random.Random, world: World, mission: Mission, steps: int) -> None:
    """Random commands and faults; at the end all is well again, and the mission is asked to go on."""
    if rng.random() < 0.7:
        FAULTS[rng.choice(OF_ATTEMPTS)][0](world)
    for _ in range(steps):
        await world.clock.sleep(rng.choice([0.0, 0.001, 0.05, 0.1, 0.3, 0.6]) * rng.random())
        if rng.random() < 0.25:
            _command(rng, mission, rng.choices(COMMANDS, WEIGHTS)[0])
        else:
            inject, clear = FAULTS[rng.choice(list(FAULTS))]
            (inject if rng.random() < 0.6 else clear)(world)
    for _, clear in FAULTS.values():
        clear(world)
    while not mission.record.ended:
        await world.clock.sleep(1.3)
        _command(rng, mission, "resume")


async def _moment(rng: random.Random, world: World) -> None:
    """A moment to kill at: any, or soon after a trigger, where a photo is in flight."""
    if rng.random() < 0.5:
        await world.clock.sleep(rng.random() * 3.0)
        return
    photos = len(world.camera.photos) + rng.randrange(3)
    while len(world.camera.photos) <= photos:
        await world.clock.sleep(0.01)
    await world.clock.sleep(rng.random() * 0.7)


async def _live(rng: random.Random, world: World, tally: Tally) -> MissionRecord | None:
    """One process: it ends by itself, or is killed, or stopped hard. Returns None when it was killed."""
    process = Process(world)
    mission = process.mission(past=list(world.journal.events))
    end = rng.choices(["by itself", "kill", "cancel"], [6, 3, 1])[0]
    async with asyncio.TaskGroup() as group:
        running = group.create_task(mission.run(), name="mission")
        stirring = group.create_task(_stir(rng, world, mission, rng.randrange(14)), name="stir")
        if end != "by itself":
            killer = group.create_task(_moment(rng, world), name="killer")
            await asyncio.wait({running, killer}, return_when=asyncio.FIRST_COMPLETED)
            killer.cancel()
        if end == "kill" and not running.done():
            await process.kill(running)
            tally.kills += 1
        elif end == "cancel" and not running.done():
            running.cancel()
        await asyncio.wait({running})
        stirring.cancel()
    for _, clear in FAULTS.values():
        clear(world)
    return None if process.dead else mission.record


async def _sequence(seed: int, tally: Tally) -> None:
    rng = random.Random(seed)
    limits = NOSE if rng.random() < 0.15 else FAST
    settings = some_settings(
        settle_s=0.1,
        interval_s=0.2,
        patience_s=0.4,
        attempts=2,
        rounds=2,
        evidence_s=1.0,
        max_pause_s=rng.choice([3.0, 20.0]),
        max_rate_deg_s=5.0,
        pending=rng.choice([1, 1, 2]),
        accept=rng.choice(["tolerance", "tolerance", "overlap"]),
        min_evidence=rng.choice([EvidenceLevel.ACKNOWLEDGED, EvidenceLevel.CAPTURE_MESSAGE]),
        gimbal=limits,
        guards=GuardSettings(
            allowed_modes=("OFFBOARD", "HOLD") if limits is NOSE else ("OFFBOARD",),
            reclaim=rng.choice(["ask", "never"]),
            reclaim_after_s=0.5,
            clear_s=0.3,
        ),
    )
    plan = a_plan(rng.choice([1, 3, 4]))
    async with a_world(
        plan=plan, settings=settings, rate_hz=20.0, limits=replace(limits, turning=None), seed=seed
    ) as world:
        world.camera.remembers, world.camera.counts = rng.choice([(True, True), (False, True), (False, False)])
        world.vehicle.turn_rate_deg_s, world.vehicle.turn_acceleration_deg_s2 = 720.0, 4000.0
        _prove_as_usual(world)
        for lives in range(1, 7):
            record = await _live(rng, world, tally)
            world.vehicle.change(boot_count=0)
            if record is None:
                continue
            check_mission(world, record)
            _check_photos(world, record, lives)
            tally.states.add(record.state.value)
            if record.state in FINISHED or rng.random() < 0.3:
                break
            tally.resumed += 1
        else:
            return
        tally.settled += _settled_after_a_crash(world)
        for shot in record.shots.values():
            for attempt in shot.attempts:
                tally.filed += attempt.code == "crash" and bool(attempt.photos) and attempt.exposed is None
                tally.accepted += attempt.verdict is Verdict.ACCEPTED
                tally.rejected += attempt.verdict is Verdict.REJECTED
                tally.codes.add(attempt.code)


def _settled_after_a_crash(world: World) -> int:
    """Photos that were in flight when a process died, and count all the same: by what the camera remembered."""
    count, exposed_before = 0, False
    exposed: set[tuple[int, int]] = set()
    for event in world.journal.events:
        match event:
            case ev.MissionStarted():
                exposed_before, exposed = True, set()
            case ev.ShotExposed():
                exposed.add((event.shot, event.attempt))
            case ev.ShotAccepted() if exposed_before and (event.shot, event.attempt) not in exposed:
                count += 1
    return count


def _check_photos(world: World, record: MissionRecord, lives: int) -> None:
    """No photo is unaccounted for but the one that a kill or a hard stop may cost."""
    known = sum(len(attempt.photos) for shot in record.shots.values() for attempt in shot.attempts)
    gentle = 0
    for event in world.journal.events:
        stopped = isinstance(event, ev.MissionPaused) and event.code == "interrupted" and "at once" not in event.reason
        gentle += stopped or isinstance(event, ev.MissionFinished)
    assert known <= len(world.camera.photos) <= known + lives - gentle


def _run(seed: int, tally: Tally) -> None:
    try:
        run_virtual(_sequence(seed, tally))
    except BaseException as error:
        error.add_note(f"PANOEXEC_SEED={seed}")
        raise


TALLY = Tally(states=set(), codes=set())
CHUNKS = range(COUNT // CHUNK)
DONE: set[int] = set()
"""The chunks that this process has run, whose sum `TALLY` is."""


@pytest.mark.parametrize("chunk", CHUNKS)
def test_random_commands_faults_and_kills(chunk: int) -> None:
    if "PANOEXEC_SEED" in os.environ:
        _run(int(os.environ["PANOEXEC_SEED"]), TALLY)
        return
    accepted_before = TALLY.accepted
    for seed in range(chunk * CHUNK, (chunk + 1) * CHUNK):
        _run(seed, TALLY)  # asserts every invariant
    assert TALLY.accepted > accepted_before
    DONE.add(chunk)


def test_the_sequences_reached_what_they_are_for() -> None:
    """Sums up the sequences above, so it needs them in its own process: under xdist that is `--dist loadfile`."""
    if not DONE.issuperset(CHUNKS):
        pytest.skip(f"only {len(DONE)} of {len(CHUNKS)} chunks of sequences passed in this process")
    assert TALLY.states >= {"complete", "incomplete", "aborted", "failed", "paused"}
    assert TALLY.codes >= {"not_settled", "pointing", "no_samples", "trigger", "evidence", "gimbal", "vehicle", "crash"}
    assert TALLY.kills > COUNT / 10
    assert TALLY.settled > COUNT / 200
    assert TALLY.filed > COUNT / 200
    assert TALLY.resumed > COUNT / 10
    assert TALLY.accepted > COUNT
    assert TALLY.rejected > COUNT / 5
