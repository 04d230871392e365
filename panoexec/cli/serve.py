"""Run the daemon: holds the links to autopilot and broker, flies missions that a ground station asks for by MQTT.

Autopilot, camera and broker may be absent at the start and vanish at any time. SIGTERM ends after the current photo and
leaves a mission that can be resumed; SIGHUP reads the configuration again. Under systemd a wrong configuration ends
with exit code 78 instead of 2.

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

import panoexec.cli.lean  # noqa: F401  (first: see there)
from panoexec.cli.one_heap import use_one_heap
from panoexec.cli.planning_options import positive
from panoexec.clock import SystemClock
from panoexec.daemon.daemon import Daemon
from panoexec.daemon.mission_request import configuration_problems
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.errors import InputFileError, PanoexecError, UsageError
from panoexec.inputs.config import Config, load_config
from panoexec.logs import configure_logs

DEFAULT_CONFIG = Path("/etc/panoexec/config.toml")
EXIT_CONFIG = 78
"""EX_CONFIG of sysexits.h: the unit does not restart after it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument(
        "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help=f"the configuration ({DEFAULT_CONFIG})"
    )
    parser.add_argument(
        "--speedup", type=positive, default=1.0, metavar="N", help="for a simulated vehicle that runs N times faster"
    )


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM."""
    use_one_heap()
    try:
        config = checked_config(args.config, os.environ)
        configure_logs(config.log.level, config.log.format)
        asyncio.run(_serve(config, args.config, args.speedup))
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


def checked_config(path: Path, environment: Mapping[str, str]) -> Config:
    """The configuration, if nothing at all is wrong with it.

    Raises:
        InputFileError: with every problem.
    """
    config = load_config(path, environment)
    problems = configuration_problems(config)
    if problems:
        raise InputFileError(str(path), problems)
    return config


async def _serve(config: Config, path: Path, speedup: float) -> None:
    daemon = Daemon(
        config,
        clock=SystemClock(speedup),
        reload=lambda: checked_config(path, os.environ),
        notifier=SystemdNotifier(),
    )
    await daemon.run()


def _leaves(group: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    out: list[BaseException] = []
    for failure in group.exceptions:
        out += _leaves(failure) if isinstance(failure, BaseExceptionGroup) else [failure]
    return out
