"""Missions on every kind of simulated camera, over real UDP and MAVSDK: nothing that is accepted may be untrue.

`PANOEXEC_ALL_FAULTS=1` flies one mission for every kind and its variants instead of a few.
"""

from __future__ import annotations

import asyncio
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink")

from panoexec.dryrun.run import DryRunOptions, DryRunSummary, run_dry_run
from panoexec.mission.log.events import Event, Warned
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.sim import settings as sim_settings
from panoexec.sim.camera_kinds import CAMERA_KINDS, with_camera_kind
from panoexec.sim.config import AirframeConfig, CameraConfig, SimConfig
from tests.support.truth import read_truth, untruths

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


def warned(flown: Flown, code: str) -> list[str]:
    return [event.text for event in flown.events if isinstance(event, Warned) and event.code == code]


EXPECTED = {
    # kind, changes: rejections at most, warnings
    ("mavlink",): (0, ()),
    ("servo",): (0, ()),
    ("late",): (2, ("latency",)),
    ("late", "camera.latency_s=2.4"): (2, ("latency",)),
    ("late-and-irregular",): (6, ("latency",)),
    ("late-and-irregular", "camera.latency_jitter_s=0.6"): (6, ("latency",)),
    ("deferred",): (0, ("interval",)),
    ("deferred", "camera.trigger_min_s=4"): (0, ("interval",)),
    ("deferred-failed",): (0, ("interval",)),
    ("deferred-failed", "camera.trigger_min_s=1.6"): (0, ("interval",)),
    ("deferred-untold",): (0, ("interval",)),
    ("deferred-untold", "camera.trigger_min_s=4"): (0, ("interval",)),
    ("queue",): (4, ("latency",)),
    ("queue", "camera.interval_s=4", "camera.queue=1"): (8, ()),
    ("slow",): (8, ("interval",)),
    ("slow", "camera.interval_s=4"): (9, ("interval",)),
    ("video-mode",): (0, ()),
    ("streamer",): (0, ()),
    ("streamer", "camera.latency_s=0.5"): (2, ("latency",)),
    ("two-cameras",): (0, ()),
    ("two-cameras", "camera.starts_in_video=true"): (0, ()),
    ("px4-trigger",): (0, ()),
    ("px4-trigger", "camera.exposure_s=0.005"): (0, ()),
    ("silent-third",): (4, ()),
    ("silent-third", "camera.silent_every=2"): (8, ()),
    ("index-reset",): (2, ()),
    ("index-reset", "camera.reset_after=1"): (2, ()),
    ("undated",): (2, ()),
    ("undated", "camera.latency_s=1"): (2, ()),
}
"""What a mission on each kind, and on a variant of it, may cost; photos that are late once are taken again."""
SHORT = (("deferred-failed",), ("silent-third",))
"""What the suite flies; PANOEXEC_ALL_FAULTS=1 flies all."""
ALL = "PANOEXEC_ALL_FAULTS" in os.environ


@pytest.mark.parametrize("case", EXPECTED if ALL else SHORT, ids=" ".join)
async def test_a_mission_on_each_kind_accepts_nothing_untrue(tmp_path: Path, case: tuple[str, ...]) -> None:
    kind, *changes = case
    flown = await fly(tmp_path, kind, *changes)
    assert (flown.summary.state, flown.summary.missing) == ("complete", ())
    most, codes = EXPECTED[case]
    assert sum(flown.rejected.values()) <= most, flown.rejected
    for code in codes:
        assert len(warned(flown, code)) >= 1
    if "deferred" in kind:  # each trigger took its photo, whose pose was held until then
        exposures = read_truth(flown.summary.directory / "images" / "truth.jsonl")
        assert len(exposures) == flown.summary.attempts == SHOTS


async def test_a_camera_that_stays_in_video_mode_fails_the_preflight(tmp_path: Path) -> None:
    flown = await fly(tmp_path, "video-locked")
    assert flown.summary.state == "failed"
    assert "the camera is in video mode and stays there: changing its mode (530): denied" in flown.summary.reason
    assert flown.summary.attempts == 0


def test_every_kind_is_flown() -> None:
    assert {case[0] for case in EXPECTED} | {"video-locked"} == set(CAMERA_KINDS)
