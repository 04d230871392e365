"""Serve the operator's page: see missions happen and command them, from a browser.

A process of its own and a client of the MQTT interface, for one vehicle or a fleet: on the vehicle beside the daemon,
or on the ground against any broker. Without --config, broker and vehicles are those of the options. On loopback there
is no login; any other address needs users, whom --add-user adds to [web] users_file.

Examples:
  panoexec web --host broker.local
  panoexec web --config /etc/panoexec/config.toml --add-user ANNA --role operator
  panoexec web --config /etc/panoexec/config.toml --listen 0.0.0.0:8090
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import panoexec.cli.lean  # noqa: F401  (must be imported first)
from panoexec.cli.broker_options import add_broker_arguments, broker_of
from panoexec.cli.one_heap import use_one_heap
from panoexec.cli.output import note
from panoexec.cli.streams import ask_password
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.errors import UsageError
from panoexec.inputs.config import load_config
from panoexec.inputs.service_sections import LogSection, WebSection, listen_address
from panoexec.logs import configure_logs
from panoexec.web.users import new_user, read_users, write_users

if TYPE_CHECKING:
    from panoexec.web.server import Server

EXIT_CONFIG = 78
"""EX_CONFIG of sysexits.h; the systemd unit does not restart the service after it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--listen", metavar="HOST:PORT", help="where browsers find the page (127.0.0.1:8090)")
    parser.add_argument("--storage", type=Path, metavar="DIR", help="missions of this computer ([storage] of --config)")
    users = parser.add_argument_group("users (the server is not started)")
    users.add_argument("--add-user", metavar="NAME", help="add a user, or set another password or role")
    users.add_argument("--remove-user", metavar="NAME", help="remove a user, whose sessions end at once")
    users.add_argument("--role", choices=("viewer", "operator"), default="viewer", help="of --add-user (viewer)")
    users.add_argument("--users-file", type=Path, metavar="FILE", help="the file ([web] users_file of --config)")
    add_broker_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C, or change the users."""
    if args.add_user is not None or args.remove_user is not None:
        return _change_users(args)
    use_one_heap()
    from panoexec.web.server import Options, Server  # noqa: PLC0415  (changing users needs none of it)

    try:
        mqtt, _ = broker_of(args)
        section, log, storage = _sections(args)
        host, port = _address(args.listen or section.listen)
        configure_logs(log.level, log.format)
        options = Options(mqtt=mqtt, web=section, host=host, port=port, storage=_existing(storage, args.storage))
        asyncio.run(_serve(lambda: Server(options), SystemdNotifier()))
    except UsageError as error:
        if "NOTIFY_SOCKET" not in os.environ:
            raise
        print(f"panoexec: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_CONFIG
    return 0


def _sections(args: argparse.Namespace) -> tuple[WebSection, LogSection, Path | None]:
    section, log, storage = WebSection(), LogSection(), args.storage
    if args.config is not None:
        config = load_config(args.config, os.environ)
        section, log, storage = config.web, config.log, storage or config.storage.path
    if args.users_file is not None:
        section = section.model_copy(update={"users_file": args.users_file})
    return section, log, storage


def _address(text: str) -> tuple[str, int]:
    try:
        return listen_address(text)
    except ValueError as error:
        raise UsageError(f"--listen: {error}") from error


def _existing(storage: Path | None, asked: Path | None) -> Path | None:
    """The storage, if it is one: on the ground there is none."""
    if storage is None or (storage / "missions").is_dir() or (asked is None and storage.is_dir()):
        return storage
    if asked is not None:
        raise UsageError(f"--storage {asked}: has no folder missions")
    return None


def _change_users(args: argparse.Namespace) -> int:
    section, _, _ = _sections(args)
    path = section.users_file
    if path is None:
        raise UsageError("where are the users? give --users-file FILE, or --config with users_file in [web]")
    users = read_users(path) if path.exists() else {}
    if args.remove_user is not None:
        if users.pop(args.remove_user, None) is None:
            raise UsageError(f"{path}: has no user {args.remove_user}")
        write_users(path, users)
        note(f"{path}: {args.remove_user} removed")
        return 0
    user = new_user(args.add_user, args.role, _password(args.add_user))
    users[user.name] = user
    write_users(path, users)
    note(f"{path}: {user.name} is {user.role}")
    return 0


def _password(name: str) -> str:
    """Asked for twice on a terminal, else the first line of standard input."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\r\n")
    first = ask_password(f"password of {name}: ")
    if ask_password("again: ") != first:
        raise UsageError("the passwords differ: nothing was changed")
    return first


async def _serve(make: Callable[[], Server], notifier: SystemdNotifier) -> None:
    loop = asyncio.get_running_loop()
    task = asyncio.current_task()
    assert task is not None
    for one in (signal.SIGTERM, signal.SIGINT):
        with suppress(NotImplementedError):  # Windows: Ctrl-C ends it all the same
            loop.add_signal_handler(one, task.cancel)
    server = make()
    telling = asyncio.create_task(_tell(server, notifier), name="service manager")
    try:
        await server.run()
    except asyncio.CancelledError:
        notifier.stopping("stopping")
    finally:
        telling.cancel()
        await asyncio.gather(telling, return_exceptions=True)


async def _tell(server: Server, notifier: SystemdNotifier) -> None:
    """Tell the service manager that the server is ready, and that its event loop still turns."""
    await server.ready.wait()
    notifier.ready(f"listening at port {server.port}")
    while notifier.watchdog_s is not None:
        notifier.watchdog()
        await asyncio.sleep(notifier.watchdog_s / 3)
