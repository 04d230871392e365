"""Serve the operator's page: see missions happen and command them, from a browser.

A process of its own and a client of the MQTT interface, for one vehicle or a fleet: on the vehicle beside the daemon,
or on the ground against any broker. Without --config, broker and vehicles are those of the options. On loopback there
is no login; any other address needs users, whom --add-user adds to [web] users_file.

Examples:
  panoexec web --host broker.local
  panoexec web --config /etc/panoexec/config.toml --listen 0.0.0.0:8090
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
from pathlib import Path

import panoexec.cli.lean  # noqa: F401  (must be imported first)
from panoexec.cli.broker_options import add_broker_arguments, broker_of
from panoexec.cli.one_heap import use_one_heap
from panoexec.errors import UsageError
from panoexec.inputs.config import LogSection, WebSection, listen_address, load_config
from panoexec.logs import configure_logs
from panoexec.web.server import Options, Server


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--listen", metavar="HOST:PORT", help="where browsers find the page (127.0.0.1:8090)")
    parser.add_argument("--storage", type=Path, metavar="DIR", help="missions of this computer ([storage] of --config)")
    add_broker_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or Ctrl-C."""
    use_one_heap()
    options, log = _options(args)
    configure_logs(log.level, log.format)
    asyncio.run(_serve(Server(options)))
    return 0


def _options(args: argparse.Namespace) -> tuple[Options, LogSection]:
    mqtt, _ = broker_of(args)
    section, log, storage = WebSection(), LogSection(), args.storage
    if args.config is not None:
        config = load_config(args.config, os.environ)
        section, log, storage = config.web, config.log, storage or config.storage.path
    try:
        host, port = listen_address(args.listen or section.listen)
    except ValueError as error:
        raise UsageError(f"--listen {error}") from error
    if storage is not None and not (storage / "missions").is_dir():
        if args.storage is not None:
            raise UsageError(f"--storage {storage}: has no folder missions")
        storage = None
    return Options(mqtt=mqtt, web=section, host=host, port=port, storage=storage), log


async def _serve(server: Server) -> None:
    loop = asyncio.get_running_loop()
    task = asyncio.current_task()
    assert task is not None
    for one in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(one, task.cancel)
    try:
        await server.run()
    except asyncio.CancelledError:
        return
