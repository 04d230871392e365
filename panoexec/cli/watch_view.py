"""What `watch` shows: progress and the last attempts of one vehicle, or one line per vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Final

from rich.console import Group, JustifyMethod, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from panoexec.cli.output import counted, local_time, minutes
from panoexec.mqtt.senders import received

if TYPE_CHECKING:
    from panoexec.cli.sphere_map import Mark, SphereMap
    from panoexec.cli.watch_map import MapPlan

# what draws maps is imported when a plan is drawn: `watch` is to show at once that it listens

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

_ROOM_LINES: Final = 6
"""Head, bar, links, heading of the table, last event and keys."""
_LEAST_ATTEMPTS: Final = 3
"""Minimum number of attempts that must fit below the map."""
_WIDE: Final = 90
"""Columns from which a table has all its columns."""
_BAR: Final = 40
_REASON_LINES: Final = 3


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
        plan: the plan of the mission; None before it is drawn for the first time.
        sphere: draws the map of that plan, in the size that was last asked for.
    """

    status: str = ""
    state: dict[str, Any] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)
    ended: str = ""
    finished: bool = False
    last: str = ""
    attempts: dict[tuple[int, int], Attempt] = field(default_factory=dict)
    plan: MapPlan | None = None
    sphere: SphereMap | None = None
    _document: Any = None
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
            self._document, self.plan, self.sphere = document, None, None
        elif kind == "event" and isinstance(document, dict) and str(document.get("id")) not in self._seen:
            self._seen.add(str(document.get("id")))
            self.events.append(document)
            self._tell(document)

    def map(self, room: tuple[int, int], *, beside: int) -> SphereMap | None:
        """What draws the map of the plan.

        Args:
            room: columns and lines of the terminal.
            beside: lines that are needed for something else.

        Returns:
            None without a plan whose camera is known, or without room.
        """
        if not room[0] or (self.plan is None and self._document is None):
            return None  # without a terminal nothing is drawn, and a plan is not even read
        from panoexec.cli import watch_map  # noqa: PLC0415

        if self.plan is None:
            self.plan, self._document = watch_map.plan_of(self._document), None
        if self.plan is None:
            return None
        self.sphere = watch_map.sphere_for(self.plan, self.sphere, room, beside=beside)
        return self.sphere

    def marks(self) -> dict[int, Mark]:
        """The mark of each shot: from the state if it lists the shots, else from the received attempts."""
        from panoexec.cli import watch_map  # noqa: PLC0415

        return watch_map.marks_of(self.state, ((key, one.verdict) for key, one in self.attempts.items()))

    def _tell(self, event: Mapping[str, Any]) -> None:
        kind = str(event.get("type"))
        self.finished = kind == "mission_finished"
        if kind == "mission_started":
            self.attempts.clear()
        if not isinstance(event.get("shot"), int) or not isinstance(event.get("attempt"), int):
            if kind == "command_received":
                self.last = received(event)
                return
            told = event.get("reason") or event.get("text") or "; ".join(map(str, event.get("problems") or ()))
            self.last = f"{kind.replace('_', ' ')}{f': {told}' if told else ''}"
            return
        key = event["shot"], event["attempt"]
        if kind not in _VERDICTS and key not in self.attempts:
            return  # of a photo whose attempt was over before anybody watched: there is nothing to say in its line
        one = self.attempts.setdefault(key, Attempt(shot=key[0], number=key[1]))
        one.verdict = _VERDICTS.get(kind, one.verdict)
        if kind == "shot_started":
            one.pose = f"{_angle(event.get('pitch_deg'))} {_angle(event.get('yaw_deg'))}"
        elif kind == "shot_exposed" and isinstance(errors := event.get("errors"), dict):
            one.error = " ".join(_angle(errors.get(f"{axis}_deg"), digits=2) for axis in ("pitch", "roll", "yaw"))
        if kind in ("shot_rejected", "shot_revoked", "shot_interrupted", "shot_missed", "shot_skipped"):
            one.reason = str(event.get("reason") or "")


def mission_view(
    name: str, one: Watched, *, room: tuple[int, int] = (0, 0), colours: bool = False, note: str = ""
) -> Group:
    """The view of one vehicle: mission progress and the last attempts.

    Args:
        name: the vehicle's id.
        one: the received messages.
        room: columns and lines of the terminal, (0, 0) without one; what does not fit is left out.
        colours: whether to draw the map in colour.
        note: last line, about keys.
    """
    state = one.state
    narrow = 0 < room[0] < _WIDE
    reason = _wrapped(str(state.get("reason") or ""), room[0]) if room[0] else []
    lines = _ROOM_LINES + len(reason)
    parts: list[RenderableType] = [_head(name, one, alone=not room[0]), *reason]
    most = min(_LAST_ATTEMPTS, max(room[1] - lines, 1)) if room[1] else _LAST_ATTEMPTS
    sphere = one.map(room, beside=lines + _LEAST_ATTEMPTS)
    if sphere is not None and one.plan is not None:
        most = min(most, room[1] - sphere.lines - lines)
        north = state.get("reference") == "north"
        parts.insert(0, sphere.text(one.plan.shots, one.marks(), colours=colours, north=north))
    total, done = state.get("shots_total") or 0, state.get("shots_done") or 0
    if total:
        bar = Table.grid(padding=(0, 2))
        eta = state.get("eta_s")
        texts = (
            f"{done}/{total}",
            counted(state.get("retakes") or 0, "retake"),
            "" if eta is None else f"{minutes(eta)} left",
        )
        width = min(_BAR, max(6, room[0] - sum(len(text) + 2 for text in texts))) if room[0] else _BAR
        bar.add_row(ProgressBar(total=total, completed=done, width=width), *texts)
        parts.append(bar)
    parts.append(_line(_links(state), "dim"))
    if one.attempts:
        parts.append((_short_attempts if narrow else _attempts)(one, most))
    if one.last:
        parts.append(_line(one.last))
    if note:
        parts.append(_line(note, "bold"))
    return Group(*parts)


