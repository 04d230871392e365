"""Check a vehicle before a mission: links, message rates, gimbal, camera, evidence, clock, disk, broker, permissions.

Reports what was found, what is missing, and which ArduPilot or PX4 parameter or which configuration key to set. Nothing
moves, and no photo is taken without --photo. Stop the daemon first, because it occupies the link. Exit codes: 0 nothing
is missing, 1 something is missing on this computer, 2 invalid configuration, 3 a device or link is missing.

Examples:
  panoexec doctor --config /etc/panoexec/config.toml
  panoexec doctor --photo --json
"""

from __future__ import annotations

import argparse
import asyncio
import os
from pathlib import Path

from rich import box
from rich.table import Table
from rich.text import Text

from panoexec.cli.output import console, note, print_json
from panoexec.cli.planning_options import positive
from panoexec.cli.serve import DEFAULT_CONFIG, checked_config
from panoexec.clock import SystemClock
from panoexec.doctor.findings import Findings, Verdict
from panoexec.doctor.run_checks import run_checks
from panoexec.logs import configure_logs

_STYLES = {Verdict.OK: "green", Verdict.NOTE: "dim", Verdict.WARNING: "yellow", Verdict.MISSING: "bold red"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help=f"configuration file ({DEFAULT_CONFIG})"
    )
    parser.add_argument("--photo", action="store_true", help="take one photo and report its evidence")
    parser.add_argument(
        "--timeout",
        type=positive,
        default=20.0,
        metavar="S",
        help="timeout in s for each of autopilot, gimbal and camera (20)",
    )
    parser.add_argument(
        "--speedup", type=positive, default=1.0, metavar="N", help="speed-up of the simulated vehicle (1)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Run the checks and print the findings."""
    config = checked_config(args.config, os.environ)
    configure_logs("error", config.log.format)
    findings = asyncio.run(
        run_checks(
            config,
            args.config,
            clock=SystemClock(args.speedup),
            patience_s=args.timeout,
            photo=args.photo,
            note=note,
        )
    )
    if args.json:
        print_json({"config": str(args.config), "vehicle": config.vehicle.id} | findings.document())
    else:
        _show(findings)
    return findings.exit_code


def _show(findings: Findings) -> None:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("check", no_wrap=True)
    table.add_column("")
    table.add_column("found, needed, advice")
    area = ""
    for finding in findings.all:
        if area and finding.area != area:
            table.add_section()
        area = finding.area
        text = Text(finding.found)
        if finding.verdict in (Verdict.WARNING, Verdict.MISSING) and finding.needed:
            text.append(f"\nneeded: {finding.needed}", style="dim")
        if finding.advice:
            text.append(f"\n→ {finding.advice}", style="bold")
        table.add_row(
            f"{finding.area}: {finding.check}", Text(finding.verdict.value, style=_STYLES[finding.verdict]), text
        )
    console().print(table)
    missing, warnings, fine = (findings.count(v) for v in (Verdict.MISSING, Verdict.WARNING, Verdict.OK))
    verdict = "ready for a mission" if findings.exit_code == 0 else "not ready for a mission"
    print(f"{missing} missing, {warnings} warning{'' if warnings == 1 else 's'}, {fine} ok: {verdict}")
