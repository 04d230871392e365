"""Check a configuration of the daemon and report all problems at once, including those of environment variables.

Example:
  panoexec check-config /etc/panoexec/config.toml
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from panoexec.cli.output import note, print_facts, print_json
from panoexec.daemon.mission_request import configuration_problems
from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.config import Config, load_config
from panoexec.web.checks import web_problems


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    # other commands take the file as an option, and so does this one
    parser.add_argument("file", type=Path, metavar="FILE", nargs="?", help="configuration file")
    parser.add_argument("--config", type=Path, metavar="FILE", help="the same as an option")
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the problems, or the complete configuration, as one JSON document on stdout",
    )


def run(args: argparse.Namespace) -> int:
    """Check the configuration and print the result."""
    if (args.file is None) == (args.config is None):
        raise UsageError("name one configuration file: panoexec check-config FILE")
    path = args.file or args.config
    try:
        config = _checked(path)
    except InputFileError as error:
        if args.json:
            print_json({"file": error.source, "ok": False, "problems": error.problems})
            return error.exit_code
        for problem in error.problems:
            note(f"panoexec: {error.source}: {problem}")
        return error.exit_code
    if args.json:
        print_json({"file": str(path), "ok": True, "problems": [], "config": config.model_dump(mode="json")})
        return 0
    broker = "none" if config.mqtt.host is None else f"{config.mqtt.host}:{config.mqtt.port}"
    print_facts(
        [
            ("config", f"{path} is valid"),
            ("vehicle", f"{config.vehicle.id} on {config.vehicle.connection or f'serial {config.vehicle.serial}'}"),
            ("camera", config.camera.profile),
            ("broker", broker),
            ("storage", str(config.storage.path)),
        ]
    )
    return 0


def _checked(path: Path) -> Config:
    """The configuration, of the daemon and of the page's server.

    Raises:
        InputFileError: with every problem.
    """
    config = load_config(path, os.environ)
    if problems := [*configuration_problems(config), *web_problems(config.web)]:
        raise InputFileError(str(path), problems)
    return config
