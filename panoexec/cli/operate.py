"""The operator's verbs: `start`, `pause`, `resume`, `skip`, `repeat`, `finish`, `abort`, `status`.

Each sends the request of the same name (`status`: `get`) and says in a sentence what came of it. Exit codes as `send`.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import panoexec.cli.lean  # noqa: F401  (must be imported first)
from panoexec.cli.broker_options import add_broker_arguments, broker_of
from panoexec.cli.numbers import number, positive, whole_number
from panoexec.cli.output import local_time, print_json
from panoexec.cli.requesting import ask, exit_code, plan_document, report_error
from panoexec.errors import UsageError

Data = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Verb:
    """One command; has what `panoexec.cli.app` asks of a module.

    Attributes:
        name: as typed.
        request: name of the request.
        text: for `--help`.
        declare: adds the options of its own.
        fields: the request's fields.
        sentence: what the answer's `data` says.
    """

    name: str
    request: str
    text: str
    declare: Callable[[argparse.ArgumentParser], None]
    fields: Callable[[argparse.Namespace], Data]
    sentence: Callable[[Data, str], str]
    INTERMIXED = True

    @property
    def __doc__(self) -> str:  # type: ignore[override]
        """For `--help`."""
        return self.text

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's options."""
        self.declare(parser)
        parser.add_argument("--timeout", type=positive, default=60.0, metavar="S", help="response timeout in s (60)")
        parser.add_argument("--json", action="store_true", help="print the response as one JSON document on stdout")
        add_broker_arguments(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Send the request and say what came of it."""
        fields = self.fields(args)
        section, vehicle = broker_of(args)
        answer = asyncio.run(ask(section, vehicle, self.request, fields, args.timeout))
        if args.json:
            print_json(answer)
        elif answer["status"] == "ok":
            print(self.sentence(answer.get("data") or {}, vehicle))
        else:
            report_error(answer, vehicle, self.name)
        return exit_code(answer)


def _of_start(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--preset", metavar="NAME", help="what the vehicle's configuration has under [presets.NAME]")
    parser.add_argument("--plan", metavar="PLAN.json", help="fly this plan instead of one that the vehicle computes")
    parser.add_argument("--name", metavar="TEXT", help="name of the mission, for people")
    parser.add_argument("--camera", metavar="NAME", help="camera profile of the vehicle ([camera] profile)")
    parser.add_argument("--lens", choices=("calibrated", "nominal"), help="lens that is planned and proven for")
    parser.add_argument("--reference", choices=("north", "heading"), help="direction of yaw 0")
    parser.add_argument("--method", choices=("certified", "paper"), help="planning method")
    parser.add_argument(
        "--order", choices=("fastest", "rows", "columns", "nadir-first", "sky-first"), help="shooting order"
    )
    parser.add_argument("--budget", type=positive, metavar="SECONDS", help="processor time of the search")
    group = parser.add_argument_group("panorama (angles in degrees: elevation -90 = nadir, azimuth clockwise)")
    group.add_argument("--overlap", type=number, metavar="F", help="minimum overlap, fraction of the image")
    group.add_argument("--overlap-h", type=number, metavar="F", help="overlap within a row, instead of --overlap")
    group.add_argument("--overlap-v", type=number, metavar="F", help="overlap of rows, instead of --overlap")
    group.add_argument("--elevation", type=number, nargs=2, metavar=("MIN", "MAX"), help="elevation range to cover")
    group.add_argument("--azimuth", type=number, nargs=2, metavar=("MIN", "MAX"), help="azimuth range to cover")
    for axis in ("pitch", "roll", "yaw"):
        group.add_argument(f"--tolerance-{axis}", type=number, metavar="DEG", help=f"maximum {axis} error")
    group.add_argument("--textured-below", metavar="DEG|FILE", help="where the sky begins")
    group.add_argument("--guarantee", choices=("coverage", "all"), help="what holds for all errors within tolerance")


def _start_fields(args: argparse.Namespace) -> Data:
    tolerance = {axis: getattr(args, f"tolerance_{axis}") for axis in ("pitch", "roll", "yaw")}
    tolerance = {axis: value for axis, value in tolerance.items() if value is not None}
    fields: Data = {
        "plan": None if args.plan is None else plan_document(args.plan),
        "elevation_deg": args.elevation,
        "azimuth_deg": args.azimuth,
        "tolerance_deg": tolerance or None,
        "budget_s": args.budget,
        "textured_below": _skyline(args.textured_below),
    }
    overlaps = ("overlap", "overlap_h", "overlap_v")
    for name in ("preset", "name", "camera", "lens", "reference", "method", "order", "guarantee", *overlaps):
        fields[name] = getattr(args, name)
    return {name: value for name, value in fields.items() if value is not None}


def _skyline(text: str | None) -> float | list[list[float]] | None:
    if text is None:
        return None
    # numpy, which these verbs do without otherwise
    from panoexec.inputs.skyline import skyline_from_text, skyline_to_data  # noqa: PLC0415

    try:
        return skyline_to_data(skyline_from_text(text))
    except ValueError as error:
        raise UsageError(f"--textured-below {text} {error}") from error


def _of_stop(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("reason", nargs="*", metavar="REASON", help="why, for the log and the report")


def _of_shot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shot", nargs="?", type=whole_number, metavar="SHOT", help="number of the shot, from 0")


def _nothing(parser: argparse.ArgumentParser) -> None:
    del parser


def _reason(args: argparse.Namespace) -> Data:
    # in words as they are typed: a stop in a hurry needs no quotation marks
    return {"reason": " ".join(args.reason)} if args.reason else {}


def _shot(args: argparse.Namespace) -> Data:
    return {} if args.shot is None else {"shot": args.shot}


def _no_fields(args: argparse.Namespace) -> Data:
    del args
    return {}


def _started(data: Data, vehicle: str) -> str:
    images, rows, certificate = data["images"], data["rows"], data.get("certificate")
    text = f"{vehicle}: mission {data['mission_id']} begins: {_many(images, 'image')} in {_many(rows, 'row')}"
    if data.get("duration_s") is not None:
        text += f", about {_minutes(data['duration_s'])}"
    if certificate is None:
        return f"{text}; not certified: a plan of its own"
    proven = "certified" if certificate.get("certified") else "not certified: panoexec verify says why"
    return f"{text}; {proven}"


def _stopped(done: str, before: str, unborn: str, *, until: str) -> Callable[[Data, str], str]:
    """What is said of a stop.

    Args:
        done: of a mission whose state is `until`.
        before: of one that is on its way there: the command was accepted, and what is under way ends first.
        unborn: where no mission exists yet.
        until: the state that the command leads to.
    """

    def sentence(data: Data, vehicle: str) -> str:
        mission, state = data.get("mission_id"), data.get("state")
        if mission is None:
            text = f"{vehicle}: {unborn}"
        elif not state:  # an interrupted mission, which nothing flies
            text = f"{vehicle}: mission {mission} is not resumed by itself any more"
        elif state == until:
            text = f"{vehicle}: mission {mission} {done}"
        else:
            text = f"{vehicle}: mission {mission} {before} (it is {state})"
        lasts = "" if data.get("durable", True) else "; not on disk: it would not outlive a restart of the computer"
        return text + lasts

    return sentence


def _resumed(data: Data, vehicle: str) -> str:
    state = f" (it is {data['state']})" if data.get("state") else ""
    return f"{vehicle}: mission {data['mission_id']} goes on{state}"


def _shot_is(done: str) -> Callable[[Data, str], str]:
    return lambda data, vehicle: f"{vehicle}: shot {data['shot']} {done} in mission {data['mission_id']}"


def _status(data: Data, vehicle: str) -> str:
    lines = [f"{vehicle}: {data['state']}" + (f": {data['reason']}" if data.get("reason") else "")]
    if data.get("mission_id"):
        named = f' "{data["name"]}"' if data.get("name") else ""
        began = local_time(str(data["mission_id"]))
        named += f" (began {began} local time)" if began else ""
        done = f"{data['shots_done']} of {_many(data['shots_total'], 'shot')} done"
        retaken = f", {_many(data['retakes'], 'retake')}" if data.get("retakes") else ""
        left = f", about {_minutes(data['eta_s'])} left" if data.get("eta_s") else ""
        lines.append(f"mission {data['mission_id']}{named}: {done}{retaken}{left}")
    if data.get("resumable"):
        lines.append(f"mission {data['resumable']} can be resumed: panoexec resume")
    link = data.get("link") or {}
    bad = [name for name, one in link.items() if not one["ok"]]
    lines.append(f"link: no {', no '.join(bad)}" if bad else "link: autopilot, gimbal and camera answer")
    if data.get("battery_frac") is not None:
        lines.append(f"battery: {100 * data['battery_frac']:.0f} %")
    return "\n".join(lines)


def _many(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 99.5 else f"{seconds / 60:.1f} min"


_START = """Start a mission on a vehicle. What is not given comes from the vehicle's configuration.

Examples:
  panoexec start
  panoexec start --elevation -60 10 --overlap 0.2 --name "quarry, north face"
  panoexec start --preset roof
  panoexec start --plan plan.json"""

VERBS: Final[Mapping[str, Verb]] = MappingProxyType(
    {
        verb.name: verb
        for verb in (
            Verb(
                name="start",
                request="start",
                text=_START,
                declare=_of_start,
                fields=_start_fields,
                sentence=_started,
            ),
            Verb(
                name="pause",
                request="pause",
                text="Hold a mission after the current photo, until `resume`.",
                declare=_of_stop,
                fields=_reason,
                sentence=_stopped(
                    "is paused",
                    "pauses after the current photo",
                    "no mission has begun yet; one that is being planned pauses before anything moves",
                    until="paused",
                ),
            ),
            Verb(
                name="resume",
                request="resume",
                text="Continue a mission after a pause, or the interrupted mission that `status` shows.",
                declare=_nothing,
                fields=_no_fields,
                sentence=_resumed,
            ),
            Verb(
                name="skip",
                request="skip",
                text="Skip a shot: the current one if none is given.",
                declare=_of_shot,
                fields=_shot,
                sentence=_shot_is("is skipped"),
            ),
            Verb(
                name="repeat",
                request="repeat",
                text="Take a shot again: the last accepted one if none is given.",
                declare=_of_shot,
                fields=_shot,
                sentence=_shot_is("is taken again"),
            ),
            Verb(
                name="finish",
                request="finish",
                text="End shooting and accept the gaps; exports and report are written.",
                declare=_of_stop,
                fields=_reason,
                sentence=_stopped(
                    "finishes: results are being written",
                    "finishes",
                    "no mission has begun yet; one that is being planned finishes before anything moves",
                    until="finishing",
                ),
            ),
            Verb(
                name="abort",
                request="abort",
                text="End a mission for good, at once.",
                declare=_of_stop,
                fields=_reason,
                sentence=_stopped(
                    "is aborted", "is being aborted", "no mission had begun; the start is called off", until="aborted"
                ),
            ),
            Verb(
                name="status",
                request="get",
                text="Say what a vehicle is doing.",
                declare=_nothing,
                fields=_no_fields,
                sentence=_status,
            ),
        )
    }
)
"""By name."""
