"""Every kind of camera that the configuration can name is opened in one place."""

from __future__ import annotations

import math
from typing import get_args

import pytest

from panoexec.adapters.camera.mavlink_camera_found import MavlinkCameraFound
from panoexec.adapters.camera.open_camera import KINDS, open_camera
from panoexec.adapters.camera.serial_shutter import SerialShutter
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel
from panoexec.errors import LinkError
from panoexec.inputs.vehicle_sections import CameraSection


def test_each_trigger_of_the_configuration_has_its_kind() -> None:
    assert set(KINDS) == set(get_args(CameraSection.model_fields["trigger"].annotation))
    assert CameraSection().trigger in KINDS


async def test_a_serial_port_that_is_not_there_is_reported_on_entry() -> None:
    link = MavsdkLink("udpin://127.0.0.1:14599", clock=SystemClock())
    section = CameraSection(trigger="serial", serial_port="/dev/no-such-port")
    with pytest.raises(LinkError, match="/dev/no-such-port"):
        async with open_camera(section, link):
            pass


@pytest.mark.parametrize("wired", [False, True])
async def test_a_cable_release_is_proven_by_the_feedback_pin_alone(wired: bool) -> None:
    async def is_wired() -> bool:
        return wired

    shutter = SerialShutter("/dev/ttyUSB9", clock=SystemClock(), is_wired=is_wired)
    found = await shutter.discover()
    assert found.label == "a cable release on /dev/ttyUSB9 (rts)"
    assert not found.is_two_way
    assert not found.may_tell_files
    assert math.isinf(shutter.age_s)
    assert shutter.is_present
    expected = EvidenceLevel.FEEDBACK_PIN if wired else EvidenceLevel.COMMANDED
    assert await shutter.best_evidence() is expected


def test_a_mavlink_camera_is_labelled_by_what_it_states() -> None:
    camera = MavlinkCameraFound(component=100, vendor="ACME", model="Eye")
    shutter = MavlinkCameraFound(component=1)
    assert (camera.label, camera.may_tell_files) == ("ACME Eye, component 100", True)
    assert (shutter.label, shutter.may_tell_files) == ("a shutter of the autopilot, component 1", False)
    assert MavlinkCameraFound(component=101).label == "unnamed, component 101"
