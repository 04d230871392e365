"""Executes MQTT requests: each one is answered, and no request, however malformed, can stop the daemon."""

from __future__ import annotations

import asyncio
import json
import time
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import structlog

from panoexec.daemon.error_codes import refusal_of
from panoexec.daemon.errors import MissionBusyError
from panoexec.daemon.mission_request import chosen_profile, settings_of, spec_of
from panoexec.daemon.missions import Missions
from panoexec.daemon.planner import plan_apart
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import camera_to_data
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.mission.executor import Mission
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mqtt.answers import planned
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.messages import Response, dump, failed, ok
from panoexec.mqtt.requests import (
    AbortRequest,
    FinishRequest,
    PauseRequest,
    PlanRequest,
    RefusedRequestError,
    RepeatRequest,
    Request,
    ResumeRequest,
    SetProfileRequest,
    SkipRequest,
    StartRequest,
    parse_request,
)
from panoexec.mqtt.transactions import Transactions
from panoexec.planning.model import Plan

CAMERA: Final = "camera"
DECLINED: Final = "declined mission"

_KEPT_PLANS: Final = 4

_log = structlog.get_logger(__name__)


class Commands:
    """Executes requests.

    Attributes:
        camera: set by `set_profile`; None = the configured one.
    """

    def __init__(
        self,
        *,
        config: Callable[[], Config],
        missions: Missions,
        vehicle: VehicleLink,
        transactions: Transactions,
        group: asyncio.TaskGroup,
        respond: Callable[[Incoming, bytes], None],
        refresh: Callable[[], dict[str, Any]],
        check: Callable[[Request], None] = lambda _: None,
    ) -> None:
        """Store the collaborators.

        Args:
            config: returns the current configuration.
            missions: executes missions.
            vehicle: connection to the vehicle and its devices.
            transactions: store of the requests executed before, for duplicates.
            group: task group in which requests run.
            respond: publishes a response.
            refresh: publishes state and plan again and returns the state.
            check: raises what forbids a request at present.
        """
        self.camera: str | dict[str, Any] | None = None
        self._config = config
        self._missions = missions
        self._vehicle = vehicle
        self._transactions = transactions
        self._group = group
        self._respond = respond
        self._refresh = refresh
        self._check = check
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._planning = asyncio.Lock()
        self._starting: asyncio.Task[Plan] | None = None

    async def restore(self) -> None:
        """Restore the camera profile that was set before a restart."""
        text = await self._transactions.recall(CAMERA)
        self.camera = json.loads(text) if text else None

    # --- one request

    def take(self, incoming: Incoming) -> None:
        """Take a request as it came; returns at once and never raises."""
        try:
            request = parse_request(incoming.command, incoming.payload, retained=incoming.retained, size=incoming.size)
            is_new = self._transactions.enter(request, partial(self._respond, incoming))
        except RefusedRequestError as error:
            _log.warning("request refused", command=incoming.command[:60], code=error.code, error=error.message[:300])
            self._respond(incoming, dump(failed(error)))
            return
        if is_new:
            serving = self._transactions.serve(request, partial(self._response_to, request, incoming))
            self._group.create_task(serving, name=f"request {request.command}")

    async def _response_to(self, request: Request, incoming: Incoming) -> Response:
        """Execute the request unless it has expired; every failure becomes a response."""
        try:
            _check_fresh(incoming)
            self._check(request)
            return ok(request.transaction, await self._execute(request))
        except Exception as error:  # noqa: BLE001  (the edge of the service: no request may end the daemon)
            refused = refusal_of(error)
            if refused.code == "internal":
                _log.exception("internal error while handling the request", command=request.command)
        _log.warning("request failed", command=request.command, code=refused.code, error=refused.message[:300])
        return failed(refused, request.transaction)

    async def _execute(self, request: Request) -> dict[str, Any]:
        _log.info("request", command=request.command, transaction=str(request.transaction)[:128])
        match request:
            case StartRequest():
                data = await self._start(request)
            case PlanRequest():
                data = planned(await self._plan(spec_of(self._config(), request, camera=self.camera)))
            case ResumeRequest():
                data = await self._resume()
            case AbortRequest():
                data = await self._abort(request.reason)
            case SetProfileRequest():
                data = await self._set_profile(request.camera)
            case PauseRequest() | FinishRequest() | SkipRequest() | RepeatRequest():
                data = await self._command(request)
            case _:
                data = self._refresh()
        return data

    async def _command(self, request: PauseRequest | FinishRequest | SkipRequest | RepeatRequest) -> dict[str, Any]:
        mission = await self._missions.under_way()
        if mission is None:
            raise CommandRefusedError(f"cannot {request.command}: no mission is under way")
        shot: dict[str, Any] = {}
        match request:
            case PauseRequest():
                mission.commands.pause(request.reason)
            case FinishRequest():
                mission.commands.finish(request.reason)
            case SkipRequest():
                shot = {"shot": mission.commands.skip(request.shot)}
            case RepeatRequest():
                shot = {"shot": mission.commands.repeat(request.shot)}
        return shot | await self._journaled_state(mission)

    async def _journaled_state(self, mission: Mission) -> dict[str, Any]:
        """Wait until the command is in the journal; return mission id and state."""
        await mission.durable()
        return {"mission_id": mission.record.mission_id, "state": mission.record.state.value}

    # --- missions

    async def _plan(self, spec: PlanSpec) -> Plan:
        key = repr(spec)
        known = self._plans.get(key)
        if known is None:
            async with self._planning:
                known = await plan_apart(spec)
            self._plans[key] = known
            while len(self._plans) > _KEPT_PLANS:
                self._plans.popitem(last=False)
        return known

    async def _start(self, request: StartRequest) -> dict[str, Any]:
        config = self._config()
        spec = spec_of(config, request, camera=self.camera)
        settings = settings_of(config, spec)
        async with self._missions.claimed():
            devices = self._vehicle.ready_devices()
            planning = asyncio.create_task(self._plan(spec), name="plan a mission")
            self._starting = planning
            try:
                await asyncio.wait({planning})
                if planning.cancelled():
                    raise CommandRefusedError("aborted before it began")
                plan = planning.result()
            finally:
                self._starting = None
                planning.cancel()
            name = await self._missions.begin(plan, settings, devices, request.reference or config.mission.reference)
        return {"mission_id": name} | planned(plan)

    async def _resume(self) -> dict[str, Any]:
        mission = await self._missions.under_way()
        if mission is not None:
            mission.commands.resume()
            return await self._journaled_state(mission)
        async with self._missions.claimed():
            if self._missions.offer is None:
                raise CommandRefusedError("cannot resume: no mission is paused and none was interrupted")
            await self._transactions.remember(DECLINED, None)
            return {"mission_id": await self._missions.go_on(self._vehicle.ready_devices())}

    async def _abort(self, reason: str) -> dict[str, Any]:
        if self._starting is not None:
            self._starting.cancel()
            return {"mission_id": None}
        mission = await self._missions.under_way()
        if mission is not None:
            mission.commands.abort(reason)
            return await self._journaled_state(mission)
        if self._missions.busy:
            raise MissionBusyError("the mission is just beginning: ask again")
        offer = self._missions.offer
        if offer is None:
            raise CommandRefusedError("cannot abort: no mission is under way")
        # it stays on disk and may be resumed by request, but is not resumed automatically
        await self._transactions.remember(DECLINED, offer.stored_id)
        return {"mission_id": offer.stored_id}

    async def may_auto_resume(self) -> bool:
        """Whether the interrupted mission may resume automatically: the operator has not aborted it."""
        offer = self._missions.offer
        return offer is not None and await self._transactions.recall(DECLINED) != offer.stored_id

    async def _set_profile(self, camera: str | dict[str, Any] | None) -> dict[str, Any]:
        profile = chosen_profile(self._config(), camera)
        await self._transactions.remember(CAMERA, None if camera is None else json.dumps(camera))
        self.camera = camera
        return {"camera": camera_to_data(profile.camera)}


def _check_fresh(incoming: Incoming) -> None:
    if time.monotonic() > incoming.expires_s:
        raise RefusedRequestError("expired", "the request's message expiry passed before it was obeyed")
