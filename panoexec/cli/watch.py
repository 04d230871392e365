"""Watch a vehicle by MQTT: a map of the sphere, a progress bar and the last shots, until its mission ends or Ctrl-C.

Exit codes, once a mission ended: 0 complete, 1 incomplete or aborted, 3 failed; 3 also if nothing was heard of the
vehicle or there is no broker. With --all one line a vehicle, until Ctrl-C. With --json one document at the end, an
interrupted one too: the last status and state, and every event that was heard. A broker that goes away is waited for.

Examples:
  panoexec watch --host broker.local --vehicle drone
  panoexec watch --all --timeout 10 --json
"""

from __future__ import annotations

import argparse
import asyncio
from contextlib import aclosing

from rich.live import Live

from panoexec.cli.broker_options import add_broker_arguments, broker_of
from panoexec.cli.output import console, has_colours, note, print_json
from panoexec.cli.planning_options import positive
from panoexec.cli.watch_view import ENDED, Watched, fleet_view, mission_view
from panoexec.errors import LinkError
from panoexec.inputs.config import MqttSection
from panoexec.mqtt.ground_station import GroundStation

EXIT_INTERRUPTED = 130
_AGAIN_S = 1.0
_LAST_EVENTS_S = 3.0


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
    interrupted = False
    try:
        asyncio.run(_watch(section, None if args.all else vehicle, vehicles, args))
    except TimeoutError:
        pass
    except KeyboardInterrupt:
        interrupted = True
    if args.json:
        heard = {
            name: {"status": one.status, "state": one.state, "events": one.events}
            for name, one in sorted(vehicles.items())
        }
        print_json(heard if args.all else heard.get(vehicle, {"status": "", "state": {}, "events": []}))
    if interrupted:
        return EXIT_INTERRUPTED
    if args.all:
        if not vehicles:
            note(f"panoexec: nothing was heard of any vehicle below {section.prefix}/: is that the prefix of theirs?")
        return 0
    watched = vehicles.get(vehicle)
    if watched is None:
        note(f"panoexec: nothing was heard of {vehicle}: is its id right ([vehicle] id), and did it ever connect?")
        return LinkError.exit_code
    return ENDED.get(watched.ended, 0)


async def _watch(
    section: MqttSection, vehicle: str | None, vehicles: dict[str, Watched], args: argparse.Namespace
) -> None:
    """Watch until the mission ends; a broker that was there once is waited for."""
    known, told = False, ""
    async with asyncio.timeout(args.timeout) as limit:
        with Live(console=console(stderr=True), auto_refresh=False, transient=args.json) as live:
            while True:
                try:
                    async with GroundStation(section) as ground:
                        known = True
                        await _listen(ground, vehicle, vehicles, live, limit if not args.follow else None)
                        return
                except LinkError as error:
                    if not known:
                        raise
                    if str(error) != told:
                        told = str(error)
                        live.console.print(f"{told}: trying again")
                    await asyncio.sleep(_AGAIN_S)


async def _listen(
    ground: GroundStation,
    vehicle: str | None,
    vehicles: dict[str, Watched],
    live: Live,
    limit: asyncio.Timeout | None,
) -> None:
    """Listen until the one vehicle's mission ends; for ever without a limit that could be brought forward."""
    async with aclosing(ground.listen(vehicle)) as messages:
        async for heard in messages:
            name = heard.vehicle
            one = vehicles.setdefault(name, Watched())
            one.hear(heard.kind, heard.document)
            out = live.console
            size = (out.width, out.height) if out.is_terminal else (0, 0)
            view = (
                fleet_view(vehicles)
                if vehicle is None
                else mission_view(name, one, room=size, colours=has_colours(out))
            )
            live.update(view, refresh=True)
            if vehicle is None or limit is None or not one.ended:
                continue
            if one.finished:
                return
            # the state overtakes events: the last of them are still on their way
            soon = asyncio.get_running_loop().time() + _LAST_EVENTS_S
            limit.reschedule(min(limit.when() or soon, soon))
