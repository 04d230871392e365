"""A whole daemon but for its vehicle, which is a light stand-in: for measuring fleets on a small computer.

Requests, transactions, missions, journal, manifest and the MQTT link are the daemon's own; gimbal, camera and vehicle
are objects in its process instead of a MAVLink connection and a simulator. Arguments: configuration.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from pathlib import Path

from panoexec.cli.serve import checked_config
from panoexec.clock import SystemClock
from panoexec.daemon.daemon import Daemon
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.devices import VehicleStatus
from panoexec.inputs.config import Config
from panoexec.logs import configure_logs
from panoexec.mqtt.messages import LinkFields, LinksFields
from panoexec.store.session import Devices
from tests.unit.fakes.camera import FakeCamera
from tests.unit.fakes.gimbal import FakeGimbal
from tests.unit.fakes.vehicle import FakeVehicle


class StandIn(VehicleLink):
    """A vehicle that is there at once and does what it is told."""

    def __init__(self, config: Config, *, clock: SystemClock) -> None:
        super().__init__(lambda: config, clock=clock)
        self._gimbal_stand_in = FakeGimbal(clock=clock)
        self.devices = Devices(
            gimbal=self._gimbal_stand_in, camera=FakeCamera(clock=clock), vehicle=FakeVehicle(clock=clock)
        )
        self.reason = ""

    @property
    def status(self) -> VehicleStatus:
        assert self.devices is not None
        return self.devices.vehicle.status

    def links(self) -> LinksFields:
        there = LinkFields(ok=True, age_s=0.1)
        return LinksFields(autopilot=there, gimbal=there, camera=there)

    async def run(self) -> None:
        """Stream attitudes while the gimbal is ours, as a link that is throttling does."""
        while True:
            self.pulse_s = time.monotonic()
            await asyncio.sleep(0.04 if self._gimbal_stand_in.in_control else 0.2)
            self._gimbal_stand_in.report()


async def main(config_file: Path) -> None:
    """Run until SIGTERM."""
    config = checked_config(config_file, os.environ)
    configure_logs("error", "json")
    clock = SystemClock()
    vehicle = StandIn(config, clock=clock)
    daemon = Daemon(config, clock=clock, reload=lambda: config, notifier=SystemdNotifier(), vehicle=vehicle)
    await daemon.run()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))
