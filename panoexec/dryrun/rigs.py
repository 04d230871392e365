"""What a dry-run is flown on: each kind of vehicle is started, joined to its payload, watched and ended alike."""

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
from panoexec.dryrun.autopilot import SitlOptions, free_udp_ports, running_sitl
from panoexec.dryrun.lockstep import Allow
from panoexec.errors import DeviceError, PanoexecError, UsageError
from panoexec.sim.config import SimConfig
from panoexec.sim.faults import AUTOPILOT_FAULTS
from panoexec.sim.process import SimulatorProcess, running_simulator

Note = Callable[[str], None]
HOST = "127.0.0.1"
SHUTTER_OUTPUT = 9
"""The autopilot's output that a camera on a servo hangs on; the motors have the first ones."""
_CAMERA_FAULTS = frozenset({"photo-lost", "photo-refused", "capture-lost", "capture-twice", "storage-full"})
"""What a camera can do wrong that speaks for itself."""
FULL_WIND_M = 25
"""Height from which on the wind is as strong as it was asked to be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """A vehicle that runs and can be connected to.

    Attributes:
        connection: for `MavsdkLink`.
        must_fly: it stands on the ground and is ours to arm, take off and land.
        may_stand: it is not ours; a mission may be flown on it while it stands on a bench.
        allow: lets its time go on, for `Lockstep`; None: it goes on by itself.
        may_slow: it can be asked for another speed (`SIM_SPEEDUP`).
        about: for the manifest.
    """

    connection: str
    must_fly: bool = False
    may_stand: bool = False
    allow: Allow | None = None
    may_slow: bool = False
    about: dict[str, Any]


class VehicleUnderTest(Protocol):
    """A vehicle that a dry-run can be flown on."""

    @property
    def speedup(self) -> float:
        """Its seconds a second."""
        ...

    def clock(self) -> Clock:
        """A clock for the mission that is flown on it."""
        ...

    def running(self, *, images: Path | None, note: Note) -> AbstractAsyncContextManager[Rig]:
        """It runs while the block does, which is cancelled when a part of it dies.

        Args:
            images: where its camera puts photos; None for none.
            note: takes what there is to say to people, line by line.

        Raises:
            UsageError: it cannot be started as it was described.
            LinkError: a port is in use, or nobody answers.
            DeviceError: it did not start, or died.
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
            yield Rig(connection=f"udpin://{HOST}:{port}", allow=simulator.allow, about=about)


@dataclass(frozen=True, slots=True, kw_only=True)
class SitlVehicle:
    """ArduCopter's own software (SITL), with our payload on its second serial port; must be flown.

    Attributes:
        binary: from `sitl_binary`.
        simulation: payload, wind, home, seed, speed-up; what it says of the embedded autopilot does not count.
    """

    binary: Path
    simulation: SimConfig

    def __post_init__(self) -> None:
        """Refuse what a real autopilot cannot be told.

        Raises:
            UsageError: naming it.
        """
        check_payload_only(self.simulation, option="--sitl")

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
        payload = replace(self.simulation, attach_url=f"udpin:{HOST}:{payload_port}", output=images)
        airframe = self.simulation.airframe
        options = SitlOptions(
            binary=self.binary,
            ground_port=ground_port,
            payload_port=payload_port,
            speedup=self.speedup,
            home=(airframe.latitude_deg, airframe.longitude_deg, airframe.home_altitude_m, airframe.heading_deg),
            parameters=wind_parameters(self.simulation) | payload_parameters(self.simulation),
        )
        about = {"autopilot": "ardupilot", "simulated": "sitl", "binary": str(self.binary), "seed": payload.seed}
        async with (
            running_simulator(payload, note=note) as simulator,
            running_sitl(options) as sitl,
            _watching(_watch(simulator), sitl.watch()),
        ):
            yield Rig(connection=f"udpin://{HOST}:{ground_port}", must_fly=True, may_slow=True, about=about)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectedVehicle:
    """A vehicle that runs already: somebody else's SITL, or one on a bench. It is never armed and never flown.

    Attributes:
        connection: as MAVSDK writes it.
        simulation: speed-up (the vehicle's own); with an `attach_url` our payload joins the autopilot there.
    """

    connection: str
    simulation: SimConfig

    def __post_init__(self) -> None:
        """Refuse what a real autopilot cannot be told, and a connection that is none.

        Raises:
            UsageError: naming it.
        """
        parse_connection(self.connection)
        check_payload_only(self.simulation, option="--sitl-connect")
        if self.simulation.faults and self.simulation.attach_url is None:
            name = self.simulation.faults[0].name
            raise UsageError(f"--fault {name}: --sitl-connect without --attach has nothing simulated that could fail")

    @property
    def speedup(self) -> float:
        """See `VehicleUnderTest.speedup`."""
        return self.simulation.speedup

    def clock(self) -> Clock:
        """See `VehicleUnderTest.clock`."""
        # a vehicle on a bench has real time, and may have nobody who tells it
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
            yield replace(rig, about=rig.about | {"simulated": "payload", "seed": payload.seed})


