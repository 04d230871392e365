"""A process that flies a mission as the daemon does, on fakes in virtual time, and is killed near its end.

Arguments: storage, name of the event after which, seconds until SIGKILL.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import threading
from pathlib import Path

import structlog

from panoexec.daemon.missions import Missions
from panoexec.inputs.config import Config
from panoexec.inputs.service_sections import StorageSection
from panoexec.mission.log.events import Event
from panoexec.store.session import Devices, StoredMission, create_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world


class _Killer:
    """An event sink that has the process killed some time after an event."""

    def __init__(self, event: str, delay_s: float) -> None:
        self._event, self._delay_s = event, delay_s

    def publish(self, event: Event) -> None:
        """See `EventSink.publish`."""
        if event.type == self._event:
            threading.Timer(self._delay_s, os.kill, (os.getpid(), signal.SIGKILL)).start()


def the_missions(storage: Path, world: World, sink: object) -> Missions:
    """The daemon's missions, as far as a storage and devices determine them."""
    config = Config(storage=StorageSection(path=storage, min_free_mb=1))
    return Missions(config=lambda: config, clock=world.clock, sink=sink, changed=lambda: None)  # type: ignore[arg-type]


async def fly(missions: Missions, stored: StoredMission, world: World) -> None:
    """Fly a mission to its end, its files included."""
    devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
    await missions._flown(stored, devices, "north")
    await missions._leave(stored)


async def _main(storage: Path, killer: _Killer) -> None:
    async with a_world() as world:
        stored = await create_mission(storage, plan=world.plan, settings=world.settings, now_utc_s=world.clock.time())
        await fly(the_missions(storage, world, killer), stored, world)
        await asyncio.to_thread(signal.pause)


def main() -> None:
    """See the module."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    storage, event, delay_s = sys.argv[1:]
    run_virtual(_main(Path(storage), _Killer(event, float(delay_s))))


if __name__ == "__main__":
    main()
