"""What a run of the simulated vehicle tells its caller: how to connect to it, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from panoexec.sim.config import DEFAULT_PORTS, SimConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """The vehicle is ready: how to connect to it.

    Attributes:
        config: the vehicle.
        camera_port: TCP port of a tethered camera, 0 without one.
    """

    config: SimConfig
    camera_port: int = 0

    @property
    def port(self) -> int:
        """The first port that is bound or sent to."""
        return self.config.port or DEFAULT_PORTS[0]

    @property
    def connect(self) -> str:
        """The connection URL for MAVSDK."""
        if self.config.listen:
            return f"udpout://{self.config.host}:{self.port}"
        return f"udpin://0.0.0.0:{self.port}"

    def document(self) -> dict[str, Any]:
        """As a JSON object."""
        c = self.config
        return {
            "ready": True,
            "connect": None if c.attach_url else self.connect,
            "attached": c.attach_url,
            "autopilot": c.autopilot,
            "system_id": c.system_id,
            "speedup": c.speedup,
            "seed": c.seed,
            "camera": f"ptpip:127.0.0.1:{self.camera_port}:{self.camera_port}" if self.camera_port else None,
            "output": str(c.output.absolute()) if c.output else None,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Results of a run.

    Attributes:
        photos: number of exposures.
        written: number of JPEGs on disk.
        failures: one line for each photo that could not be written.
        simulated_s: simulated duration.
        latest_s: largest lag in wall time.
        interrupted: ended by Ctrl-C.
    """

    photos: int
    written: int
    failures: tuple[str, ...]
    simulated_s: float
    latest_s: float
    interrupted: bool
