"""Runs all checks, in display order."""

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
    """Run all checks.

    Args:
        config: the validated configuration.
        config_file: its file.
        clock: the mission clock.
        patience_s: timeout for each device, seconds of real time.
        photo: take one photo.
        note: receives progress messages for display.
    """
    findings = Findings()
    note("link, rates, gimbal, camera …")
    await check_vehicle(config, findings, clock=clock, patience_s=patience_s, photo=photo)
    await check_surroundings(config, config_file, findings, note=note)
    return findings


async def check_surroundings(
    config: Config, config_file: Path, findings: Findings, *, note: Callable[[str], None] = lambda _: None
) -> None:
    """Check everything but the vehicle: broker, clock, disk, permissions.

    Args:
        config: the validated configuration.
        config_file: its file.
        findings: results are added to it.
        note: receives progress messages for display.
    """
    note("broker …")
    await check_broker(config, findings)
    note("clock, disk, permissions …")
    await asyncio.to_thread(check_machine, config, config_file, findings)
