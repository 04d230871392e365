"""The simulated photos show what the camera truly saw: angles and signs, proven by the images themselves."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from numpy.typing import NDArray

from panoexec.angles import rotation
from panoexec.sim.config import CameraConfig, GimbalConfig, SimConfig
from panoexec.sim.faults import parse_fault
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.photos.darkroom import Darkroom, ExposedPhoto
from panoexec.sim.photos.render import Renderer
from panoexec.sim.photos.scene import procedural_scene
from panoexec.sim.physics.world import SimClock, TruthLog
from panoexec.sim.simulation import Simulation
from tests.wire.sim_peer import command

POSES = ((-20.0, 40.0), (-90.0, 100.0), (-60.0, -150.0))
CONFIG = SimConfig(
    camera=CameraConfig(render_width_px=320),
    gimbal=dataclasses.replace(GimbalConfig(), heading_error_deg=2.0, heading_period_s=30.0),
    faults=(parse_fault("drift=#4,x3"),),
)


class _Silence:
    name = "ground"

    def send(self, frame: bytes, message: Any) -> None:
        """Nobody listens."""


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[dict[str, Any], NDArray[np.float64]]]:
    """Photos of `POSES` and one of a drift: the truth of each, and its pixels."""
    output = tmp_path_factory.mktemp("photos")
    photos: list[ExposedPhoto] = []
    config = dataclasses.replace(CONFIG, output=output)
    truth = TruthLog(output / "truth.jsonl")
    simulation = Simulation(config, clock=SimClock(), link=_Silence(), truth=truth, develop=photos.append)
    simulation.start()
    now = 0.0
    for pitch, yaw in (*POSES, POSES[0]):
        lock = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
        aim = command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, pitch, yaw, math.nan, math.nan, lock)
        for message in (aim, command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, 1, to=100)):
            simulation.receiver(message, message.pack(mavlink.MAVLink(None, 1, 195)))
            now += 4.0
            simulation.advance(now, budget_s=math.inf)
    truth.close()
    asyncio.run(_develop(config, photos))
    lines = (output / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    events = [json.loads(line) for line in lines if '"exposure"' in line]
    return [(event, pixels_of(output / event["file"])) for event in events]


async def _develop(config: SimConfig, photos: list[ExposedPhoto]) -> None:
    darkroom = Darkroom(config.camera.optics, config.camera.render_width_px, scene=None, seed=config.seed)
    await darkroom.start()
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(darkroom.run(), name="darkroom")
        for photo in photos:
            darkroom.develop(photo)
        assert await darkroom.drain(60.0)
        running.cancel()
    await darkroom.close()
    assert darkroom.failures == []


def pixels_of(path: Path) -> NDArray[np.float64]:
    with PIL.Image.open(path) as image:
        return np.asarray(image.convert("L"), dtype=np.float64)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(procedural_scene(CONFIG.seed))


def likeness(renderer: Renderer, photo: NDArray[np.float64], yaw: float, roll: float, pitch: float) -> float:
    """Correlation of a photo with what is seen at an attitude."""
    seen = renderer.render(CONFIG.camera.optics, rotation(yaw, pitch, roll), 320)
    grey = np.asarray(PIL.Image.fromarray(seen).convert("L"), dtype=np.float64)
    return float(np.corrcoef(photo.ravel(), grey.ravel())[0, 1])


def test_photos_show_the_scene_at_the_true_attitude(photos: Any, renderer: Renderer) -> None:
    assert len(photos) == 4
    for event, photo in photos[:3]:
        yaw, roll, pitch = event["true_yaw_roll_pitch_deg"][0]
        assert likeness(renderer, photo, yaw, roll, pitch) > 0.98


def test_wrong_signs_show_something_else(photos: Any, renderer: Renderer) -> None:
    for event, photo in photos[:3]:
        yaw, roll, pitch = event["true_yaw_roll_pitch_deg"][0]
        for wrong in ((-yaw, roll, pitch), (yaw, roll, -pitch), (yaw + 90, roll, pitch), (yaw, roll + 15, pitch)):
            assert likeness(renderer, photo, *wrong) < 0.8


def test_the_error_of_the_compass_is_in_the_photo_and_not_in_the_report(photos: Any, renderer: Renderer) -> None:
    """The yaw at which the photo fits best is the true one, off from the reported one by the heading error."""
    errors = []
    for event, photo in photos[:3]:
        _, roll, pitch = event["true_yaw_roll_pitch_deg"][0]
        reported = event["measured_yaw_roll_pitch_deg"][0]
        offsets = np.arange(-3.0, 3.01, 0.25)
        best = offsets[np.argmax([likeness(renderer, photo, reported + o, roll, pitch) for o in offsets])]
        assert best == pytest.approx(-event["heading_error_deg"], abs=0.26)
        errors.append(abs(event["heading_error_deg"]))
    assert max(errors) > 0.5


def test_a_drift_moves_what_the_photo_shows(photos: Any, renderer: Renderer) -> None:
    event, photo = photos[3]
    still, _ = photos[0]
    yaw, roll, pitch = event["true_yaw_roll_pitch_deg"][0]
    off = math.hypot(pitch - still["target"]["pitch_deg"], event["estimated_yaw_roll_pitch_deg"][0] - POSES[0][1])
    assert off == pytest.approx(3.0, abs=0.2)
    at_truth = likeness(renderer, photo, yaw, roll, pitch)
    at_target = likeness(renderer, photo, POSES[0][1] - event["heading_error_deg"], 0.0, POSES[0][0])
    assert at_truth > 0.98 > at_target
