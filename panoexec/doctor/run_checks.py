"""The whole examination, in the order in which it is shown."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from panoexec.clock import Clock
from panoexec.doctor.broker import check_broker
from panoexec.doctor.findings import Findings
from panoexec.doctor.machine import check_machine
from panoexec.doctor.vehicle import check_vehicle
from panoexec.inputs.config import Config


async def run_checks(
    config: Config,
    config_file: Path,
    *,
    clock: Clock,
    patience_s: float,
    photo: bool = False,
    note: Callable[[str], None] = lambda _: None,
) -> Findings:
    """Look at everything.

    Args:
        config: checked.
        config_file: where it came from.
        clock: of missions.
        patience_s: real seconds to wait for each device.
        photo: take one photo.
        note: takes what is going on, for people.
    """
    findings = Findings()
    note("link, rates, gimbal, camera …")
    await check_vehicle(config, findings, clock=clock, patience_s=patience_s, photo=photo)
    note("broker …")
    await check_broker(config, findings)
    note("clock, disk, permissions …")
    await asyncio.to_thread(check_machine, config, config_file, findings)
    return findings
