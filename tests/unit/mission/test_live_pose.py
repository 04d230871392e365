"""Where the camera points now: what the gimbal reported, with its error to the current shot."""

from __future__ import annotations

import math

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.live_pose import LivePose
from panoexec.mission.log import events as ev
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.world import World


def test_the_pose_is_the_measured_one_with_its_error_to_the_current_shot() -> None:
    seen: list[tuple[LivePose | None, ev.ShotStarted]] = []

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotExposed, 1)
        await until_event(world, ev.ShotStarted, 2)
        await world.clock.sleep(0.05)
        seen.append((mission.pose, world.sink.of(ev.ShotStarted)[-1]))

    world = fly(script)
    pose, shot = seen[0]
    assert pose is not None
    assert pose.error_deg is not None
    assert pose.error_deg[0] == pytest.approx(pose.pitch_deg - shot.pitch_deg, abs=1e-6)
    assert math.sin(math.radians(pose.error_deg[2] - pose.yaw_deg + shot.yaw_deg)) == pytest.approx(0, abs=1e-6)
    assert world.record.state == "complete"