def wind_parameters(simulation: SimConfig) -> dict[str, float]:
    """SITL's parameters for the wind: gusting about its mean by an eighth of it, less near the ground.

    With the same wind down to the ground ArduCopter, which leans against it, does not believe that it has landed
    (measured: 8 m/s).
    """
    airframe = simulation.airframe
    return {
        "SIM_WIND_T": 0,  # with the square root of the height, up to SIM_WIND_T_ALT
        "SIM_WIND_T_ALT": FULL_WIND_M,
        "SIM_WIND_SPD": airframe.wind_m_s,
        "SIM_WIND_DIR": airframe.wind_from_deg,
        "SIM_WIND_TURB": airframe.wind_m_s / 8,
    }


def payload_parameters(simulation: SimConfig) -> dict[str, float]:
    """What the autopilot must know of the payload, where it is not the usual one.

    A pan range of 0 to 0 tells ArduPilot that the mount has two axes. A camera on a servo is triggered by an output of
    the autopilot, and reported by it (CAMERA_FEEDBACK) and nobody else.
    """
    gimbal = simulation.gimbal
    parameters: dict[str, float] = {}
    if not gimbal.yaw_endless:
        parameters |= {"MNT1_YAW_MIN": gimbal.yaw.min_deg, "MNT1_YAW_MAX": gimbal.yaw.max_deg}
    if simulation.camera_kind == "servo":
        parameters |= {"CAM1_TYPE": 1.0, f"SERVO{SHUTTER_OUTPUT}_FUNCTION": 10.0}
    return parameters


def check_payload_only(simulation: SimConfig, *, option: str) -> None:
    """Refuse settings of the simulated autopilot where there is a real one.

    Raises:
        UsageError: naming option and setting.
    """
    for spec in simulation.faults:
        if spec.name in AUTOPILOT_FAULTS:
            raise UsageError(f"--fault {spec.name}: only the embedded autopilot has it, not that of {option}")
        if spec.name in _CAMERA_FAULTS and simulation.camera_kind == "servo":
            raise UsageError(
                f"--fault {spec.name}: with --trigger servo the autopilot of {option} speaks for the camera"
            )
    if simulation.autopilot != "ardupilot":
        raise UsageError(f"--autopilot {simulation.autopilot}: {option} is an ArduPilot")
    if simulation.mount != "mavlink":
        raise UsageError(f"--mount {simulation.mount} is of the embedded autopilot, not of {option}")


async def _watch(simulator: SimulatorProcess) -> None:
    code = await simulator.wait()
    raise DeviceError(f"the simulated payload has ended by itself (exit code {code})")


@contextlib.asynccontextmanager
async def _watching(*watches: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Run the block beside watches that raise when something dies; the block is cancelled then."""
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(watch, name="rig watch") for watch in watches]
            yield
            for task in tasks:
                task.cancel()
    except BaseExceptionGroup as failures:
        raise _plain(failures) from None


def _plain(failures: BaseExceptionGroup[BaseException]) -> BaseException:
    """The one failure to tell of: the first of ours; else the first."""
    known, _ = failures.split(PanoexecError)
    group: BaseExceptionGroup[BaseException] = known or failures
    first: BaseException = group
    while isinstance(first, BaseExceptionGroup):
        first = first.exceptions[0]
    return first
