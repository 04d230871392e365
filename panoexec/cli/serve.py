"""Run the daemon, which keeps the links to autopilot and broker and executes missions on MQTT requests.

Autopilot, camera and broker may be absent at the start and may be lost at any time; the daemon keeps reconnecting.
SIGTERM stops the daemon after the current photo; the mission can be resumed. SIGHUP reloads the configuration. Under
systemd an invalid configuration ends with exit code 78 instead of 2.

Example:
  panoexec serve --config /etc/panoexec/config.toml
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from collections.abc import Mapping
from pathlib import Path

import panoexec.cli.lean  # noqa: F401  (must be imported first)
from panoexec.adapters.link.first_heartbeats import OpenedConnection, open_at_once
from panoexec.adapters.link.no_downloads import no_downloads
from panoexec.cli.numbers import positive
from panoexec.cli.one_heap import use_one_heap
from panoexec.errors import InputFileError, PanoexecError, UsageError
from panoexec.inputs.config import Config, load_config
from panoexec.logs import configure_logs

# the daemon's modules are imported when heartbeats are sent, see `first_heartbeats`

DEFAULT_CONFIG = Path("/etc/panoexec/config.toml")
EXIT_CONFIG = 78
"""EX_CONFIG of sysexits.h; the systemd unit does not restart the service after it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help=f"configuration file ({DEFAULT_CONFIG})"
    )
    parser.add_argument(
        "--speedup", type=positive, default=1.0, metavar="N", help="speed-up of the simulated vehicle (1)"
    )


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM."""
    use_one_heap()
    try:
        config = load_config(args.config, os.environ)
        configure_logs(config.log.level, config.log.format)
        opened = open_at_once(config.vehicle)
        try:
            _check(args.config, config)
        except BaseException:
            if opened is not None:
                opened.close()
            raise
        _wait_for_children_without_threads()
        with no_downloads(os.environ):
            asyncio.run(_serve(config, args.config, args.speedup, opened))
    except BaseExceptionGroup as failures:
        ours = [failure for failure in _leaves(failures) if isinstance(failure, PanoexecError)]
        if not ours:
            raise
        raise ours[0] from failures
    except UsageError as error:
        if "NOTIFY_SOCKET" not in os.environ:
            raise
        print(f"panoexec: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_CONFIG
    return 0


def _wait_for_children_without_threads() -> None:
    """Let the kernel tell of the planner's end, as later versions of Python do.

    With Python 3.11, asyncio starts a thread for each child, and its event loop stands still until that thread runs,
    which on a busy computer takes longer than a stop may wait.
    """
    if sys.version_info < (3, 12) and hasattr(os, "pidfd_open"):
        asyncio.set_child_watcher(asyncio.PidfdChildWatcher())


def checked_config(path: Path, environment: Mapping[str, str]) -> Config:
    """Load and check the configuration.

    Raises:
        InputFileError: the configuration is invalid; the error lists every problem.
    """
    config = load_config(path, environment)
    _check(path, config)
    return config


def _check(path: Path, config: Config) -> None:
    from panoexec.daemon.mission_request import configuration_problems  # noqa: PLC0415

    problems = configuration_problems(config)
    if problems:
        raise InputFileError(str(path), problems)


async def _serve(config: Config, path: Path, speedup: float, opened: OpenedConnection | None) -> None:
    from panoexec.clock import SystemClock  # noqa: PLC0415
    from panoexec.daemon.daemon import Daemon  # noqa: PLC0415
    from panoexec.daemon.sdnotify import SystemdNotifier  # noqa: PLC0415

    daemon = Daemon(
        config,
        clock=SystemClock(speedup),
        reload=lambda: checked_config(path, os.environ),
        notifier=SystemdNotifier(),
        config_file=path,
        opened=opened,
    )
    await daemon.run()


def _leaves(group: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    out: list[BaseException] = []
    for failure in group.exceptions:
        out += _leaves(failure) if isinstance(failure, BaseExceptionGroup) else [failure]
    return out
