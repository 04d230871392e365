"""Link gaps in the default configuration: none of them needs a human.

The simulated vehicle loses its link for 0.1 to 120 s (simulated time, log-uniform) at random moments of missions, over
real UDP and MAVSDK. Time runs up to 20 times faster than real time, so that the longest gaps pass every timeout of the
link too, which count real seconds (no heartbeat for 3 s). `PANOEXEC_GAPS=1000` sets how many gaps are flown, from seed
`PANOEXEC_SEED` (0).
"""

from __future__ import annotations

import asyncio
import os
import random
from pathlib import Path

import pytest

pytest.importorskip("pymavlink")

from panoexec.dryrun.run import DryRunOptions, run_dry_run
from panoexec.inputs.vehicle_sections import GimbalSection, GuardsSection
from panoexec.mission.configured_guards import guard_settings
from panoexec.mission.log.events import CommandReceived, Event, MissionPaused, ShotExposed
from panoexec.mission.settings import MissionSettings
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.sim.config import AirframeConfig, CameraConfig, SimConfig
from panoexec.sim.faults import FaultSpec

GAPS = int(os.environ.get("PANOEXEC_GAPS", "4"))
SEED = int(os.environ.get("PANOEXEC_SEED", "0"))
IN_ONE_MISSION = 10 if GAPS > 4 else 4
SHOTS = 8 * IN_ONE_MISSION
APART_S = 5.0
"""From the end of a gap to the next one: at least one shot."""
TOLERANCE = Tolerance(pitch_deg=0.25, roll_deg=0.25, yaw_deg=1.0)


def _gaps(seed: int) -> tuple[tuple[float, float], ...]:
    """Start and end of each gap, seconds after the first photo command."""
    rng = random.Random(seed)
    out, now_s = [], 0.5
    for _ in range(IN_ONE_MISSION):
        start_s = now_s + rng.uniform(0.0, 3.0)
        end_s = start_s + 0.1 * 1200 ** rng.random()
        out.append((start_s, end_s))
        now_s = end_s + APART_S
    return tuple(out)


def _options(storage: Path, spans: tuple[tuple[float, float], ...], *, seed: int) -> DryRunOptions:
    shots = tuple(Shot(index=i, row=0, pitch_deg=-25.0, yaw_deg=-180.0 + 360.0 * i / SHOTS) for i in range(SHOTS))
    plan = Plan(
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
    return DryRunOptions(
        plan=plan,
        settings=MissionSettings(
            tolerance=TOLERANCE,
            exposure_s=0.01,
            max_rate_deg_s=4.0,
            guards=guard_settings(GuardsSection(position_drift_m=20.0), GimbalSection()),
        ),
        simulation=SimConfig(
            speedup=20.0,
            seed=seed,
            faults=(FaultSpec(name="link-loss", size=0.0, spans=spans),),
            camera=CameraConfig(interval_s=1.0, render_width_px=160),
            airframe=AirframeConfig(wind_m_s=1.0),
        ),
        storage=storage,
        images=False,
    )


@pytest.mark.parametrize("number", range(-(-GAPS // IN_ONE_MISSION)))
async def test_a_mission_goes_on_by_itself_after_every_gap(tmp_path: Path, number: int) -> None:
    seed = SEED + number
    spans = _gaps(seed)
    events: list[Event] = []
    async with asyncio.timeout(600):
        summary = await run_dry_run(_options(tmp_path, spans, seed=seed), on_event=events.append)
    paused = [event for event in events if isinstance(event, MissionPaused)]
    story = f"seed {seed}, gaps {[(round(a, 1), round(b - a, 2)) for a, b in spans]}: {[e.code for e in paused]}"
    assert summary.state == "complete", f"{summary.reason}; {story}"
    assert all(event.automatic for event in paused), story
    assert not any(isinstance(event, CommandReceived) for event in events), "nobody helped"
    first_s = next(event.clock_s for event in events if isinstance(event, ShotExposed))
    assert events[-1].clock_s - first_s > spans[-1][0], "every gap came before the end"
    if any(end - start > 3 for start, end in spans):
        assert paused, f"a long gap is noticed; {story}"
