"""Stopping requests (`abort`, `finish`, `pause`): executed on arrival, whatever else the daemon does.

They wait for no other request, no plan and no disk: a stop changes what is requested of the mission at once, in the
callback in which it arrives. Only the response waits, briefly, for the journal and the transaction store.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal

import structlog

from panoexec.daemon.beginnings import Beginning, StopCommand, StopVerb
from panoexec.daemon.error_codes import refusal_of
from panoexec.daemon.missions import Missions
from panoexec.errors import MissionError
from panoexec.mission.executor import Mission
from panoexec.mission.log.states import FINISHED, MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.messages import Response, failed, ok
from panoexec.mqtt.requests import (
    AbortRequest,
    FinishRequest,
    PauseRequest,
    RefusedRequestError,
    StopRequest,
)
from panoexec.mqtt.senders import sender_of
from panoexec.mqtt.transactions import Transactions

DECLINED: Final = "declined mission"

_JOURNAL_S: Final = 0.3
"""How long after its arrival a request is answered without waiting for the journal any longer.

Counted from the arrival, so that a computer that is short of processor time does not add to it.
"""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Effect:
    """What a stop has done.

    Attributes:
        mission: the running mission that got it.
        begins: a mission that is being created gets it.
        mission_id: id of the mission, or of the offered one.
        lost: a failed journal must not make the mission resume by itself.
    """

    mission: Mission | None = None
    begins: bool = False
    mission_id: str | None = None
    lost: str = ""


class Stopping:
    """Executes stopping requests, and knows what they have to stop."""

    def __init__(
        self,
        *,
        missions: Missions,
        transactions: Transactions,
        group: asyncio.TaskGroup,
        respond: Callable[[Incoming, bytes], None],
    ) -> None:
        """Store the collaborators.

        Args:
            missions: executes missions.
            transactions: store of the requests executed before, for duplicates.
            group: task group in which responses wait for the disk.
            respond: publishes a response.
        """
        self._missions = missions
        self._transactions = transactions
        self._group = group
        self._respond = respond
        self._pending: list[Beginning] = []
        self._last: dict[StopVerb, tuple[int, StopCommand]] = {}
        self._declined: str | None = None

    # --- what is to be stopped

    def expect(self, verb: Literal["start", "resume"], incoming: Incoming) -> Beginning:
        """Register a request that will set the vehicle in motion; `forget` it when it was executed.

        It gets the stops that arrived after it and were executed before it.
        """
        beginning = Beginning(verb)
        for arrival, command in self._last.values():
            if arrival > incoming.arrival:
                beginning.stop(command)
        self._pending.append(beginning)
        return beginning

    def forget(self, beginning: Beginning) -> None:
        """The request was executed."""
        self._pending.remove(beginning)

    def call_off(self) -> None:
        """Call off everything that is about to begin, because the process ends."""
        for beginning in self._pending:
            beginning.stop(StopCommand("interrupt", "panoexec was stopped; the mission can be resumed"))

    async def may_auto_resume(self) -> bool:
        """Whether the interrupted mission may resume automatically: the operator has not aborted it."""
        offer = self._missions.offer
        if offer is None or offer.stored_id == self._declined:
            return False
        return await self._transactions.recall(DECLINED) != offer.stored_id

    async def allow_resuming(self) -> None:
        """An operator resumes the mission: an earlier abort of it is obsolete.

        Raises:
            RefusedRequestError: this cannot be stored.
        """
        self._declined = None
        await self._transactions.remember(DECLINED, None)

    # --- one request

    def take(self, request: StopRequest, incoming: Incoming) -> None:
        """Execute a stopping request now and respond within a second.

        Raises:
            RefusedRequestError: another request has its transaction.
        """
        if not self._transactions.enter_stop(request, partial(self._respond, incoming)):
            return
        _log.info("request", command=request.command, transaction=str(request.transaction)[:128])
        done: _Effect | RefusedRequestError
        try:
            incoming.check_fresh()
            done = self._execute(_command(request), incoming)
        except Exception as error:  # noqa: BLE001  (the edge of the service: no request may end the daemon)
            done = refusal_of(error)
            if done.code == "internal":
                _log.exception("internal error while handling the request", command=request.command)
            _log.warning("request failed", command=request.command, code=done.code, error=done.message[:300])
        serving = self._transactions.serve_stop(
            request, self._response(request, done, incoming.received_s), received_s=incoming.received_s
        )
        self._group.create_task(serving, name=f"request {request.command}")

    def _execute(self, command: StopCommand, incoming: Incoming) -> _Effect:
        """Execute a stop; nothing here waits.

        Raises:
            CommandRefusedError: there is nothing to stop.
        """
        self._last[command.verb] = incoming.arrival, command
        missions = self._missions
        begins = missions.beginning is not None and missions.beginning.committed
        pending = dict.fromkeys([*self._pending, *([] if missions.beginning is None else [missions.beginning])])
        for beginning in pending:
            beginning.stop(command)
        refusal = None
        mission = missions.mission
        try:
            missions.stop(command)
        except CommandRefusedError as error:
            refusal = error
        effect = _Effect(mission=mission, begins=begins, mission_id=None if mission is None else _id_of(mission))
        if command.verb == "abort":
            declined = self._decline(mission, refused=refusal is not None)
            if declined is not None:
                effect = _Effect(
                    mission=mission, begins=begins, mission_id=None if pending else declined, lost=declined
                )
                refusal = None
        if refusal is not None and not pending and not incoming.overtakes:
            raise refusal
        return effect

    def _decline(self, mission: Mission | None, *, refused: bool) -> str | None:
        """Keep the mission that an abort ends from resuming automatically; returns its id, None if there is none."""
        if mission is not None:
            record = mission.record
            if refused and (record.asked.end == "abort" or record.state in FINISHED):
                return None
            # also one that is ending by a fault: it could be resumed
            self._declined = record.mission_id
        elif self._missions.offer is not None:
            # it stays on disk and may be resumed by request, but is not resumed automatically
            self._declined = self._missions.offer.stored_id
            self._transactions.remember_later(DECLINED, self._declined)
        else:
            return None
        return self._declined

    async def _response(self, request: StopRequest, done: _Effect | RefusedRequestError, received_s: float) -> Response:
        if isinstance(done, RefusedRequestError):
            return failed(done, request.transaction)
        mission, durable = done.mission, False
        try:
            async with asyncio.timeout_at(received_s + _JOURNAL_S):
                if mission is None and done.begins:
                    mission = await self._missions.under_way()
                if mission is not None:
                    await mission.durable()
                    durable = True
        except TimeoutError:
            _log.warning("the command is not in the journal yet", command=request.command)
        except MissionError as error:
            _log.error("the command is not in the journal", command=request.command, error=str(error))
        if mission is None and not done.begins:
            durable = await self._stored(request, received_s)
        elif done.lost and not durable:
            self._transactions.remember_later(DECLINED, done.lost)
        data: dict[str, Any] = {"mission_id": done.mission_id if mission is None else _id_of(mission)}
        if mission is not None:
            data["state"] = mission.record.state.value
        elif not isinstance(request, AbortRequest):
            data["state"] = MissionState.IDLE.value
        return ok(request.transaction, data | {"durable": durable})

    async def _stored(self, request: StopRequest, received_s: float) -> bool:
        """Whether a stop without a mission outlives the process: nothing begins, or the declined mission is stored."""
        if not isinstance(request, AbortRequest):
            return False  # kept for a mission that does not exist yet
        try:
            async with asyncio.timeout_at(received_s + _JOURNAL_S):
                return await self._transactions.write_back()
        except TimeoutError:
            return False


def _id_of(mission: Mission) -> str:
    return mission.record.mission_id


def _command(request: StopRequest) -> StopCommand:
    by = sender_of(request.transaction)
    match request:
        case AbortRequest():
            return StopCommand("abort", request.reason, by)
        case FinishRequest():
            return StopCommand("finish", request.reason, by)
        case PauseRequest():
            return StopCommand("pause", request.reason, by)
    raise AssertionError(request)
