"""A process that can be killed: devices and journal that do nothing any more for a mission that is dead."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from panoexec.devices import AttitudeFeed, PendingCapture, RecalledPhotos
from panoexec.errors import DeviceError
from panoexec.mission.executor import Mission
from panoexec.mission.log.events import Event
from panoexec.mission.log.record import MissionRecord
from panoexec.planning.model import GimbalLimits
from tests.unit.fakes.world import World


@dataclass
class Process:
    """One life of panoexec around a world."""

    world: World
    dead: bool = False

    def mission(self, past: Sequence[Event] = ()) -> Mission:
        world = self.world
        return Mission(
            mission_id="m1",
            plan=world.plan,
            settings=world.settings,
            gimbal=_Gimbal(self),
            camera=_Camera(self),
            vehicle=world.vehicle,
            clock=world.clock,
            journal=_Journal(self),
            sink=_Sink(self),
            verifier=world.verifier,
            past=past,
        )

    async def kill(self, running: asyncio.Task[MissionRecord]) -> None:
        """Kill -9: from this moment nothing that the mission does has any effect."""
        self.dead = True
        running.cancel()
        await asyncio.wait({running})


class _Gimbal:
    def __init__(self, process: Process) -> None:
        self._process = process
        self._real = process.world.gimbal

    @property
    def feed(self) -> AttitudeFeed:
        return self._real.feed

    @property
    def limits(self) -> GimbalLimits | None:
        return self._real.limits

    @property
    def in_control(self) -> bool:
        return self._real.in_control

    @property
    def controlled_by(self) -> tuple[int, int] | None:
        return self._real.controlled_by

    async def ask_control(self) -> None:
        await self._real.ask_control()

    async def acquire(self) -> None:
        if not self._process.dead:
            await self._real.acquire()

    async def point(self, pitch_deg: float, yaw_deg: float | None) -> None:
        if not self._process.dead:
            await self._real.point(pitch_deg, yaw_deg)

    async def release(self) -> None:
        if not self._process.dead:
            await self._real.release()


class _Camera:
    def __init__(self, process: Process) -> None:
        self._process = process
        self._real = process.world.camera

    @property
    def storage_free_images(self) -> float:
        return self._real.storage_free_images

    @property
    def image_count(self) -> int:
        return self._real.image_count

    async def recall(self) -> RecalledPhotos:
        return await self._real.recall()

    async def trigger(self) -> PendingCapture:
        if self._process.dead:
            raise DeviceError("dead")
        return await self._real.trigger()


class _Journal:
    def __init__(self, process: Process) -> None:
        self._process = process

    async def append(self, events: Sequence[Event]) -> None:
        if not self._process.dead:
            journal = self._process.world.journal
            await journal.clock.sleep(journal.delay_s)
        if not self._process.dead:
            self._process.world.journal.events.extend(events)


class _Sink:
    def __init__(self, process: Process) -> None:
        self._process = process

    def publish(self, event: Event) -> None:
        if not self._process.dead:
            self._process.world.sink.publish(event)
