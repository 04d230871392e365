"""Examine a vehicle: links, message rates, gimbal, camera, evidence, clock, disk, broker, permissions.

Tells what was found, what is missing, and which parameter of ArduPilot or PX4, or which key of the configuration, to
set. Nothing moves, and no photo is taken without --photo. The daemon must not run meanwhile: it holds the link. Exit
codes: 0 nothing is missing, 1 something of this computer is, 2 the configuration is wrong, 3 a device or a link is.

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
    """Declare the verb's options."""
    parser.add_argument(
        "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help=f"the configuration ({DEFAULT_CONFIG})"
    )
    parser.add_argument("--photo", action="store_true", help="take one photo, to see what proves it")
    parser.add_argument(
        "--timeout", type=positive, default=20.0, metavar="S", help="to wait for autopilot, gimbal and camera each (20)"
    )
    parser.add_argument(
        "--speedup", type=positive, default=1.0, metavar="N", help="for a simulated vehicle that runs N times faster"
    )
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Examine, and show what was found."""
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
    table.add_column("what", no_wrap=True)
    table.add_column("")
    table.add_column("found, what is needed, what to set")
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
    verdict = "nothing speaks against a mission" if findings.exit_code == 0 else "no mission can be flown like this"
    print(f"{missing} missing, {warnings} warning{'' if warnings == 1 else 's'}, {fine} ok: {verdict}")
