"""A camera on the shutter output of a real autopilot: the payload exposes when the autopilot reports a trigger."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from panoexec.sim.config import CameraConfig, SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from tests.wire.sim_peer import EmbeddedPeer

RELEASED = SimConfig(
    attach_url="tcp:127.0.0.1:1", camera_kind="servo", camera=CameraConfig(latency_s=0.05, exposure_s=0.01)
)


def feedback(index: int) -> Any:
    return mavlink.MAVLink_camera_feedback_message(
        0, 0, 0, index, 473977420, 85455940, 518.0, 30.0, 1.0, 2.0, 20.0, 0.0, mavlink.CAMERA_FEEDBACK_PHOTO, 0
    )


def exposures(peer: EmbeddedPeer) -> list[float]:
    return [event["sim_s"] for event in peer.truth.events if event["event"] == "exposure"]


def test_it_exposes_at_each_trigger_and_sends_no_message() -> None:
    peer = EmbeddedPeer(RELEASED)
    heard = peer.listen(2.0)
    assert {item.component for item in heard} == {mavlink.MAV_COMP_ID_GIMBAL}, "no camera beats"
    for index in (1, 2):
        peer.send(feedback(index), component=mavlink.MAV_COMP_ID_AUTOPILOT1)
        heard = peer.listen(1.5)
        assert {item.component for item in heard} == {mavlink.MAV_COMP_ID_GIMBAL}
    assert exposures(peer) == pytest.approx([2.05, 3.55], abs=0.01)


def test_it_ignores_other_components_and_commands() -> None:
    peer = EmbeddedPeer(RELEASED)
    peer.send(feedback(1), component=100)
    shoot = mavlink.MAVLink_command_long_message(1, 100, mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 0, 1, 1, 0, 0, 0)
    peer.send(shoot)
    heard = peer.listen(2.0)
    assert exposures(peer) == []
    assert "COMMAND_ACK" not in {item.name for item in heard}


def test_mavlink_camera_ignores_the_feedback_of_others() -> None:
    peer = EmbeddedPeer(dataclasses.replace(RELEASED, camera_kind="mavlink"))
    peer.send(feedback(1), component=mavlink.MAV_COMP_ID_AUTOPILOT1)
    heard = peer.listen(2.0)
    assert exposures(peer) == []
    assert mavlink.MAV_COMP_ID_CAMERA in {item.component for item in heard}
