"""What the daemon says of its vehicle while there is none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.daemon.errors import VehicleNotReadyError
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.inputs.config import Config
from panoexec.store.session import Devices


def test_tells_what_it_lost_after_all_had_been_found() -> None:
    config = Config.model_validate({"vehicle": {"connection": "udpin://127.0.0.1:14540"}})
    vehicle = VehicleLink(config, clock=SystemClock())
    assert vehicle.lacking == "not connected yet"
    vehicle.reason = ""  # all were found, and nothing is heard any more
    assert vehicle.lacking == "lost: autopilot, gimbal, camera"
    assert not any(link.ok for link in (vehicle.links().autopilot, vehicle.links().gimbal, vehicle.links().camera))


def test_a_vehicle_that_may_be_another_one_is_not_ready() -> None:
    config = Config.model_validate({"vehicle": {"connection": "udpin://127.0.0.1:14540"}})
    vehicle = VehicleLink(config, clock=SystemClock())
    told = "several vehicles are on this link: set [vehicle] system_id"
    link = SimpleNamespace(heartbeat_age_s=0.1, connected=True, identity=SimpleNamespace(problem=told))
    vehicle._link = cast("MavsdkLink", link)
    vehicle.devices, vehicle.reason = cast("Devices", object()), ""
    with pytest.raises(VehicleNotReadyError, match=r"not certain: several vehicles .* \[vehicle\] system_id"):
        vehicle.ready_devices()
    assert told in vehicle.lacking
    link.identity.problem = ""
    assert vehicle.ready_devices() is vehicle.devices
