"""Nothing accepted is untrue: whole missions with the real camera adapter and a camera that is hard to follow.

Its clock runs at another rate and is stepped, reports are lost, late, doubled and out of order, image indices jump,
photos are deferred, skipped, or somebody else's. Whatever the mission accepts must have been exposed in tolerance, by
the camera's own truth; a mission may end incomplete. `PANOEXEC_CAMERAS` sets how many cameras (default 60),
`PANOEXEC_SEED` repeats a single one.
"""

from __future__ import annotations

import asyncio
import os
import random

import pytest

from panoexec.mission.log.shot_record import AttemptRecord, Verdict
from panoexec.mission.pointing.poses import read_pose
from panoexec.planning.geometry.pose_error import pose_error
from tests.unit.fakes.checks import check_announcements, check_end, check_states
from tests.unit.fakes.mavlink_camera import CameraUnderTest, DoubtfulCamera, Habits, TruePhoto
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_plan, a_world, some_settings

COUNT = int(os.environ.get("PANOEXEC_CAMERAS", "60"))
CHUNK = 10


def fly_with(habits: Habits, *, seed: int, shots: int = 8, **settings: object) -> World:
    """A mission with such a camera; what it accepted is compared with the truth."""

    async def main() -> World:
        rng = random.Random(seed)
        changes = {"attempts": 2, "rounds": 2, "max_pause_s": 20.0} | settings
        async with (
            a_world(plan=a_plan(shots), settings=some_settings(**changes), seed=seed) as world,
            asyncio.TaskGroup() as group,
        ):
            camera = DoubtfulCamera(clock=world.clock, habits=habits, rng=rng, group=group)
            adapter = CameraUnderTest(camera)
            world.camera = adapter  # type: ignore[assignment]
            async with adapter:
                await adapter.discover()
                world.record = await world.mission().run()
                check_announcements(world, world.record)
                check_states(world)
                check_end(world, world.record)
                check_truth(world, camera.photos)
            camera.stop()
        return world

    return run_virtual(main())


def check_truth(world: World, photos: list[TruePhoto]) -> None:
    """Each accepted photo exists, was exposed in tolerance, and belongs to one shot alone."""
    used: list[int] = []
    for shot in world.record.shots.values():
        for attempt in shot.attempts:
            if attempt.verdict is Verdict.ACCEPTED:
                found = true_photo(attempt, photos)
                assert found is not None, f"shot {shot.shot.index}: accepted, but no photo was taken"
                used.append(found.number)
                _check_pose(world, attempt, found)
    assert len(used) == len(set(used)), "a photo belongs to two shots"


def true_photo(attempt: AttemptRecord, photos: list[TruePhoto]) -> TruePhoto | None:
    """The photo that an attempt claims: by its file, else the one that its trigger brought about."""
    claimed = attempt.photos[0]
    if claimed.file:
        return next(photo for photo in photos if photo.file == claimed.file)
    assert attempt.exposed is not None
    triggered_s = attempt.exposed.photos[0].capture_time_utc_s - 1_700_000_000.0
    return next((photo for photo in photos if abs(photo.triggered_s - triggered_s) < 0.005), None)


def _check_pose(world: World, attempt: AttemptRecord, photo: TruePhoto) -> None:
    feed, north = world.gimbal.feed, world.record.reference_yaw_north_deg
    samples = [s for s in feed.since(photo.exposed_s - 0.04) if s.received_s <= photo.ended_s]
    assert samples
    for sample in samples:
        reading = read_pose(sample, feed.vehicle_attitude_at(sample), north)
        assert reading.rotation is not None
        error = pose_error(attempt.pitch_deg, attempt.yaw_deg, reading.rotation)
        late_s = photo.exposed_s - photo.triggered_s
        assert bool(error.within(world.settings.tolerance)), f"photo {photo.number}, {late_s:.2f} s late: {error}"


def some_habits(rng: random.Random) -> Habits:
    """A camera with a few of all possible faults."""

    def sometimes(most: float) -> float:
        return rng.uniform(0.0, most) if rng.random() < 0.4 else 0.0

    if rng.random() < 0.1:  # never reports a photo: nothing can tell more than its count and the configured latency
        return Habits(reports=False, silent_requests=sometimes(0.3))
    return Habits(
        rate=rng.uniform(0.95, 1.05),
        step_s=rng.choice([0.0, rng.uniform(-20, 20), rng.uniform(-1, 1)]),
        step_at=rng.randrange(1, 10),
        latency_s=rng.choice([0.05, 0.05, rng.uniform(0.05, 1.5)]),
        deferred=sometimes(0.3),
        skipped=sometimes(0.2),
        lost=sometimes(0.4),
        late=sometimes(0.4),
        twice=sometimes(0.5),
        strangers=sometimes(0.2),
        jump=sometimes(0.3),
        silent_requests=sometimes(0.3),
        first_report_s=rng.choice([0.0, 0.0, rng.uniform(0, 8)]),
    )


REACHED: dict[str, int] = {}


@pytest.mark.parametrize("chunk", range(COUNT // CHUNK))
def test_nothing_accepted_is_untrue(chunk: int) -> None:
    for seed in range(chunk * CHUNK, (chunk + 1) * CHUNK):
        number = int(os.environ.get("PANOEXEC_SEED", seed))
        habits = some_habits(random.Random(number))
        try:
            world = fly_with(habits, seed=number, pending=1 + number % 2)
        except BaseException as error:
            error.add_note(f"PANOEXEC_SEED={number}: {habits}")
            raise
        for event in world.journal.events:
            REACHED[event.type] = REACHED.get(event.type, 0) + 1
        REACHED[world.record.state.value] = REACHED.get(world.record.state.value, 0) + 1
    assert REACHED["shot_accepted"] > 10
