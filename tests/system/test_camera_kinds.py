"""Missions on every kind of simulated camera, over real UDP and MAVSDK: nothing that is accepted may be untrue."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink")

from panoexec.dryrun.run import DryRunOptions, DryRunSummary, run_dry_run
from panoexec.mission.log.events import Event
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.sim import settings as sim_settings
from panoexec.sim.camera_kinds import CAMERA_KINDS, with_camera_kind
from panoexec.sim.config import AirframeConfig, CameraConfig, SimConfig
from tests.support.truth import untruths

TOLERANCE = Tolerance(pitch_deg=0.25, roll_deg=0.25, yaw_deg=1.0)
SHOTS = 7


def _plan(count: int) -> Plan:
    shots = tuple(Shot(index=i, row=0, pitch_deg=-25.0, yaw_deg=-180.0 + 360.0 * i / count) for i in range(count))
    return Plan(
        method="certified",
        camera=CameraConfig().optics,
        constraints=Constraints(
            overlap_h=0.1,
            overlap_v=0.1,
            band=Band(elevation_min_deg=-30.0, elevation_max_deg=-20.0),
            tolerance=TOLERANCE,
        ),
        shots=shots,
    )


def options(storage: Path, kind: str, *changes: str, seed: int = 1, **settings: Any) -> DryRunOptions:
    """A ring of shots on a vehicle with that camera, whose figures the mission does not know."""
    config = SimConfig(
        autopilot=CAMERA_KINDS[kind].autopilot or "ardupilot",  # type: ignore[arg-type]
        speedup=20.0,
        seed=seed,
        camera=CameraConfig(interval_s=1.0, render_width_px=64),
        airframe=AirframeConfig(wind_m_s=1.0),
    )
    config = sim_settings.changed(with_camera_kind(config, kind), changes)
    return DryRunOptions(
        plan=_plan(SHOTS),
        settings=MissionSettings(
            tolerance=TOLERANCE,
            exposure_s=0.01,
            interval_s=1.0,
            max_rate_deg_s=4.0,
            max_pause_s=15.0,
            guards=GuardSettings(allowed_modes=("OFFBOARD", "HOLD"), position_drift_m=20.0, attitude_silence_s=1.5),
            **settings,
        ),
        simulation=config,
        storage=storage,
        images=True,
    )


@dataclass
class Flown:
    summary: DryRunSummary
    events: list[Event]

    @property
    def rejected(self) -> dict[str, int]:
        return dict(self.summary.rejected)


async def fly(storage: Path, kind: str, *changes: str, **more: Any) -> Flown:
    """Fly it to its end; whatever was accepted must be true."""
    events: list[Event] = []
    async with asyncio.timeout(120):
        summary = await run_dry_run(options(storage, kind, *changes, **more), on_event=events.append)
    assert untruths(summary.directory) == []
    return Flown(summary, events)
