"""Check a vehicle before a mission: links, message rates, gimbal, camera, evidence, clock, disk, broker, permissions.

Reports what was found, what is missing, and which ArduPilot or PX4 parameter or which configuration key to set. Nothing
moves, and no photo is taken without --photo. A daemon that is running is asked over the broker to examine itself on its
own link. Exit codes: 0 nothing is missing, 1 something is missing on this computer, 2 invalid configuration, 3 a device
or link is missing.

Examples:
  panoexec doctor --config /etc/panoexec/config.toml
  panoexec doctor --photo --json
"""

from __future__ import annotations

import argparse
import asyncio
import os
from pathlib import Path

from panoexec.adapters.link.no_downloads import no_downloads
from panoexec.cli.findings_view import show_findings
from panoexec.cli.numbers import positive
from panoexec.cli.output import note, print_json
from panoexec.cli.serve import DEFAULT_CONFIG, checked_config
from panoexec.clock import SystemClock
from panoexec.doctor.findings import Findings
from panoexec.doctor.run_checks import check_surroundings, run_checks
from panoexec.doctor.running_daemon import ask_daemon, look_for_daemon
from panoexec.errors import DeviceError
from panoexec.inputs.config import Config
from panoexec.logs import configure_logs


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
    with no_downloads(os.environ):
        findings = asyncio.run(_examined(config, args))
    if args.json:
        print_json({"config": str(args.config), "vehicle": config.vehicle.id} | findings.document())
    else:
        show_findings(findings)
    return findings.exit_code


async def _examined(config: Config, args: argparse.Namespace) -> Findings:
    """The findings: of a running daemon if there is one, else of checks on a link of our own."""
    signs = await look_for_daemon(config, args.config)
    unanswered = ""
    if signs.any:
        try:
            return await ask_daemon(config, photo=args.photo, note=note)
        except DeviceError as error:
            unanswered = f"{signs.text}; {error}"
    if signs.link:
        findings = Findings()
        advice = "wait for it, or stop it: systemctl stop panoexec, run panoexec doctor, systemctl start panoexec"
        needed = "the daemon's answer, or a free link"
        findings.missing("link", "port", unanswered, needed=needed, advice=advice)
        await check_surroundings(config, args.config, findings, note=note)
        return findings
    clock = SystemClock(args.speedup)
    findings = await run_checks(config, args.config, clock=clock, patience_s=args.timeout, photo=args.photo, note=note)
    if unanswered:
        findings.note("link", "daemon", f"a daemon may be running: {unanswered}")
    return findings
