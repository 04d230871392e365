"""Show a mission over MQTT: a map of the sphere, a progress bar and the last shots, until it ends or Ctrl-C is pressed.

Exit codes after the end of a mission: 0 complete, 1 incomplete or aborted, 3 failed. Exit code 3 also means that no
message from the vehicle was received or that the broker cannot be reached. --all shows one line per vehicle until
Ctrl-C. --json prints one document at the end, also when interrupted: the last status and state and all received events.
If the connection to the broker is lost, the command reconnects.

On a terminal, keys command the vehicle that is shown: p pause, r resume, s skip the current shot, f finish, a abort.
Each is confirmed by y.

Examples:
  panoexec watch --host broker.local --vehicle drone
  panoexec watch --all --timeout 10 --json
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from contextlib import ExitStack, aclosing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import panoexec.cli.lean  # noqa: F401  (must be imported first)
from panoexec.cli import operate
from panoexec.cli.broker_options import add_broker_arguments, broker_of
from panoexec.cli.numbers import positive
from panoexec.cli.output import console, has_colours, note, print_json
from panoexec.cli.requesting import ask, error_text
from panoexec.cli.storage_options import CONFIG
from panoexec.cli.watch_keys import TIMEOUT_S, Keys, TerminalKeys, can_read_keys
from panoexec.cli.watch_view import ENDED, Watched, fleet_view, mission_view
from panoexec.errors import LinkError, PanoexecError
from panoexec.inputs.config import load_config
from panoexec.inputs.service_sections import MqttSection, StorageSection
from panoexec.mqtt.ground_station import GroundStation

if TYPE_CHECKING:
    from rich.live import Live

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
    if watched.ended and not args.json:
        if not sys.stderr.isatty():
            note("")  # the last view, in a pipe or a file, ends without a line break
        print(report_place(str(watched.state.get("mission_id")), vehicle, _storage(args)))
    return ENDED.get(watched.ended, 0)


def report_place(mission_id: str, vehicle: str, storage: Path) -> str:
    """Where the report of a mission is: on this computer, or how it comes here.

    Args:
        mission_id: of the mission.
        vehicle: its vehicle's id.
        storage: where missions are on this computer, if it is the vehicle's.
    """
    folder = storage / "missions" / mission_id
    with suppress(OSError):  # a storage that this user may not enter
        if folder.is_dir():
            return f"report: {folder / 'report.html'}"
    return f"report: missions/{mission_id}/report.html on {vehicle}; here by panoexec fetch {mission_id} --from HOST"


def _storage(args: argparse.Namespace) -> Path:
    """Where a daemon on this computer keeps missions."""
    path = args.config or (CONFIG if os.access(CONFIG, os.R_OK) else None)
    try:
        return StorageSection().path if path is None else load_config(path, os.environ).storage.path
    except PanoexecError:  # a configuration that was not asked for
        return StorageSection().path


class _Screen:
    """The live view of one vehicle, or of all."""

    def __init__(self, live: Live, vehicle: str | None, vehicles: dict[str, Watched]) -> None:
        self.live = live
        self.vehicle = vehicle
        self.vehicles = vehicles
        self.keys: Keys | None = None

    def draw(self) -> None:
        """Draw what is known."""
        out = self.live.console
        size = (out.width, out.height) if out.is_terminal else (0, 0)
        if self.vehicle is None:
            self.live.update(fleet_view(self.vehicles, columns=size[0]), refresh=True)
            return
        one = self.vehicles.get(self.vehicle, Watched())
        note_text = "" if self.keys is None else self.keys.note
        view = mission_view(self.vehicle, one, room=size, colours=has_colours(out), note=note_text)
        self.live.update(view, refresh=True)


async def _watch(
    section: MqttSection, vehicle: str | None, vehicles: dict[str, Watched], args: argparse.Namespace
) -> None:
    """Listen until the mission ends; reconnect to a broker that was connected once."""
    from rich.live import Live  # noqa: PLC0415  (after what must be imported first)

    known, told = False, ""
    async with asyncio.timeout(args.timeout) as limit:
        with ExitStack() as stack:
            live = stack.enter_context(Live(console=console(stderr=True), auto_refresh=False, transient=args.json))
            screen = _Screen(live, vehicle, vehicles)
            if vehicle is not None and live.console.is_terminal and can_read_keys(sys.stdin):
                screen.keys = _keys(section, vehicle, screen)
                stack.enter_context(TerminalKeys(sys.stdin, screen.keys.press))
            try:
                while True:
                    try:
                        async with GroundStation(section) as ground:
                            known = True
                            await _listen(ground, screen, limit if not args.follow else None)
                            return
                    except LinkError as error:
                        if not known:
                            raise
                        if str(error) != told:
                            told = str(error)
                            live.console.print(f"{told}: retrying")
                        await asyncio.sleep(_AGAIN_S)
            finally:
                if screen.keys is not None:
                    await screen.keys.close()
                    screen.keys = None
                    screen.draw()


def _keys(section: MqttSection, vehicle: str, screen: _Screen) -> Keys:
    async def send(name: str) -> str:
        verb = operate.VERBS[name]
        try:
            answer = await ask(section, vehicle, verb.request, {}, TIMEOUT_S)
        except LinkError as error:
            return str(error)
        if answer["status"] != "ok":
            return error_text(answer, vehicle, name)
        return verb.sentence(answer.get("data") or {}, vehicle)

    return Keys(vehicle, send=send, changed=screen.draw, now=asyncio.get_running_loop().time)


async def _listen(ground: GroundStation, screen: _Screen, limit: asyncio.Timeout | None) -> None:
    """Listen until the mission of the vehicle ends; without end if it is of all vehicles, or `limit` is None."""
    vehicle = screen.vehicle
    async with aclosing(ground.listen(vehicle)) as messages:
        async for heard in messages:
            one = screen.vehicles.setdefault(heard.vehicle, Watched())
            one.hear(heard.kind, heard.document)
            screen.draw()
            if vehicle is None or limit is None or not one.ended:
                continue
            if one.finished:
                return
            # the state can arrive before the last events: wait for those a little longer
            soon = asyncio.get_running_loop().time() + _LAST_EVENTS_S
            limit.reschedule(min(limit.when() or soon, soon))
