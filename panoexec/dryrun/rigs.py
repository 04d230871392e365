"""Vehicles for dry-runs: each kind is started, joined to its payload, monitored and stopped in the same way."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from panoexec.adapters.link.connection_url import parse_connection
from panoexec.clock import Clock, SystemClock, VehicleClock
from panoexec.dryrun.autopilot import firmware_of, running_sitl
from panoexec.dryrun.firmware import Firmware, SitlOptions
from panoexec.dryrun.lockstep import Allow
from panoexec.errors import DeviceError, PanoexecError, UsageError
from panoexec.sim.config import SimConfig
from panoexec.sim.faults import AUTOPILOT_FAULTS
from panoexec.sim.ports import free_udp_ports
from panoexec.sim.process import SimulatorProcess, running_simulator

Note = Callable[[str], None]
HOST = "127.0.0.1"
SIMULATED_SYSTEM = 1
"""MAVLink system id of the embedded vehicle, and of an autopilot in SITL as a dry-run starts it."""
_CAMERA_FAULTS = frozenset({"photo-lost", "photo-refused", "capture-lost", "capture-twice", "storage-full"})
"""Faults of a camera that sends its own messages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """A running vehicle to connect to.

    Attributes:
        connection: for `MavsdkLink`.
        system_id: MAVLink system id of the vehicle; None if it is not known.
        must_fly: it is on the ground and must be armed, flown and landed by the dry-run.
        may_stand: it is not controlled by the dry-run; a mission may be run on it on the ground.
        camera: `[camera] port` of a tethered camera; "" for a camera on MAVLink.
        allow: sets the limits of its time, for `Lockstep`; None: its time cannot be controlled.
        may_slow: its speed-up can be changed (`SIM_SPEEDUP`).
        about: description for the manifest.
    """

    connection: str
    system_id: int | None = None
    must_fly: bool = False
    may_stand: bool = False
    camera: str = ""
    allow: Allow | None = None
    may_slow: bool = False
    about: dict[str, Any]


