"""Commands of browsers on their way to vehicles, their answers, and the log of who commanded what."""

from __future__ import annotations

import asyncio
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

from panoexec.errors import LinkError
from panoexec.mqtt.senders import WEB, sender_of
from panoexec.web.audience import Browser, Browsers
from panoexec.web.broker import BrokerLink, Response
from panoexec.web.fleet import Fleet
from panoexec.web.protocol import VIEWER_COMMANDS, Command, Stage, clean_name, encode
from panoexec.web.values import table, text

_WAIT_S: Final = {"plan": 320.0, "start": 320.0, "doctor": 120.0}
_USUAL_WAIT_S: Final = 30.0
_REASONS: Final = frozenset({"pause", "finish", "abort"})
_SILENT: Final = frozenset({"get", "missions", "presets", "thumbnails", "plan"})
"""Commands without an effect: not in the log."""

_LOG_LINES: Final = 100
_REMEMBERED: Final = 2_000
_WITH_DATA: Final = 30
"""So many of the newest keep the data of their answer: a plan may have 100 kB."""

_WAITING_MOST: Final = 64
_A_MINUTE: Final = 60
"""Commands of one browser a minute."""


@dataclass(slots=True, kw_only=True)
class Entry:
    """A command and what became of it."""

    id: str
    who: str
    vehicle: str
    command: str
    fields: dict[str, Any]
    time: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))
    stage: Stage = "sent"
    error: dict[str, Any] | None = None
    data: Any = None
    askers: set[Browser] = field(default_factory=set)

    def document(self) -> dict[str, Any]:
        """For the log."""
        fields = {name: value for name, value in self.fields.items() if name != "plan"}
        out = {name: getattr(self, name) for name in ("id", "time", "who", "vehicle", "command", "stage", "error")}
        return out | {"fields": fields}


