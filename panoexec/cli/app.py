"""Dispatch to the commands; every error that a user can cause is reported here as one line and an exit code.

A command is a module with `add_arguments(parser)` and `run(args) -> int`. The module is imported only when the command
is called, so that `panoexec --help` and `panoexec cameras` respond immediately.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import panoexec
from panoexec.cli.streams import discard_output, is_broken_pipe, make_lenient
from panoexec.errors import DependencyError, PanoexecError, UsageError, to_install
from panoexec.mqtt.topics import COMMANDS as REQUESTS
from panoexec.suggestions import did_you_mean

EXIT_DONE = 0
EXIT_INTERRUPTED = 130


@dataclass(frozen=True, slots=True)
class Command:
    """The module of a command and its one-line summary."""

    module: str
    summary: str
    extra: str = ""
    """The optional extra whose packages the command needs, or ""."""


COMMANDS: dict[str, Command] = {
    "plan": Command("plan", "compute the smallest set of poses that cover a panorama, with a certificate"),
    "verify": Command("verify", "check any plan file: coverage, overlaps, connectivity under pointing errors"),
    "cameras": Command("cameras", "list the camera profiles, or show one with its field of view"),
    "dry-run": Command("dry_run", "fly a complete mission on a simulated vehicle", extra="sim"),
    "report": Command("report", "write the report of a mission as one self-contained HTML page"),
    "missions": Command("missions", "list the missions of a storage"),
    "fetch": Command("fetch", "bring a mission here, from the drone's computer or a folder, and verify its photos"),
    "import": Command("import_card", "put the photos of a memory card into a mission, each with its attempt"),
    "calibrate": Command("calibrate", "estimate the gimbal's own errors and the tolerance from flights"),
    "salvage": Command("salvage", "recover the longest true part of a mission whose journal is damaged"),
    "stitch": Command("stitch", "stitch the photos of a mission with Hugin and measure completeness"),
    "experiment": Command("experiment", "reproduce the paper's simulation: render, stitch, compare"),
    "simulate": Command("simulate", "run only the simulated vehicle, for a ground station or `serve`", extra="sim"),
    "serve": Command("serve", "run the daemon that executes missions on MQTT requests", extra="vehicle"),
    "start": Command("operate", "start a mission on a vehicle, over MQTT"),
    "pause": Command("operate", "hold the mission after the current photo"),
    "resume": Command("operate", "continue the mission"),
    "skip": Command("operate", "skip a shot"),
    "repeat": Command("operate", "take a shot again"),
    "finish": Command("operate", "end shooting and accept the gaps"),
    "abort": Command("operate", "end the mission for good"),
    "status": Command("operate", "say what a vehicle is doing"),
    "send": Command("send", "send a request to a vehicle over MQTT and show the response"),
    "watch": Command("watch", "show live progress of vehicles over MQTT"),
    "web": Command("web", "serve the operator's page, a client of the MQTT interface"),
    "demo": Command("demo", "show it all on this computer: broker, simulated vehicle, daemon, page", extra="sim"),
    "doctor": Command("doctor", "check a vehicle before a mission and name the parameters to set", extra="vehicle"),
    "check-config": Command("check_config", "report all problems in a configuration file"),
}


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are exceptions with one line of text."""

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage and exiting."""
        raise UsageError(f"{message} (see {self.prog} --help)")


def run(argv: Sequence[str]) -> int:
    """Run the command line.

    Args:
        argv: arguments without the program's name.

    Returns:
        The exit code (docs/contract.md).
    """
    make_lenient()
    try:
        code = _dispatch(list(argv))
        sys.stdout.flush()  # an error of the last line belongs here, not to the exit of the interpreter
    except KeyboardInterrupt:
        print("panoexec: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except Exception as error:  # noqa: BLE001  (whatever it is, users see one line)
        if is_broken_pipe(error):
            # the reader of a pipe has closed it (`panoexec cameras | head`): no message, not even at exit
            discard_output()
            return EXIT_DONE
        return _report(_for_users(error))
    return code


def _for_users(error: Exception) -> PanoexecError:
    if isinstance(error, PanoexecError):
        return error
    if isinstance(error, OSError):
        return UsageError(f"{error.filename or 'output'}: {error.strerror or error}")
    # last resort: users see a traceback only on request
    if os.environ.get("PANOEXEC_TRACEBACK"):
        raise error
    text = f"internal error, please report it: {type(error).__name__}: {error} (PANOEXEC_TRACEBACK=1 shows where)"
    return PanoexecError(text)


def _report(error: PanoexecError) -> int:
    # one line, even if the message contains line breaks
    print(f"panoexec: {' '.join(str(error).split())}", file=sys.stderr)
    return error.exit_code


def _dispatch(argv: list[str]) -> int:
    if argv[:1] == ["help"] and len(argv) > 1 and not argv[1].startswith("-"):
        argv = [argv[1], "--help"]
    if not argv or argv[0] in {"-h", "--help", "help"}:
        print(_overview())
        return EXIT_DONE if argv else UsageError.exit_code
    if argv[0] in {"-V", "--version", "version"}:
        print(f"panoexec {panoexec.__version__}")
        return EXIT_DONE
    name, rest = argv[0], argv[1:]
    command = COMMANDS.get(name)
    if command is None:
        raise UsageError(_unknown_command(name))
    module = module_of(name)
    parser = parser_of(name, module)
    _check_options(parser, rest)
    try:
        # some commands accept options between their positional arguments
        parse = parser.parse_intermixed_args if getattr(module, "INTERMIXED", False) else parser.parse_args
        args = parse(rest)
    except SystemExit as done:  # --help
        return int(done.code or 0)
    return int(module.run(args))


def _check_options(parser: Parser, words: Sequence[str]) -> None:
    """Name an unknown option before anything else: argparse would first tell what is missing because of it.

    Raises:
        UsageError: with the option that is nearest.
    """
    known = [option for action in parser._actions for option in action.option_strings]  # noqa: SLF001
    for word in words:
        option = word.partition("=")[0]
        if word == "--":
            return
        if word.startswith("--") and option not in known:
            hint = did_you_mean(option, known)
            raise UsageError(f"unknown option {option}{hint and f': {hint}'} (see {parser.prog} --help)")


def parser_of(name: str, module: Any) -> Parser:
    """The argument parser of one command, given its module.

    Negative numbers are parsed as values (--elevation -90 30), because no option looks like a negative number.
    """
    parser = Parser(prog=f"panoexec {name}", description=module.__doc__, formatter_class=_Formatter, allow_abbrev=False)
    module.add_arguments(parser)
    return parser


def module_of(name: str) -> Any:
    """What has the arguments and the function of a command: a module, or an object of its `VERBS`.

    Raises:
        DependencyError: a package that it needs is not installed.
    """
    command = COMMANDS[name]
    try:
        module = importlib.import_module(f"panoexec.cli.{command.module}")
        return getattr(module, "VERBS", {name: module})[name]
    except ModuleNotFoundError as error:
        if command.extra and error.name and not error.name.startswith("panoexec"):
            raise DependencyError(
                f"`{name}` needs the Python package {error.name}: {to_install(command.extra)}"
            ) from error
        raise


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Prints the docstring of the module without re-wrapping it."""


def _overview() -> str:
    width = max(map(len, COMMANDS)) + 2
    lines = [f"  {name:<{width}}{command.summary}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            "panoexec: complete gigapixel panoramas by multirotor",
            "",
            "usage: panoexec COMMAND [options]      (panoexec COMMAND --help for details)",
            "",
            *lines,
            "",
            "panoexec version prints the version",
            "",
            "exit codes: 0 done, 1 result incomplete, 2 wrong usage or input, 3 device or link failure,",
            "            130 interrupted",
        ]
    )


def _unknown_command(name: str) -> str:
    said = {one: f"send {one}" for one in REQUESTS} | {one: one for one in (*COMMANDS, "help", "version")}
    hint = did_you_mean(name, said, quoted=True) or f"commands are {', '.join(COMMANDS)}"
    return f"unknown command {name!r}: {hint} (see panoexec --help)"