def _head(name: str, one: Watched, *, alone: bool) -> Table:
    """Vehicle, status and state; without a terminal (`alone`) also why it is in this state."""
    head = Table.grid(padding=(0, 2))
    head.add_row(
        _line(name, "bold"),
        _styled(one.status or "unknown"),
        _styled(str(one.state.get("state", ""))),
        Text(str(one.state.get("reason") or "") if alone else ""),
    )
    return head


def _wrapped(text: str, columns: int) -> list[Text]:
    """Text in as many lines as it takes, but not more than a terminal can spare."""
    return [Text(line) for line in wrap(" ".join(text.split()), columns, max_lines=_REASON_LINES, placeholder=" …")]


def _line(text: str, style: str = "") -> Text:
    """Text that takes exactly one line, cut off where the terminal ends."""
    return Text(" ".join(text.split()), style=style, no_wrap=True, overflow="ellipsis")


def _attempts(one: Watched, most: int) -> Table:
    table = Table(box=None, padding=(0, 2), pad_edge=False)
    for column in ("shot", "attempt", "pitch, yaw", "verdict", "error p r y", "reason"):
        # only the last one gives way where there is too little room
        justify: JustifyMethod = "right" if column in ("shot", "attempt") else "left"
        table.add_column(column, justify=justify, no_wrap=column != "reason")
    for attempt in list(one.attempts.values())[-most:]:
        table.add_row(
            str(attempt.shot),
            str(attempt.number),
            attempt.pose,
            _styled(attempt.verdict),
            attempt.error,
            _line(attempt.reason),
        )
    return table


def _short_attempts(one: Watched, most: int) -> Table:
    """For a narrow terminal: where it points only while that is news, the error only of what has no reason."""
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    for column in ("shot", "try", "verdict"):
        table.add_column(column, justify="left" if column == "verdict" else "right", no_wrap=True)
    table.add_column("why, error p r y, or pose")
    for attempt in list(one.attempts.values())[-most:]:
        told = attempt.reason or attempt.error or attempt.pose
        table.add_row(str(attempt.shot), str(attempt.number), _styled(attempt.verdict), _line(told))
    return table


_FLEET: Final = ("vehicle", "status", "state", "shots", "retakes", "left", "links", "battery", "reason")
_FLEET_NARROW: Final = ("vehicle", "status", "state", "shots", "left", "reason")


def fleet_view(vehicles: Mapping[str, Watched], *, columns: int = 0) -> Table:
    """The view of a fleet: one line per vehicle.

    Args:
        vehicles: by id.
        columns: of the terminal, 0 without one.
    """
    shown = _FLEET_NARROW if 0 < columns < _WIDE else _FLEET
    table = Table(box=None, padding=(0, 1 if shown is _FLEET_NARROW else 2), pad_edge=False)
    for column in shown:
        table.add_column(column, no_wrap=shown is _FLEET_NARROW and column != "reason")
    for name, one in sorted(vehicles.items()):
        state = one.state
        eta, gone = state.get("eta_s"), _gone(state)
        reason = str(state.get("reason") or "")
        cells: dict[str, RenderableType] = {
            "vehicle": name,
            "status": _styled(one.status or "unknown"),
            "state": _styled(str(state.get("state", ""))),
            "shots": f"{state.get('shots_done', 0)}/{state.get('shots_total', 0)}",
            "retakes": str(state.get("retakes", 0)),
            "left": "" if eta is None else minutes(eta),
            "links": gone,
            "battery": "-" if state.get("battery_frac") is None else f"{100 * state['battery_frac']:.0f} %",
            "reason": Text(reason) if shown is _FLEET else _line(reason or ("" if gone == "ok" else gone)),
        }
        table.add_row(*(cells[column] for column in shown))
    return table


def _links(state: Mapping[str, Any]) -> str:
    """Links, battery and beginning: `autopilot ok, gimbal ok, camera lost, battery 74 %, began 09:46 local time`."""
    links = state.get("link") or {}
    told = [f"{name} {'ok' if (links.get(name) or {}).get('ok') else 'lost'}" for name in links]
    battery = state.get("battery_frac")
    told += [] if battery is None else [f"battery {100 * battery:.0f} %"]
    began = local_time(str(state.get("mission_id") or ""))
    return ", ".join([*told, *([f"began {began} local time"] if began else [])])


def _gone(state: Mapping[str, Any]) -> str:
    links = state.get("link") or {}
    gone = [name for name in links if not (links.get(name) or {}).get("ok")]
    return f"no {', '.join(gone)}" if gone else "ok" if links else ""


def _styled(text: str) -> Text:
    return Text(text, style=_STYLES.get(text, ""))


def _angle(value: object, *, digits: int = 1) -> str:
    return f"{value:+.{digits}f}°" if isinstance(value, (int, float)) else "?"