class Commands:
    """Takes commands of browsers; each waits for its answer in a task of its own."""

    def __init__(self, *, link: BrokerLink, fleet: Fleet, browsers: Browsers, spawn: Callable[[Any], object]) -> None:
        """Describe it.

        Args:
            link: to the broker.
            fleet: the vehicles.
            browsers: get the log.
            spawn: starts a task that ends with the server.
        """
        self._link = link
        self._fleet = fleet
        self._browsers = browsers
        self._spawn = spawn
        self._entries: OrderedDict[str, Entry] = OrderedDict()
        self._waiting: dict[str, asyncio.Future[Response]] = {}
        self._logs: dict[str, deque[Entry]] = {}
        self._starting: Counter[str] = Counter()

    def log(self, vehicle: str) -> list[dict[str, Any]]:
        """What was commanded, oldest first."""
        return [entry.document() for entry in self._logs.get(vehicle, ())]

    def is_starting(self, vehicle: str) -> bool:
        """Whether a `start` waits for its answer."""
        return self._starting.get(vehicle, 0) > 0

    # --- from browsers

    def take(self, browser: Browser, command: Command) -> None:
        """Take a command; the same id again only tells what became of it."""
        who = browser.user.name or browser.name
        known = self._entries.get(command.id)
        if known is not None:
            if (known.who, known.vehicle, known.command, known.fields) != (
                who, command.vehicle, command.command, command.fields,
            ):  # fmt: skip
                self._answer(browser, Entry(who=who, **_parts(command)), "conflict", "this id was used already")
                return
            known.askers.add(browser)
            browser.put(_answer_message(known))
            return
        entry = Entry(who=who, **_parts(command))
        entry.askers.add(browser)
        refusal = self._refusal(browser, command)
        if refusal is not None:
            self._answer(browser, entry, *refusal)
            return
        self._entries[entry.id] = entry
        for old in list(self._entries.values())[-_WITH_DATA - 1 : -_WITH_DATA]:
            old.data = None
        while len(self._entries) > _REMEMBERED:
            self._entries.popitem(last=False)
        self._told(entry)
        self._spawn(self._run(entry, response_topic=f"web-{id(browser):x}" if command.command == "plan" else ""))

    def gone(self, browser: Browser) -> None:
        """A browser went; its commands go on."""
        for entry in self._entries.values():
            entry.askers.discard(browser)

    def _refusal(self, browser: Browser, command: Command) -> tuple[str, str] | None:  # noqa: PLR0911
        if browser.user.role != "operator" and command.command not in VIEWER_COMMANDS:
            return "role", f"{browser.user.name or 'a viewer'} may look, but not command"
        now = time.monotonic()
        recent = sum(1 for one in browser.commands if now - one < 60.0)
        if recent >= _A_MINUTE and command.command not in _REASONS:
            return "rate", f"more than {_A_MINUTE} commands a minute"
        browser.commands.append(now)
        if len(self._waiting) >= _WAITING_MOST and command.command not in _REASONS:
            return "overload", "too many commands wait for an answer"
        vehicle = self._fleet.vehicles.get(command.vehicle)
        if vehicle is None:
            return "unknown_vehicle", f"nothing was heard from {command.vehicle} on this broker"
        if not self._link.up:
            return "no_link", self._link.reason
        if vehicle.status == "offline":
            return "offline", f"{command.vehicle} is offline: its daemon is not connected to the broker"
        return None

    def _answer(self, browser: Browser, entry: Entry, code: str, message: str) -> None:
        entry.stage, entry.error = "failed", {"code": code, "message": message, "field": None}
        browser.put(_answer_message(entry))

    # --- to vehicles

    async def _run(self, entry: Entry, *, response_topic: str) -> None:
        transaction = f"{WEB}/{entry.who}/{entry.id}"
        wait_s = _WAIT_S.get(entry.command, _USUAL_WAIT_S)
        future: asyncio.Future[Response] = asyncio.get_running_loop().create_future()
        self._waiting[transaction] = future
        fields = {"transaction": transaction} | entry.fields
        if entry.command in _REASONS:
            given = entry.fields.get("reason")
            told = f"by {entry.who}" + (f": {given}" if isinstance(given, str) and given else "")
            fields["reason"] = told[:200] if given is None or isinstance(given, str) else given
        if entry.command == "start":
            self._count_start(entry.vehicle, 1)
        try:
            async with asyncio.timeout(wait_s):
                await self._link.request(
                    entry.vehicle, entry.command, fields, expiry_s=int(wait_s), response_topic=response_topic
                )
                self._staged(entry, "received")
                response = await future
        except LinkError as error:
            self._failed(entry, "no_link", str(error))
        except (TypeError, ValueError) as error:
            self._failed(entry, "invalid", f"cannot be sent: {error}")
        except TimeoutError:
            self._failed(entry, "unanswered", f"{entry.vehicle} did not answer within {wait_s:.0f} s")
        else:
            self._settle(entry, response)
        finally:
            self._waiting.pop(transaction, None)
            if entry.command == "start":
                self._count_start(entry.vehicle, -1)

    def _count_start(self, vehicle: str, change: int) -> None:
        self._starting[vehicle] += change
        self._fleet.tell_again(vehicle)

    def _settle(self, entry: Entry, response: Response) -> None:
        error = table(response.document.get("error"))
        if response.document.get("status") == "ok":
            entry.data = response.document.get("data")
            self._staged(entry, "done")
            return
        entry.error = {name: text(error.get(name)) or None for name in ("code", "message", "field")}
        self._staged(entry, "refused")

    def _failed(self, entry: Entry, code: str, message: str) -> None:
        entry.error = {"code": code, "message": message, "field": None}
        self._staged(entry, "failed")

    def _staged(self, entry: Entry, stage: Stage) -> None:
        if entry.stage in {"done", "refused"}:
            return
        entry.stage = stage
        self._told(entry)
        if stage != "received":
            entry.askers.clear()
            entry.data = entry.data if entry.command in {"plan", "start"} else None

    def _told(self, entry: Entry) -> None:
        message = _answer_message(entry)
        for browser in entry.askers:
            browser.put(message)
        if entry.command in _SILENT:
            return
        log = self._logs.setdefault(entry.vehicle, deque(maxlen=_LOG_LINES))
        if entry not in log:
            log.append(entry)
        self._browsers.tell(entry.vehicle, encode("log", vehicle=entry.vehicle, entry=entry.document()))

    # --- from vehicles

    def hear(self, response: Response) -> None:
        """Take an answer; one to somebody else goes into the log."""
        transaction = response.document.get("transaction")
        future = self._waiting.get(transaction) if isinstance(transaction, str) else None
        if future is not None:
            if not future.done():
                future.set_result(response)
            return
        self._note_others(response, text(transaction, 128) or text(str(transaction), 128))

    def _note_others(self, response: Response, transaction: str) -> None:
        if response.command in _SILENT or response.command in {"doctor", "unknown"} or not transaction:
            return
        who, own = sender_of(transaction), transaction.rpartition("/")[2]
        if transaction.startswith(f"{WEB}/") and who and (late := self._entries.get(own)) is not None:
            if late.stage == "failed" and late.vehicle == response.vehicle and late.command == response.command:
                late.error = None  # it came after all
                self._settle(late, response)
            return
        if any(entry.id == transaction for entry in self._logs.get(response.vehicle, ())):
            return
        name = clean_name(who) if who else "another ground station"
        entry = Entry(id=transaction, who=name, vehicle=response.vehicle, command=response.command, fields={})
        self._settle(entry, response)
        entry.data = None


def _parts(command: Command) -> dict[str, Any]:
    return {"id": command.id, "vehicle": command.vehicle, "command": command.command, "fields": command.fields}


def _answer_message(entry: Entry) -> str:
    return encode(
        "answer",
        id=entry.id,
        vehicle=entry.vehicle,
        command=entry.command,
        stage=entry.stage,
        error=entry.error,
        data=entry.data,
    )
