"""The autopilots that a dry-run can start in software (SITL): which one a binary is, and how each is started."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from panoexec.planning.model import Turning
from panoexec.sim.config import SimConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class SitlOptions:
    """How to start the SITL.

    Attributes:
        binary: ArduCopter or PX4, built for SITL.
        ground_port: UDP port on this machine that the autopilot sends to, for the ground station.
        payload_port: UDP port on this machine that the autopilot sends to, for the payload.
        speedup: simulated seconds per second.
        home: latitude and longitude in degrees, altitude above mean sea level in metres, heading in degrees.
        parameters: autopilot parameters in addition to the firmware's own.
        station_port: UDP port on this machine that the autopilot sends to, for another ground station; None: no link.
    """

    binary: Path
    ground_port: int
    payload_port: int
    speedup: float
    home: tuple[float, float, float, float]
    parameters: Mapping[str, float]
    station_port: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Launch:
    """A process to start in its own directory.

    Attributes:
        command: program and arguments.
        environment: variables in addition to the inherited ones.
        leaves: files outside its directory that a killed process leaves behind.
    """

    command: tuple[str, ...]
    environment: dict[str, str] = field(default_factory=dict)
    leaves: tuple[Path, ...] = ()


class Firmware(Protocol):
    """An autopilot's software.

    Attributes:
        kind: as `SimConfig.autopilot` names it.
        name: for messages.
        may_slow: its speed-up can be changed while it runs.
        turning: how it turns the vehicle with its default parameters.
    """

    kind: str
    name: str
    may_slow: bool
    turning: Turning

    def launch(self, folder: Path, options: SitlOptions) -> Launch:
        """Write what the process needs into its directory; returns how to start it there."""
        ...

    def parameters(self, simulation: SimConfig) -> dict[str, float]:
        """The autopilot's parameters for the wind and the payload of a simulation.

        Raises:
            UsageError: the simulation is not available with this autopilot.
        """
        ...