class VehicleUnderTest(Protocol):
    """A vehicle for a dry-run."""

    @property
    def speedup(self) -> float:
        """Its speed-up, simulated seconds per second."""
        ...

    def clock(self) -> Clock:
        """A clock for a mission on this vehicle."""
        ...

    def running(self, *, images: Path | None, note: Note) -> AbstractAsyncContextManager[Rig]:
        """Run the vehicle while the block runs; the block is cancelled when a part of the vehicle fails.

        Args:
            images: directory for its camera's photos; None for no photos.
            note: receives messages for display, line by line.

        Raises:
            UsageError: its options are invalid.
            LinkError: a port is in use, or the autopilot does not respond.
            DeviceError: it did not start, or exited.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class EmbeddedVehicle:
    """The simulated vehicle of `panoexec.sim`, autopilot included; it hovers from the start."""

    simulation: SimConfig

    @property
    def speedup(self) -> float:
        """See `VehicleUnderTest.speedup`."""
        return self.simulation.speedup

    def clock(self) -> Clock:
        """See `VehicleUnderTest.clock`."""
        return VehicleClock()

    @contextlib.asynccontextmanager
    async def running(self, *, images: Path | None, note: Note) -> AsyncIterator[Rig]:
        """See `VehicleUnderTest.running`."""
        (port,) = free_udp_ports(1)
        config = replace(self.simulation, host=HOST, port=port, listen=False, attach_url=None, output=images)
        about = {"autopilot": config.autopilot, "simulated": "embedded", "seed": config.seed}
        async with running_simulator(config, note=note, paced=True) as simulator, _watching(_watch(simulator)):
            connection = f"udpin://{HOST}:{port}"
            yield Rig(
                connection=connection,
                system_id=SIMULATED_SYSTEM,
                camera=simulator.ready.get("camera") or "",
                allow=simulator.allow,
                about=about,
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class SitlVehicle:
    """ArduCopter or PX4 in SITL with our payload on its second MAVLink port; it must be flown.

    Attributes:
        binary: from `sitl_binary`.
        simulation: payload, wind, home, seed, speed-up; settings of the embedded autopilot are ignored.
        station_port: local UDP port of another ground station, to which the autopilot sends too; None: there is none.
    """

    binary: Path
    simulation: SimConfig
    station_port: int | None = None

    def __post_init__(self) -> None:
        """Reject settings that a real autopilot does not support.

        Raises:
            UsageError: names the setting.
        """
        check_payload_only(self.simulation, option="--sitl")
        self.firmware.parameters(self.simulation)

    @property
    def firmware(self) -> Firmware:
        """The autopilot that the binary is."""
        return firmware_of(self.binary)

    @property
    def speedup(self) -> float:
        """See `VehicleUnderTest.speedup`."""
        return self.simulation.speedup

    def clock(self) -> Clock:
        """See `VehicleUnderTest.clock`."""
        return VehicleClock()

    @contextlib.asynccontextmanager
    async def running(self, *, images: Path | None, note: Note) -> AsyncIterator[Rig]:
        """See `VehicleUnderTest.running`."""
        ground_port, payload_port = free_udp_ports(2)
        firmware = self.firmware
        payload = replace(self.simulation, attach_url=f"udpin:{HOST}:{payload_port}", output=images)
        airframe = self.simulation.airframe
        options = SitlOptions(
            binary=self.binary,
            ground_port=ground_port,
            payload_port=payload_port,
            speedup=self.speedup,
            home=(airframe.latitude_deg, airframe.longitude_deg, airframe.home_altitude_m, airframe.heading_deg),
            parameters=firmware.parameters(self.simulation),
            station_port=self.station_port,
        )
        about = {"autopilot": firmware.kind, "simulated": "sitl", "binary": str(self.binary), "seed": payload.seed}
        async with (
            running_simulator(payload, note=note) as simulator,
            running_sitl(options) as sitl,
            _watching(_watch(simulator), sitl.watch()),
        ):
            yield Rig(
                connection=f"udpin://{HOST}:{ground_port}",
                system_id=SIMULATED_SYSTEM,
                must_fly=True,
                camera=simulator.ready.get("camera") or "",
                may_slow=firmware.may_slow,
                about=about,
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectedVehicle:
    """A vehicle that is already running: an external SITL, or one on a bench. It is never armed nor flown.

    Attributes:
        connection: MAVSDK connection string.
        simulation: speed-up (that of the vehicle); with an `attach_url` our payload joins the autopilot there.
    """

    connection: str
    simulation: SimConfig

    def __post_init__(self) -> None:
        """Reject settings that a real autopilot does not support, and invalid connection strings.

        Raises:
            UsageError: names the setting.
        """
        parse_connection(self.connection)
        check_payload_only(self.simulation, option="--sitl-connect")
        if self.simulation.faults and self.simulation.attach_url is None:
            name = self.simulation.faults[0].name
            raise UsageError(f"--fault {name}: not available with --sitl-connect without --attach (nothing simulated)")

    @property
    def speedup(self) -> float:
        """See `VehicleUnderTest.speedup`."""
        return self.simulation.speedup

    def clock(self) -> Clock:
        """See `VehicleUnderTest.clock`."""
        # a vehicle on a bench runs in real time, and may not send SYSTEM_TIME
        return SystemClock() if self.speedup == 1 else VehicleClock()

    @contextlib.asynccontextmanager
    async def running(self, *, images: Path | None, note: Note) -> AsyncIterator[Rig]:
        """See `VehicleUnderTest.running`."""
        rig = Rig(connection=self.connection, may_stand=True, about={"connection": self.connection, "simulated": False})
        if self.simulation.attach_url is None:
            yield rig
            return
        payload = replace(self.simulation, output=images)
        async with running_simulator(payload, note=note) as simulator, _watching(_watch(simulator)):
            camera = simulator.ready.get("camera") or ""
            yield replace(rig, camera=camera, about=rig.about | {"simulated": "payload", "seed": payload.seed})


def check_payload_only(simulation: SimConfig, *, option: str) -> None:
    """Reject settings of the simulated autopilot for a vehicle with a real one.

    Raises:
        UsageError: names option and setting.
    """
    for spec in simulation.faults:
        if spec.name in AUTOPILOT_FAULTS:
            raise UsageError(f"--fault {spec.name}: only available with the embedded autopilot, not with {option}")
        if spec.name in _CAMERA_FAULTS and simulation.camera_kind == "servo":
            raise UsageError(f"--fault {spec.name}: with --trigger servo the autopilot of {option} reports the photos")
    if simulation.autopilot != SimConfig().autopilot:
        raise UsageError(f"--autopilot {simulation.autopilot}: the autopilot of {option} is what it is")
    if simulation.mount != "mavlink":
        raise UsageError(f"--mount {simulation.mount} is only available with the embedded autopilot, not with {option}")


async def _watch(simulator: SimulatorProcess) -> None:
    code = await simulator.wait()
    raise DeviceError(f"the simulated payload exited unexpectedly (exit code {code})")


@contextlib.asynccontextmanager
async def _watching(*watches: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Run the block together with watch coroutines that raise when a process exits; the block is cancelled then."""
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(watch, name="rig watch") for watch in watches]
            yield
            for task in tasks:
                task.cancel()
    except BaseExceptionGroup as failures:
        raise _plain(failures) from None


def _plain(failures: BaseExceptionGroup[BaseException]) -> BaseException:
    """The failure to report: the first PanoexecError, else the first one."""
    known, _ = failures.split(PanoexecError)
    group: BaseExceptionGroup[BaseException] = known or failures
    first: BaseException = group
    while isinstance(first, BaseExceptionGroup):
        first = first.exceptions[0]
    return first
