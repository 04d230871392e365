"""What the daemon says of its vehicle while there is none."""

from __future__ import annotations

from panoexec.clock import SystemClock
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.inputs.config import Config


def test_tells_what_it_lost_after_all_had_been_found() -> None:
    config = Config.model_validate({"vehicle": {"connection": "udpin://127.0.0.1:14540"}})
    vehicle = VehicleLink(config, clock=SystemClock())
    assert vehicle.lacking == "not connected yet"
    vehicle.reason = ""  # all were found, and nothing is heard any more
    assert vehicle.lacking == "lost: autopilot, gimbal, camera"
    assert not any(link.ok for link in (vehicle.links().autopilot, vehicle.links().gimbal, vehicle.links().camera))
