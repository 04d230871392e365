"""What `watch` shows: progress and the last attempts of one vehicle, or one line per vehicle."""

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
"""Final states of a mission, with the exit code of `watch`."""

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
    "shot_revoked": "rejected",
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
"""Minimum number of attempts that must fit below the map."""


@dataclass(slots=True)
class Attempt:
    """One attempt at a shot, built from its events."""

    shot: int
    number: int
    pose: str = ""
    verdict: str = ""
    error: str = ""
    reason: str = ""


@dataclass(slots=True)
class Watched:
    """The messages received from one vehicle.

    Attributes:
        status: online or offline; "" before the first status message.
        state: the newest state.
        events: all events without duplicates, in order of arrival.
        ended: the final state of the observed mission; "" before its end.
        finished: whether the last event of that mission was received.
        last: text of the last event that does not belong to an attempt.
        attempts: attempts by shot and attempt number, in order of their start.
        plan: the plan of the mission; None before it was received.
        sphere: draws the map of that plan.
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
        """Process a message; a repeated event is dropped."""
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
        except InputFileError:  # empty (no mission), or not a valid plan
            self.plan = None
        camera = None if self.plan is None else self.plan.camera
        self.sphere = None if camera is None else SphereMap(camera)

    def marks(self) -> dict[int, Mark]:
        """The mark of each shot: from the state if it lists the shots, else from the received attempts."""
        total, text = self.state.get("shots_total"), self.state.get("shots")
        if isinstance(total, int) and isinstance(text, str) and (told := marks_from_text(text, count=total)):
            return {index: MARKS[standing] for index, standing in enumerate(told)}
        out: dict[int, Mark] = {}
        for (shot, number), attempt in self.attempts.items():
            again = out.get(shot) in (Mark.DONE, Mark.RETAKEN)  # the earlier photo counts until a new one is accepted
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
        if kind in ("shot_rejected", "shot_revoked", "shot_interrupted", "shot_missed", "shot_skipped"):
            one.reason = str(event.get("reason") or "")


def mission_view(name: str, one: Watched, *, room: tuple[int, int] = (0, 0), colours: bool = False) -> Group:
    """The view of one vehicle: mission progress and the last attempts.

    Args:
        name: the vehicle's id.
        one: the received messages.
        room: columns and lines of the terminal; the map is drawn only if it fits.
        colours: whether to draw the map in colour.
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
    """The view of a fleet: one line per vehicle."""
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
    """Links and battery: `autopilot ok, gimbal ok, camera lost, battery 74 %`."""
    links = state.get("link") or {}
    told = [f"{name} {'ok' if (links.get(name) or {}).get('ok') else 'lost'}" for name in links]
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
