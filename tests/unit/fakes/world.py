"""A whole mission on fakes: devices, journal, sink and the harness that runs it in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from panoexec.angles import FloatArray
from panoexec.mission.executor import Mission
from panoexec.mission.log.events import Event
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.optics import Camera
from panoexec.planning.model import Band, Certificate, Constraints, Plan, Shot, Tolerance
from tests.unit.fakes.camera import FakeCamera
from tests.unit.fakes.gimbal import FakeGimbal
from tests.unit.fakes.vehicle import FakeVehicle
from tests.unit.fakes.virtual import VirtualClock

TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.5)


def a_plan(count: int = 4, *, pitch_deg: float = -20.0) -> Plan:
    """A row of shots all round."""
    shots = tuple(Shot(index=i, row=0, pitch_deg=pitch_deg, yaw_deg=-180.0 + 360.0 * i / count) for i in range(count))
    band = Band(elevation_min_deg=-40.0, elevation_max_deg=0.0)
    return Plan(
        method="certified",
        camera=Camera.from_fov(60.0, 45.0),
        constraints=Constraints(overlap_h=0.15, overlap_v=0.15, band=band, tolerance=TOLERANCE),
        shots=shots,
    )


def a_certificate(*, certified: bool, images: int) -> Certificate:
    return Certificate(
        certified=certified,
        images=images,
        min_overlap_h=None,
        min_overlap_v=None,
        worst_overlap_h=None,
        worst_overlap_v=None,
        uncovered_fraction=0.0 if certified else 0.1,
        connected=True,
        two_edge_connected=True,
    )


@dataclass
class FakeVerifier:
    """Certifies when enough images are there."""

    needed: int = 4
    holes: tuple[Any, ...] = ()
    patches: list[Shot] = field(default_factory=list)

    async def certify(self, rotations: FloatArray, rows: Sequence[int]) -> Certificate:
        enough = len(rotations) >= self.needed
        return replace(a_certificate(certified=enough, images=len(rotations)), holes=() if enough else self.holes)

    async def patch(self, rotations: FloatArray, rows: Sequence[int]) -> Sequence[Shot]:
        out, self.patches = self.patches, []
        return out


@dataclass
class MemoryJournal:
    """Keeps events in memory, after a delay as a disk has."""

    clock: VirtualClock
    delay_s: float = 0.005
    events: list[Event] = field(default_factory=list)

    async def append(self, events: Sequence[Event]) -> None:
        await self.clock.sleep(self.delay_s)
        self.events.extend(events)


@dataclass
class ListSink:
    """Keeps what was announced."""

    events: list[Event] = field(default_factory=list)

    def publish(self, event: Event) -> None:
        self.events.append(event)

    def of(self, kind: type[Event]) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]


@dataclass
class World:
    """Everything around a mission."""

    clock: VirtualClock
    gimbal: FakeGimbal
    camera: FakeCamera
    vehicle: FakeVehicle
    journal: MemoryJournal
    sink: ListSink
    verifier: FakeVerifier
    plan: Plan
    settings: MissionSettings
    record: MissionRecord = field(init=False)

    def record_of_journal(self) -> MissionRecord:
        """What another process would know of the mission."""
        return MissionRecord.from_events(mission_id="m1", shots=self.plan.shots, events=self.journal.events)

    def mission(self, *, past: Sequence[Event] = (), **more: Any) -> Mission:
        return Mission(
            mission_id="m1",
            plan=self.plan,
            settings=self.settings,
            gimbal=self.gimbal,
            camera=self.camera,
            vehicle=self.vehicle,
            clock=self.clock,
            journal=self.journal,
            sink=self.sink,
            verifier=self.verifier,
            past=past,
            **more,
        )


def some_settings(**changes: Any) -> MissionSettings:
    defaults: dict[str, Any] = {
        "tolerance": TOLERANCE,
        "settle_s": 0.2,
        "interval_s": 0.5,
        "patience_s": 1.0,
        "max_pause_s": 30.0,
        "guards": GuardSettings(allowed_modes=("OFFBOARD", "HOLD")),
    }
    return MissionSettings(**(defaults | changes))


@asynccontextmanager
async def a_world(
    *, plan: Plan | None = None, settings: MissionSettings | None = None, **gimbal: Any
) -> AsyncIterator[World]:
    """Devices that stream while the block runs."""
    clock = VirtualClock()
    plan = plan or a_plan()
    world = World(
        clock=clock,
        gimbal=FakeGimbal(clock=clock, **gimbal),
        camera=FakeCamera(clock=clock),
        vehicle=FakeVehicle(clock=clock),
        journal=MemoryJournal(clock=clock),
        sink=ListSink(),
        verifier=FakeVerifier(needed=len(plan.shots)),
        plan=plan,
        settings=settings or some_settings(),
    )
    async with asyncio.TaskGroup() as group:
        streaming = group.create_task(world.gimbal.stream(), name="fake gimbal")
        telling: asyncio.Task[None] | None = None
        if world.settings.gimbal.turning is not None:
            world.gimbal.nose = world.vehicle.heading
            telling = group.create_task(world.vehicle.tell(), name="fake vehicle")
        try:
            await clock.sleep(0.1)
            yield world
        finally:
            streaming.cancel()
            if telling is not None:
                telling.cancel()
