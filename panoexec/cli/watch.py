"""Watch a vehicle by MQTT: a progress bar and the last shots, until its mission ends or Ctrl-C.

Exit codes, once a mission ended: 0 complete, 1 incomplete or aborted, 3 failed. With --all one line a vehicle, until
Ctrl-C. With --json one document at the end: the last status and state, and every event that was heard.

Examples:
  panoexec watch --host broker.local --vehicle drone
  panoexec watch --all --timeout 10 --json
"""

from __future__ import annotations

import argparse
import asyncio
from contextlib import aclosing, suppress
from dataclasses import dataclass, field
from typing import Any

from rich.console import Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from panoexec.cli.broker_options import add_broker_arguments, broker_of
from panoexec.cli.output import console, minutes, print_json
from panoexec.cli.planning_options import positive
from panoexec.config import MqttSection
from panoexec.mqtt.ground import GroundStation, Heard

_EXIT = {"complete": 0, "incomplete": 1, "aborted": 1, "failed": 3}
_LAST_SHOTS = 10


@dataclass(slots=True)
class Watched:
    """What was heard of one vehicle."""

    status: str = ""
    state: dict[str, Any] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    seen: set[str] = field(default_factory=set)
    flying: bool = False
    ended: str = ""

    def hear(self, heard: Heard) -> None:
        """Take a message; a repeated event is dropped."""
        document = heard.document
        if heard.kind == "status":
            self.status = str(document)
        elif heard.kind == "state" and isinstance(document, dict):
            self.state = document
            state = str(document.get("state"))
            if state in _EXIT and self.flying:
                self.ended = state
            self.flying = self.flying or state in {"preflight", "capturing", "paused", "finishing"}
        elif heard.kind == "event" and isinstance(document, dict) and str(document.get("id")) not in self.seen:
            self.seen.add(str(document.get("id")))
            self.events.append(document)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--all", action="store_true", help="every vehicle below the prefix")
    parser.add_argument("--follow", action="store_true", help="go on after the end of a mission")
    parser.add_argument("--timeout", type=positive, metavar="S", help="end after this long")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout at the end")
    add_broker_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Watch."""
    section, vehicle = broker_of(args)
    vehicles: dict[str, Watched] = {}
    with suppress(TimeoutError):
        asyncio.run(_watch(section, None if args.all else vehicle, vehicles, args))
    if args.json:
        heard = {
            name: {"status": one.status, "state": one.state, "events": one.events}
            for name, one in sorted(vehicles.items())
        }
        print_json(heard if args.all else heard.get(vehicle, {"status": "", "state": {}, "events": []}))
    watched = vehicles.get(vehicle)
    return _EXIT.get(watched.ended, 0) if watched is not None and not args.all else 0


async def _watch(
    section: MqttSection, vehicle: str | None, vehicles: dict[str, Watched], args: argparse.Namespace
) -> None:
    out = console(stderr=True)
    async with asyncio.timeout(args.timeout), GroundStation(section) as ground:
        with Live(console=out, auto_refresh=False, transient=args.json) as live:
            async with aclosing(ground.listen(vehicle)) as messages:
                async for heard in messages:
                    one = vehicles.setdefault(heard.vehicle, Watched())
                    one.hear(heard)
                    live.update(_fleet(vehicles) if vehicle is None else _mission(heard.vehicle, one), refresh=True)
                    if vehicle is not None and one.ended and not args.follow:
                        return


def _mission(name: str, one: Watched) -> Group:
    state = one.state
    total, done = state.get("shots_total") or 0, state.get("shots_done") or 0
    eta = state.get("eta_s")
    head = Table.grid(padding=(0, 2))
    head.add_row(
        name,
        one.status or "unknown",
        str(state.get("state", "")),
        ProgressBar(total=max(total, 1), completed=done, width=30),
        f"{done}/{total}",
        f"{state.get('retakes', 0)} retakes",
        "" if eta is None else f"{minutes(eta)} left",
        str(state.get("reason") or ""),
    )
    shots = Table(box=None, padding=(0, 2))
    for column in ("shot", "attempt", "event", "reason"):
        shots.add_column(column)
    for event in [event for event in one.events if "shot" in event and "attempt" in event][-_LAST_SHOTS:]:
        shots.add_row(str(event["shot"]), str(event["attempt"]), str(event["type"]), str(event.get("reason") or ""))
    return Group(head, shots)


def _fleet(vehicles: dict[str, Watched]) -> Table:
    table = Table(box=None, padding=(0, 2))
    for column in ("vehicle", "status", "state", "shots", "battery", "reason"):
        table.add_column(column)
    for name, one in sorted(vehicles.items()):
        state = one.state
        battery = state.get("battery_frac")
        table.add_row(
            name,
            one.status or "unknown",
            str(state.get("state", "")),
            f"{state.get('shots_done', 0)}/{state.get('shots_total', 0)}",
            "-" if battery is None else f"{100 * battery:.0f} %",
            str(state.get("reason") or ""),
        )
    return table
