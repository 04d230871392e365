"""A mission process for tests that kill it: flies, or goes on with, a mission on a vehicle that runs already.

Arguments: connection, storage, speed-up, plan file. Prints one line of JSON at the end.
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
from dataclasses import replace
from pathlib import Path

import structlog

from panoexec.dryrun.run import DryRunOptions, DryRunSummary, resume_dry_run, run_dry_run
from panoexec.inputs.plan_file import read_plan_file
from panoexec.mission.log.events import Event
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.sim.config import SimConfig
from panoexec.store.directory import mission_directories


def _tell(event: Event) -> None:
    print(json.dumps({"event": event.type, "seq": event.seq}), flush=True)


async def fly(connection: str, storage: Path, speedup: float, plan_file: Path) -> DryRunSummary:
    """Begin, or go on with the one mission of this storage."""
    directories = mission_directories(storage)
    if directories:
        return await resume_dry_run(directories[-1].path, on_event=_tell)
    plan = read_plan_file(plan_file).plan()
    settings = MissionSettings(
        tolerance=plan.constraints.tolerance,
        interval_s=0.5,
        exposure_s=0.01,
        max_rate_deg_s=4.0,
        max_gap_s=0.3,
        guards=replace(GuardSettings(), position_drift_m=20.0, attitude_silence_s=5.0),
    )
    options = DryRunOptions(
        plan=plan,
        settings=settings,
        simulation=SimConfig(speedup=speedup),
        storage=storage,
        images=False,
        connect=connection,
    )
    return await run_dry_run(options, on_event=_tell)


def main() -> None:
    """See the module."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    connection, storage, speedup, plan_file = sys.argv[1:]
    summary = asyncio.run(fly(connection, Path(storage), float(speedup), Path(plan_file)))
    print(json.dumps({"summary": summary.to_json()}), flush=True)


if __name__ == "__main__":
    main()
