"""Send a request to a vehicle over MQTT and show the response.

Request fields are given as KEY=VALUE. VALUE is parsed as JSON if possible and is a string otherwise; a dot in KEY
addresses a nested field. Exit codes: 0 accepted, 1 rejected, 2 invalid request, 3 no broker or no response.

Examples:
  panoexec send get
  panoexec send plan camera=dji-x5s-15mm overlap=0.2
  panoexec send start 'elevation_deg=[-60,10]' tolerance_deg.yaw=0.5
  panoexec send start --plan plan.json
  panoexec send skip shot=12
  panoexec send doctor
"""

from __future__ import annotations

import argparse
import asyncio
import json
from pathlib import Path
from typing import Any

import panoexec.cli.lean  # noqa: F401  (must be imported first)
from panoexec.cli.broker_options import add_broker_arguments, broker_of
from panoexec.cli.numbers import positive
from panoexec.cli.output import print_facts, print_json
from panoexec.cli.requesting import ask, exit_code, plan_document, report_error
from panoexec.errors import UsageError
from panoexec.mqtt.topics import COMMANDS
from panoexec.suggestions import did_you_mean

INTERMIXED = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("command", metavar="COMMAND", help=", ".join(COMMANDS))
    # without a default, parse_intermixed_args reports the argument as required
    parser.add_argument("fields", nargs="*", default=[], metavar="KEY=VALUE", help="request fields")
    parser.add_argument("--plan", type=Path, metavar="PLAN.json", help="plan file, for `plan` and `start`")
    parser.add_argument("--timeout", type=positive, default=60.0, metavar="S", help="response timeout in s (60)")
    parser.add_argument("--json", action="store_true", help="print the response as one JSON document on stdout")
    add_broker_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Send the request and print the response."""
    if args.command not in COMMANDS:
        from panoexec.cli import app  # noqa: PLC0415  (imports the modules of commands itself)

        said = {one: f"panoexec {one}" for one in app.COMMANDS} | {one: one for one in COMMANDS}
        hint = did_you_mean(args.command, said, quoted=True) or f"commands are {', '.join(COMMANDS)}"
        raise UsageError(f"unknown command {args.command!r}: {hint}")
    fields = _fields(args.fields)
    if args.plan is not None:
        fields["plan"] = plan_document(args.plan)
    section, vehicle = broker_of(args)
    answer = asyncio.run(ask(section, vehicle, args.command, fields, args.timeout))
    if args.json:
        print_json(answer)
    elif answer["status"] == "ok":
        data = answer.get("data") or {}
        if args.command == "doctor":
            _show_findings(data)
            return 0
        print_facts([("ok", args.command), *((name, _short(value)) for name, value in data.items())])
    else:
        report_error(answer, vehicle, args.command)
    return exit_code(answer)


def _show_findings(document: dict[str, Any]) -> None:
    from panoexec.cli.findings_view import show_findings  # noqa: PLC0415  (other requests need none of it)
    from panoexec.doctor.running_daemon import findings_of  # noqa: PLC0415

    show_findings(findings_of(document))


def _fields(texts: list[str]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise UsageError(f"{text!r}: expected KEY=VALUE, for example overlap=0.2")
        table = fields
        *tables, last = key.split(".")
        for name in tables:
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                raise UsageError(f"{text!r}: {name} already has a value")
        try:
            table[last] = json.loads(value)
        except ValueError:
            table[last] = value
    return fields


def _short(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 100 else text[:99] + "…"
