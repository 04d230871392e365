"""What `watch` shows of vehicles: progress and the last attempts of one, a line each of many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from panoexec.cli.output import minutes
from panoexec.cli.sphere_map import HEIGHT, MARKS, WIDTH, Mark, SphereMap
from panoexec.errors import InputFileError
from panoexec.inputs.plan_file import PlanFile, plan_from_data
from panoexec.mission.log.shot_marks import marks_from_text

ENDED: Final = {"complete": 0, "incomplete": 1, "aborted": 1, "failed": 3}
"""States in which a mission is over, with the exit code of `watch`."""

_FLYING: Final = frozenset({"preflight", "capturing", "paused", "finishing"})
_LAST_ATTEMPTS: Final = 12
_STYLES: Final = {
    "accepted": "green",
    "rejected": "yellow",
    "missed": "bold red",
    "skipped": "dim",
    "interrupted": "yellow",
    "complete": "bold green",
    "incomplete": "bold yellow",
    "aborted": "bold yellow",
    "failed": "bold red",
    "paused": "yellow",
    "offline": "bold red",
    "online": "green",
}
_VERDICTS: Final = {
    "shot_started": "slewing",
    "shot_exposed": "taken",
    "shot_accepted": "accepted",
    "shot_rejected": "rejected",
    "shot_interrupted": "interrupted",
    "shot_missed": "missed",
    "shot_retaken": "again",
    "shot_skipped": "skipped",
}


_MARKS: Final = {
    "slewing": Mark.CURRENT,
    "taken": Mark.CURRENT,
    "accepted": Mark.DONE,
    "again": Mark.AGAIN,
    "rejected": Mark.AGAIN,
    "interrupted": Mark.AGAIN,
    "missed": Mark.MISSING,
    "skipped": Mark.MISSING,
}
_ROOM_LINES: Final = 6
_LEAST_ATTEMPTS: Final = 3
"""Below the map there is room for so many at least, and for a few lines besides."""


@dataclass(slots=True)
class Attempt:
    """One attempt at a shot, as its events tell it."""

    shot: int
    number: int
    pose: str = ""
    verdict: str = ""
    error: str = ""
    reason: str = ""


@dataclass(slots=True)
class Watched:
    """What was heard of one vehicle.

    Attributes:
        status: online or offline; "" before either was heard.
        state: the newest.
        events: each once, in the order in which they came.
        ended: the state in which the mission that was watched ended; "" before.
        finished: the last event of that mission was heard.
        last: what happened last besides shots.
        attempts: by shot and number, in the order in which they began.
        plan: of the mission, None before it was heard.
        sphere: draws it.
    """

    status: str = ""
    state: dict[str, Any] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    ended: str = ""
    finished: bool = False
    last: str = ""
    attempts: dict[tuple[int, int], Attempt] = field(default_factory=dict)
    plan: PlanFile | None = None
    sphere: SphereMap | None = None
    _seen: set[str] = field(default_factory=set)
    _flying: bool = False

    def hear(self, kind: str, document: Any) -> None:
        """Take a message; a repeated event is dropped."""
        if kind == "status":
            self.status = str(document)
        elif kind == "state" and isinstance(document, dict):
            self.state = document
            state = str(document.get("state"))
            if state in ENDED and self._flying:
                self.ended = state
            self._flying = self._flying or state in _FLYING
        elif kind == "plan":
            self._take_plan(document)
        elif kind == "event" and isinstance(document, dict) and str(document.get("id")) not in self._seen:
            self._seen.add(str(document.get("id")))
            self.events.append(document)
            self._tell(document)

    def _take_plan(self, document: Any) -> None:
        try:
            self.plan = plan_from_data(document, source="plan")
        except InputFileError:  # none any more, or a stranger's
            self.plan = None
        camera = None if self.plan is None else self.plan.camera
        self.sphere = None if camera is None else SphereMap(camera)

    def marks(self) -> dict[int, Mark]:
        """What the map shows of each shot: as the state tells, else as far as its attempts were heard."""
        total, text = self.state.get("shots_total"), self.state.get("shots")
        if isinstance(total, int) and isinstance(text, str) and (told := marks_from_text(text, count=total)):
            return {index: MARKS[standing] for index, standing in enumerate(told)}
        out: dict[int, Mark] = {}
        for (shot, number), attempt in self.attempts.items():
            again = out.get(shot) in (Mark.DONE, Mark.RETAKEN)  # the earlier photo counts until a new one does
            mark = _MARKS.get(attempt.verdict, Mark.PENDING)
            if mark is Mark.DONE and number > 1:
                mark = Mark.RETAKEN
            if not (again and mark in (Mark.AGAIN, Mark.PENDING)):
                out[shot] = mark
        return out

    def _tell(self, event: Mapping[str, Any]) -> None:
        kind = str(event.get("type"))
        self.finished = kind == "mission_finished"
        if kind == "mission_started":
            self.attempts.clear()
        if not isinstance(event.get("shot"), int) or not isinstance(event.get("attempt"), int):
            told = event.get("reason") or event.get("text") or "; ".join(map(str, event.get("problems") or ()))
            self.last = f"{kind.replace('_', ' ')}{f': {told}' if told else ''}"
            return
        key = event["shot"], event["attempt"]
        one = self.attempts.setdefault(key, Attempt(shot=key[0], number=key[1]))
        one.verdict = _VERDICTS.get(kind, one.verdict)
        if kind == "shot_started":
            one.pose = f"{_angle(event.get('pitch_deg'))} {_angle(event.get('yaw_deg'))}"
        elif kind == "shot_exposed" and isinstance(errors := event.get("errors"), dict):
            one.error = " ".join(_angle(errors.get(f"{axis}_deg"), digits=2) for axis in ("pitch", "roll", "yaw"))
        if kind in ("shot_rejected", "shot_interrupted", "shot_missed", "shot_skipped"):
            one.reason = str(event.get("reason") or "")


def mission_view(name: str, one: Watched, *, room: tuple[int, int] = (0, 0), colours: bool = False) -> Group:
    """One vehicle: where its mission stands, and the last attempts.

    Args:
        name: its id.
        one: what was heard.
        room: columns and lines of the terminal: with enough of both, the sphere is drawn too.
        colours: of the sphere.
    """
    state = one.state
    total, done = state.get("shots_total") or 0, state.get("shots_done") or 0
    head = Table.grid(padding=(0, 2))
    head.add_row(
        Text(name, style="bold"),
        _styled(one.status or "unknown"),
        _styled(str(state.get("state", ""))),
        Text(str(state.get("reason") or "")),
    )
    parts: list[RenderableType] = [head]
    most = _LAST_ATTEMPTS
    if (
        one.sphere is not None
        and one.plan is not None
        and room[0] >= WIDTH
        and room[1] >= HEIGHT + _ROOM_LINES + _LEAST_ATTEMPTS
    ):
        most = min(most, room[1] - HEIGHT - _ROOM_LINES)
        parts.insert(0, one.sphere.text(one.plan.shots, one.marks(), colours=colours))
    if total:
        bar = Table.grid(padding=(0, 2))
        eta = state.get("eta_s")
        bar.add_row(
            ProgressBar(total=total, completed=done, width=40),
            f"{done}/{total}",
            f"{state.get('retakes', 0)} retakes",
            "" if eta is None else f"{minutes(eta)} left",
        )
        parts.append(bar)
    parts.append(Text(_links(state), style="dim"))
    if one.attempts:
        parts.append(_attempts(one, most))
    if one.last:
        parts.append(Text(one.last))
    return Group(*parts)


def _attempts(one: Watched, most: int) -> Table:
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    for column in ("shot", "attempt", "pitch, yaw", "verdict", "error p r y", "reason"):
        table.add_column(column, justify="right" if column in ("shot", "attempt") else "left")
    for attempt in list(one.attempts.values())[-most:]:
        table.add_row(
            str(attempt.shot),
            str(attempt.number),
            attempt.pose,
            _styled(attempt.verdict),
            attempt.error,
            Text(attempt.reason),
        )
    return table


def fleet_view(vehicles: Mapping[str, Watched]) -> Table:
    """A line for each vehicle."""
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    for column in ("vehicle", "status", "state", "shots", "retakes", "left", "links", "battery", "reason"):
        table.add_column(column)
    for name, one in sorted(vehicles.items()):
        state = one.state
        eta = state.get("eta_s")
        table.add_row(
            name,
            _styled(one.status or "unknown"),
            _styled(str(state.get("state", ""))),
            f"{state.get('shots_done', 0)}/{state.get('shots_total', 0)}",
            str(state.get("retakes", 0)),
            "" if eta is None else minutes(eta),
            _gone(state),
            "-" if state.get("battery_frac") is None else f"{100 * state['battery_frac']:.0f} %",
            Text(str(state.get("reason") or "")),
        )
    return table


def _links(state: Mapping[str, Any]) -> str:
    """Which links work, and the battery: `autopilot ok, gimbal ok, camera gone, battery 74 %`."""
    links = state.get("link") or {}
    told = [f"{name} {'ok' if (links.get(name) or {}).get('ok') else 'gone'}" for name in links]
    battery = state.get("battery_frac")
    return ", ".join([*told, *([] if battery is None else [f"battery {100 * battery:.0f} %"])])


def _gone(state: Mapping[str, Any]) -> str:
    links = state.get("link") or {}
    gone = [name for name in links if not (links.get(name) or {}).get("ok")]
    return f"no {', '.join(gone)}" if gone else "ok" if links else ""


def _styled(text: str) -> Text:
    return Text(text, style=_STYLES.get(text, ""))


def _angle(value: object, *, digits: int = 1) -> str:
    return f"{value:+.{digits}f}°" if isinstance(value, (int, float)) else "?"
