"""Missions on every kind of simulated payload, over real UDP and MAVSDK, held against the simulator's truth.

`missions()` gives combinations of a kind of camera, a kind of gimbal and a fault, in an order drawn from a seed: first
so many that each kind and fault has met each other one, then all that are left.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from panoexec.dryrun.run import DryRunOptions, DryRunSummary, run_dry_run
from panoexec.mission.log.events import Event, Warned
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.sim import settings as sim_settings
from panoexec.sim.camera_kinds import CAMERA_KINDS, with_camera_kind
from panoexec.sim.config import AirframeConfig, CameraConfig, SimConfig
from panoexec.sim.faults import parse_fault
from panoexec.sim.gimbal_kinds import GIMBAL_KINDS, with_gimbal_kind
from tests.support.truth import untruths

SHOTS: Final = 7
TOLERANCE: Final = Tolerance(pitch_deg=0.25, roll_deg=0.25, yaw_deg=1.0)
WIDE: Final = Tolerance(pitch_deg=1.0, roll_deg=1.0, yaw_deg=2.0)
NO_FAULT: Final = ""

FAULT_ENDS: Final[Mapping[str, str]] = {
    "link-loss=3+5": "complete",
    "reboot=4": "failed",
    "attitude-stop=3+4": "complete",
    "attitude-frozen=3+4": "complete",
    "attitude-late=3+8": "complete",
    "attitude-nan=3+4": "complete",
    "gimbal-stuck=3+6": "complete",
    "gimbal-slow=3+10": "complete",
    "drift=0.4": "complete",
    "control-stolen=4": "complete",
    "mode-change=4": "failed",
    "photo-lost=#2,#3": "complete",
    "photo-refused=#2,#3": "complete",
    "capture-lost=#2,#3": "complete",
    "capture-twice=#2,#3": "complete",
    "storage-full=4+6": "complete",
    "gps-lost=4+5": "complete",
    "rtl=4": "failed",
    "battery-low=4": "failed",
    "gust=3+6": "complete",
    "clock-jump=4": "complete",
}
"""How a mission with the usual camera and gimbal ends under each fault."""
CONTENT_FAULT_ENDS: Final[Mapping[str, str]] = {
    "photo-black=#2": "complete",
    "photo-dark=#2": "complete",
    "photo-blur=#2": "complete",
    "photo-defocus=#2": "complete",
    "photo-truncated=#2": "complete",
    "photo-damaged=#2": "complete",
    "photo-swapped=#2": "complete",
    "photo-stale=#2": "complete",
    "attitude-lie=#2": "complete",
}
"""The same for faults that only the content of photos can show."""
REFUSED_GIMBALS: Final = frozenset({"echo", "echo-untold", "echo-device", "servo"})
"""Gimbals that measure nothing: no photo is accepted."""
REFUSED_CAMERAS: Final = frozenset({"video-locked"})


def ring(tolerance: Tolerance = TOLERANCE, count: int = SHOTS) -> Plan:
    """A row of shots all around."""
    shots = tuple(Shot(index=i, row=0, pitch_deg=-25.0, yaw_deg=-180.0 + 360.0 * i / count) for i in range(count))
    return Plan(
        method="certified",
        camera=CameraConfig().optics,
        constraints=Constraints(
            overlap_h=0.1,
            overlap_v=0.1,
            band=Band(elevation_min_deg=-30.0, elevation_max_deg=-20.0),
            tolerance=tolerance,
        ),
        shots=shots,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Payload:
    """What is flown.

    Attributes:
        camera, gimbal: kinds of the simulator.
        fault: of the simulator; "" for none.
        autopilot: "" for the one that the kinds need, or ArduPilot.
        seed: of the simulation.
        changes: as `--set`.
    """

    camera: str = "mavlink"
    gimbal: str = "mavlink"
    fault: str = NO_FAULT
    autopilot: str = ""
    seed: int = 1
    changes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """For the name of a test."""
        return " ".join(part for part in (self.camera, self.gimbal, self.fault, self.autopilot, *self.changes) if part)

    @property
    def tolerance(self) -> Tolerance:
        """One that the gimbal can hold."""
        return WIDE if self.gimbal == "siyi" else TOLERANCE

    @property
    def needs(self) -> set[str]:
        """Autopilots that the kinds need."""
        wanted = {CAMERA_KINDS[self.camera].autopilot, GIMBAL_KINDS[self.gimbal].autopilot, self.autopilot}
        return wanted - {""}

    @property
    def end(self) -> str:
        """How its mission ends."""
        if self.gimbal in REFUSED_GIMBALS or self.camera in REFUSED_CAMERAS:
            return "failed"
        return FAULT_ENDS.get(self.fault, "complete")


def options(storage: Path, payload: Payload, **settings: Any) -> DryRunOptions:
    """A ring of shots on a vehicle with that payload, whose figures the mission does not know."""
    (autopilot,) = payload.needs or {"ardupilot"}
    config = SimConfig(
        autopilot=autopilot,  # type: ignore[arg-type]
        speedup=20.0,
        seed=payload.seed,
        faults=(parse_fault(payload.fault),) if payload.fault else (),
        camera=CameraConfig(interval_s=1.0, render_width_px=64),
        airframe=AirframeConfig(wind_m_s=1.0),
    )
    config = with_gimbal_kind(with_camera_kind(config, payload.camera), payload.gimbal)
    guards = GuardSettings(allowed_modes=("OFFBOARD", "HOLD"), position_drift_m=20.0, attitude_silence_s=1.5)
    usual: dict[str, Any] = {
        "tolerance": payload.tolerance,
        "exposure_s": 0.01,
        "interval_s": 1.0,
        "max_rate_deg_s": 4.0,
        "max_pause_s": 15.0,
        "guards": guards,
    }
    return DryRunOptions(
        plan=ring(payload.tolerance),
        settings=MissionSettings(**usual | settings),
        simulation=sim_settings.changed(config, payload.changes),
        storage=storage,
        images=True,
    )


@dataclass
class Flown:
    """A mission that is over, and what of it contradicts the truth."""

    summary: DryRunSummary
    events: list[Event]
    untrue: list[str]

    @property
    def manifest(self) -> dict[str, Any]:
        """As written."""
        return dict(json.loads((self.summary.directory / "manifest.json").read_text(encoding="utf-8")))

    def warned(self, code: str) -> list[str]:
        """Texts of the warnings with that code."""
        return [event.text for event in self.events if isinstance(event, Warned) and event.code == code]


async def fly(storage: Path, payload: Payload, *, timeout_s: float = 300, **settings: Any) -> Flown:
    """Fly a payload's mission to its end."""
    events: list[Event] = []
    async with asyncio.timeout(timeout_s):
        summary = await run_dry_run(options(storage, payload, **settings), on_event=events.append)
    return Flown(summary, events, untruths(summary.directory))


