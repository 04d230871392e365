"""Dispatch to the verbs; every error a user can cause ends here as one line and an exit code.

A verb is a module with `add_arguments(parser)` and `run(args) -> int`. Its module is imported only when it is called,
so that `panoexec --help` and `panoexec cameras` answer at once.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import panoexec
from panoexec.errors import DependencyError, PanoexecError, UsageError, to_install

EXIT_DONE = 0
EXIT_INTERRUPTED = 130


@dataclass(frozen=True, slots=True)
class Verb:
    """Where a verb lives, and what it is for in one line."""

    module: str
    summary: str
    extra: str = ""
    """The optional extra whose packages it needs, if any."""


VERBS: dict[str, Verb] = {
    "plan": Verb("plan", "compute the fewest poses that cover a panorama, with proof"),
    "verify": Verb("verify", "judge any plan file: coverage, overlaps, connectivity under pointing errors"),
    "cameras": Verb("cameras", "list the camera profiles, or show one with its field of view"),
    "dry-run": Verb("dry_run", "fly a whole mission on the embedded simulated vehicle", extra="sim"),
    "report": Verb("report", "write the report of a mission: one HTML page that opens anywhere"),
    "stitch": Verb("stitch", "stitch a mission's photos with Hugin's tools and measure completeness", extra="report"),
    "experiment": Verb("experiment", "repeat the paper's simulation case: render, stitch, compare", extra="sim"),
    "simulate": Verb("simulate", "run the simulated vehicle alone, to try a ground station or `serve`", extra="sim"),
    "serve": Verb("serve", "run the daemon that a ground station commands by MQTT"),
    "send": Verb("send", "ask a vehicle for something by MQTT and show its answer"),
    "watch": Verb("watch", "watch vehicles by MQTT: live progress and shots"),
    "doctor": Verb("doctor", "run_checks a vehicle: what is there, what is missing, which parameter to set"),
    "check-config": Verb("check_config", "tell every problem of a configuration at once"),
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
    try:
        return _dispatch(list(argv))
    except PanoexecError as error:
        return _report(error)
    except KeyboardInterrupt:
        print("panoexec: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # the reader of a pipe has gone (`panoexec cameras | head`): say nothing, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DONE
    except OSError as error:
        return _report(UsageError(f"{error.filename or 'output'}: {error.strerror or error}"))
    except Exception as error:
        # the edge of the program: no traceback ever reaches a user who did not ask for it
        if os.environ.get("PANOEXEC_TRACEBACK"):
            raise
        text = f"internal error, please report it: {type(error).__name__}: {error} (PANOEXEC_TRACEBACK=1 shows where)"
        return _report(PanoexecError(text))


def _report(error: PanoexecError) -> int:
    # one line whatever the message holds
    print(f"panoexec: {' '.join(str(error).split())}", file=sys.stderr)
    return error.exit_code


def _dispatch(argv: list[str]) -> int:
    if not argv or argv[0] in {"-h", "--help", "help"}:
        print(_overview())
        return EXIT_DONE if argv else UsageError.exit_code
    if argv[0] in {"-V", "--version"}:
        print(f"panoexec {panoexec.__version__}")
        return EXIT_DONE
    name, rest = argv[0], argv[1:]
    verb = VERBS.get(name)
    if verb is None:
        raise UsageError(_unknown_verb(name))
    module = _load(name, verb)
    parser = parser_of(name, module)
    try:
        # options may stand between a verb's fields where it says so
        parse = parser.parse_intermixed_args if getattr(module, "INTERMIXED", False) else parser.parse_args
        args = parse(rest)
    except SystemExit as done:  # --help
        return int(done.code or 0)
    return int(module.run(args))


def parser_of(name: str, module: Any) -> Parser:
    """The parser of one verb, given its module.

    Negative numbers are values here (--elevation -90 30); no option looks like one.
    """
    parser = Parser(prog=f"panoexec {name}", description=module.__doc__, formatter_class=_Formatter, allow_abbrev=False)
    module.add_arguments(parser)
    return parser


def _load(name: str, verb: Verb) -> Any:
    try:
        return importlib.import_module(f"panoexec.cli.{verb.module}")
    except ModuleNotFoundError as error:
        if verb.extra and error.name and not error.name.startswith("panoexec"):
            raise DependencyError(
                f"`{name}` needs the Python package {error.name}: {to_install(verb.extra)}"
            ) from error
        raise


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Keeps the module's docstring as it is written."""


def _overview() -> str:
    width = max(map(len, VERBS)) + 2
    lines = [f"  {name:<{width}}{verb.summary}" for name, verb in VERBS.items()]
    return "\n".join(
        [
            "panoexec: complete gigapixel panoramas by multirotor",
            "",
            "usage: panoexec VERB [options]      panoexec VERB --help explains a verb",
            "",
            *lines,
            "",
            "exit codes: 0 done, 1 the result falls short, 2 wrong usage or input, 3 device or link failure,",
            "            130 interrupted",
        ]
    )


def _unknown_verb(name: str) -> str:
    near = difflib.get_close_matches(name, VERBS, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"verbs are {', '.join(VERBS)}"
    return f"there is no verb {name!r}: {hint} (see panoexec --help)"
