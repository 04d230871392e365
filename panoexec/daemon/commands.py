"""Requests obeyed: each transaction once, each answered, nothing that a stranger sends can stop the daemon."""

from __future__ import annotations

import asyncio
import hashlib
import json
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Final

import structlog

from panoexec.daemon.mission_request import Wish, chosen_profile, settings_of, wish_of
from panoexec.daemon.missions import Missions
from panoexec.daemon.planner import plan_apart
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.errors import PanoexecError, PlanningError, UsageError
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import camera_to_data, certificate_to_data, estimate_to_data
from panoexec.mission.executor import Mission
from panoexec.mission.mission_requests import CommandRefusedError
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
from panoexec.mqtt.transactions import Noted, Transactions
from panoexec.planning.model import Plan
from panoexec.store.session import Devices

MAX_UNDER_WAY: Final = 64
"""Requests that may be worked on at the same time."""

CAMERA: Final = "camera"
DECLINED: Final = "declined mission"

_KEPT_PLANS: Final = 4
_KEPT_ANSWERS: Final = 200

_log = structlog.get_logger(__name__)


class Commands:
    """Obeys requests.

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
    ) -> None:
        """Describe it.

        Args:
            config: as of now.
            missions: to be commanded.
            vehicle: with its devices.
            transactions: what was obeyed before.
            group: of the daemon's tasks.
            respond: publishes an answer.
            refresh: publishes state and plan anew and returns the state.
        """
        self.camera: str | dict[str, Any] | None = None
        self._config = config
        self._missions = missions
        self._vehicle = vehicle
        self._transactions = transactions
        self._group = group
        self._respond = respond
        self._refresh = refresh
        self._under_way: dict[str, tuple[str, list[Incoming]]] = {}
        self._answers: OrderedDict[str, tuple[str, bytes]] = OrderedDict()
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._planning = asyncio.Lock()
        self._starting: asyncio.Task[Plan] | None = None

    async def restore(self) -> None:
        """Take up what was set before a restart."""
        text = await self._transactions.recall(CAMERA)
        self.camera = json.loads(text) if text else None

    # --- one request

    def take(self, incoming: Incoming) -> None:
        """Take a request as it came; returns at once and never raises."""
        try:
            request = parse_request(incoming.command, incoming.payload, retained=incoming.retained, size=incoming.size)
        except RefusedRequestError as error:
            self._refuse(incoming, error)
            return
        key = json.dumps(request.transaction)
        digest = _digest(request)
        waiting = self._under_way.get(key)
        if waiting is not None and waiting[0] == digest:
            if len(waiting[1]) < MAX_UNDER_WAY:
                waiting[1].append(incoming)
            return
        if waiting is not None or len(self._under_way) >= MAX_UNDER_WAY:
            refused = RefusedRequestError("overload", f"{MAX_UNDER_WAY} requests are under way: ask again later")
            if waiting is not None:
                refused = RefusedRequestError("conflict", "another request has this transaction", field="transaction")
            refused.transaction = request.transaction
            self._refuse(incoming, refused)
            return
        self._under_way[key] = (digest, [incoming])
        self._group.create_task(self._serve(key, digest, request, incoming), name=f"request {request.command}")

    def _refuse(self, incoming: Incoming, error: RefusedRequestError) -> None:
        _log.warning("request refused", command=incoming.command[:60], code=error.code, error=error.message[:300])
        self._respond(incoming, dump(failed(error)))

    async def _serve(self, key: str, digest: str, request: Request, incoming: Incoming) -> None:
        try:
            payload = await self._answer(key, digest, request, incoming)
        finally:
            _, waiting = self._under_way.pop(key)
        for one in waiting:
            self._respond(one, payload)

    async def _answer(self, key: str, digest: str, request: Request, incoming: Incoming) -> bytes:
        try:
            if request.acts:
                noted = await self._transactions.note(request)
                if noted.standing == "answered":
                    return noted.response.encode()
                _check_new(noted)
            elif (known := self._answers.get(key)) is not None and known[0] == digest:
                return known[1]
            response = await self._obeyed(request, incoming)
        except RefusedRequestError as error:
            _log.warning("request refused", command=request.command, code=error.code, error=error.message[:300])
            return dump(failed(error, request.transaction))
        payload = dump(response)
        if request.acts:
            try:
                await self._transactions.answered(request, payload.decode())
            except RefusedRequestError as error:
                _log.error("the response could not be stored", error=error.message)
        else:
            self._answers[key] = (digest, payload)
            while len(self._answers) > _KEPT_ANSWERS:
                self._answers.popitem(last=False)
        return payload

    async def _obeyed(self, request: Request, incoming: Incoming) -> Response:
        """Obey if it is not too late, and turn whatever goes wrong into an answer."""
        try:
            _check_fresh(incoming)
            return ok(request.transaction, await self._obey(request))
        except RefusedRequestError as error:
            refused = error
        except CommandRefusedError as error:
            refused = RefusedRequestError("refused", str(error))
        except PlanningError as error:
            refused = RefusedRequestError("planning", str(error))
        except UsageError as error:
            refused = RefusedRequestError("invalid", str(error))
        except PanoexecError as error:
            refused = RefusedRequestError("device", str(error))
        except Exception as error:  # noqa: BLE001  (a bug in a request must not end the daemon)
            _log.exception("internal error while handling the request", command=request.command)
            refused = RefusedRequestError("internal", f"{type(error).__name__}: {error}")
        _log.warning("request rejected", command=request.command, code=refused.code, error=refused.message[:300])
        return failed(refused, request.transaction)

    async def _obey(self, request: Request) -> dict[str, Any]:
        _log.info("request", command=request.command, transaction=str(request.transaction)[:128])
        match request:
            case StartRequest():
                data = await self._start(request)
            case PlanRequest():
                data = _plan_data(await self._plan(wish_of(self._config(), request, camera=self.camera)))
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
            raise RefusedRequestError("refused", f"cannot {request.command}: no mission is under way")
        shot: dict[str, Any] = {}
        match request:
            case PauseRequest():
                mission.verbs.pause(request.reason)
            case FinishRequest():
                mission.verbs.finish(request.reason)
            case SkipRequest():
                shot = {"shot": mission.verbs.skip(request.shot)}
            case RepeatRequest():
                shot = {"shot": mission.verbs.repeat(request.shot)}
        return shot | await self._done(mission)

    async def _done(self, mission: Mission) -> dict[str, Any]:
        """What was asked for is in the journal."""
        await mission.durable()
        return {"mission_id": mission.record.mission_id, "state": mission.record.state.value}

    # --- missions

    async def _plan(self, wish: Wish) -> Plan:
        key = repr(wish)
        known = self._plans.get(key)
        if known is None:
            async with self._planning:
                known = await plan_apart(wish.job())
            self._plans[key] = known
            while len(self._plans) > _KEPT_PLANS:
                self._plans.popitem(last=False)
        return known

    async def _start(self, request: StartRequest) -> dict[str, Any]:
        wish = wish_of(self._config(), request, camera=self.camera)
        settings = settings_of(self._config(), wish)
        async with self._missions.claimed():
            devices = self._devices()
            planning = asyncio.create_task(self._plan(wish), name="plan a mission")
            self._starting = planning
            try:
                await asyncio.wait({planning})
                if planning.cancelled():
                    raise RefusedRequestError("refused", "aborted before it began")
                plan = planning.result()
            finally:
                self._starting = None
                planning.cancel()
            name = await self._missions.begin(plan, settings, devices, wish.reference)
        return {"mission_id": name} | _plan_data(plan)

    async def _resume(self) -> dict[str, Any]:
        mission = await self._missions.under_way()
        if mission is not None:
            mission.verbs.resume()
            return await self._done(mission)
        async with self._missions.claimed():
            if self._missions.offer is None:
                raise RefusedRequestError("refused", "cannot resume: no mission is paused and none was interrupted")
            await self._transactions.remember(DECLINED, None)
            return {"mission_id": await self._missions.go_on(self._devices())}

    async def _abort(self, reason: str) -> dict[str, Any]:
        if self._starting is not None:
            self._starting.cancel()
            return {"mission_id": None}
        mission = await self._missions.under_way()
        if mission is not None:
            mission.verbs.abort(reason)
            return await self._done(mission)
        if self._missions.busy:
            raise RefusedRequestError("busy", "the mission is just beginning: ask again")
        offer = self._missions.offer
        if offer is None:
            raise RefusedRequestError("refused", "cannot abort: no mission is under way")
        # it stays on disk and may be resumed by request, but does not go on by itself any more
        await self._transactions.remember(DECLINED, offer.stored_id)
        return {"mission_id": offer.stored_id}

    async def may_go_on_by_itself(self) -> bool:
        """Whether nobody called off the offered mission."""
        offer = self._missions.offer
        return offer is not None and await self._transactions.recall(DECLINED) != offer.stored_id

    def _devices(self) -> Devices:
        devices = self._vehicle.devices
        if devices is None or not self._vehicle.links().autopilot.ok:
            raise RefusedRequestError(
                "not_ready", f"the vehicle is not ready: {self._vehicle.lacking or 'no heartbeats'}"
            )
        return devices

    async def _set_profile(self, camera: str | dict[str, Any] | None) -> dict[str, Any]:
        profile = chosen_profile(self._config(), camera)
        await self._transactions.remember(CAMERA, None if camera is None else json.dumps(camera))
        self.camera = camera
        return {"camera": camera_to_data(profile.camera)}


def _plan_data(plan: Plan) -> dict[str, Any]:
    """What a plan's answer says of it."""
    certificate, estimate = plan.certificate, plan.estimate
    return {
        "images": len(plan.shots),
        "rows": len({shot.row for shot in plan.shots}),
        "duration_s": None if estimate is None else estimate.duration_s,
        "estimate": None if estimate is None else estimate_to_data(estimate),
        "certificate": None if certificate is None else certificate_to_data(certificate),
        "camera": camera_to_data(plan.camera),
        "lower_bound": plan.lower_bound,
        "notes": list(plan.notes),
    }


def _check_new(noted: Noted) -> None:
    if noted.standing != "new":
        raise RefusedRequestError(
            "interrupted",
            "the daemon ended while it obeyed this request: the state tells whether it did; it does not act again",
        )


def _check_fresh(incoming: Incoming) -> None:
    if time.monotonic() > incoming.expires_s:
        raise RefusedRequestError("expired", "the request's message expiry passed before it was obeyed")


def _digest(request: Request) -> str:
    fields = json.dumps([request.command, request.model_dump(mode="python")], sort_keys=True)
    return hashlib.sha256(fields.encode()).hexdigest()