def missions(seed: int) -> Iterator[Payload]:
    """Every combination that makes sense, each once; see the module's docstring."""
    rng = random.Random(seed)
    left = [
        one
        for camera, gimbal, fault in itertools.product(CAMERA_KINDS, GIMBAL_KINDS, (NO_FAULT, *FAULT_ENDS))
        if len((one := Payload(camera=camera, gimbal=gimbal, fault=fault)).needs) <= 1
    ]
    rng.shuffle(left)
    unmet = {pair for one in left for pair in _pairs(one)}
    later = []
    for one in left:  # a single pass covers all pairs, because a pair stays unmet until a combination with it comes
        new = _pairs(one) & unmet
        if len(new) >= 2 or (new and one.fault == NO_FAULT):
            unmet -= new
            yield _seeded(one, rng)
        else:
            later.append(one)
    rest = []
    for one in later:
        new = _pairs(one) & unmet
        unmet -= new
        if new:
            yield _seeded(one, rng)
        else:
            rest.append(one)
    for one in rest:
        yield _seeded(one, rng)


def _seeded(one: Payload, rng: random.Random) -> Payload:
    return Payload(camera=one.camera, gimbal=one.gimbal, fault=one.fault, seed=rng.randrange(1, 1000))


def _pairs(one: Payload) -> set[tuple[str, str]]:
    parts = (f"camera {one.camera}", f"gimbal {one.gimbal}", f"fault {one.fault}")
    return set(itertools.combinations(parts, 2))
