"""Show a mission over MQTT: a map of the sphere, a progress bar and the last shots, until it ends or Ctrl-C is pressed.

Exit codes after the end of a mission: 0 complete, 1 incomplete or aborted, 3 failed. Exit code 3 also means that no
message from the vehicle was received or that the broker cannot be reached. --all shows one line per vehicle until
Ctrl-C. --json prints one document at the end, also when interrupted: the last status and state and all received events.
If the connection to the broker is lost, the command reconnects.

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
from panoexec.cli.numbers import positive
from panoexec.cli.output import console, has_colours, note, print_json
from panoexec.cli.watch_view import ENDED, Watched, fleet_view, mission_view
from panoexec.errors import LinkError
from panoexec.inputs.config import MqttSection
from panoexec.mqtt.ground_station import GroundStation

EXIT_INTERRUPTED = 130
_AGAIN_S = 1.0
_LAST_EVENTS_S = 3.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--all", action="store_true", help="show all vehicles below the topic prefix")
    parser.add_argument("--follow", action="store_true", help="keep running after the end of a mission")
    parser.add_argument("--timeout", type=positive, metavar="S", help="maximum running time (s)")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout at the end")
    add_broker_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Show the vehicles until the mission ends."""
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
            note(f"panoexec: no message received from any vehicle below {section.prefix}/: check [mqtt] prefix")
        return 0
    watched = vehicles.get(vehicle)
    if watched is None:
        note(f"panoexec: no message received from {vehicle}: check its id ([vehicle] id) and whether it has connected")
        return LinkError.exit_code
    return ENDED.get(watched.ended, 0)


async def _watch(
    section: MqttSection, vehicle: str | None, vehicles: dict[str, Watched], args: argparse.Namespace
) -> None:
    """Listen until the mission ends; reconnect to a broker that was connected once."""
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
                        live.console.print(f"{told}: retrying")
                    await asyncio.sleep(_AGAIN_S)


async def _listen(
    ground: GroundStation,
    vehicle: str | None,
    vehicles: dict[str, Watched],
    live: Live,
    limit: asyncio.Timeout | None,
) -> None:
    """Listen until the mission of the vehicle ends; without end if `vehicle` or `limit` is None."""
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
            # the state can arrive before the last events: wait for those a little longer
            soon = asyncio.get_running_loop().time() + _LAST_EVENTS_S
            limit.reschedule(min(limit.when() or soon, soon))
