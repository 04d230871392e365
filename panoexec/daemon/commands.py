"""Executes MQTT requests: each one is answered, and no request, however malformed, can stop the daemon."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, Final, Protocol, TypeVar

import structlog

from panoexec.daemon.beginnings import Beginning
from panoexec.daemon.error_codes import refusal_of
from panoexec.daemon.errors import MissionStorageError
from panoexec.daemon.mission_request import at_stop, chosen_profile, settings_of, spec_of
from panoexec.daemon.missions import Missions
from panoexec.daemon.planning_desk import PlanningDesk
from panoexec.daemon.presets import presets_document, with_preset
from panoexec.daemon.stopping import DECLINED, Stopping
from panoexec.daemon.thumbnails import Thumbnails
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.errors import MissionError
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import camera_to_data
from panoexec.mission.executor import Mission
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mqtt.answers import planned
from panoexec.mqtt.incoming import Incoming, expired
from panoexec.mqtt.messages import Response, dump, failed, ok
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.requests import (
    DoctorRequest,
    MissionsRequest,
    PlanRequest,
    PresetsRequest,
    RefusedRequestError,
    RepeatRequest,
    Request,
    ResumeRequest,
    SetProfileRequest,
    SkipRequest,
    StartRequest,
    StopRequest,
    ThumbnailsRequest,
)
from panoexec.mqtt.senders import sender_of
from panoexec.mqtt.transaction_file import FORGOTTEN
from panoexec.mqtt.transactions import Transactions
from panoexec.planning.model import Plan
from panoexec.store.listing import list_missions

T = TypeVar("T")

CAMERA: Final = "camera"

_log = structlog.get_logger(__name__)


class Examine(Protocol):
    """Runs the doctor's checks."""

    async def __call__(self, *, photo: bool) -> dict[str, Any]:
        """The document of the findings."""
        ...


class Commands:
    """Executes requests.

    Attributes:
        camera: set by `set_profile`; None = the configured one.
        stopping: executes `abort`, `finish` and `pause`.
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
        examine: Examine,
        thumbnails: Thumbnails,
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
            examine: examines the daemon and returns the findings.
            thumbnails: of stored photos.
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
        self._examine = examine
        self._thumbnails = thumbnails
        self._check = check
        self._plans = PlanningDesk()
        self._forgot = False
        self.stopping = Stopping(missions=missions, transactions=transactions, group=group, respond=respond)

    async def restore(self) -> None:
        """Restore the camera profile that was set before a restart."""
        text = await self._transactions.recall(CAMERA)
        self.camera = json.loads(text) if text else None
        self._forgot = await self._transactions.recall(FORGOTTEN) is not None

    async def decline_what_may_be_forgotten(self) -> None:
        """Decline the offered mission if the stored transactions were damaged: nobody knows whether it was aborted.

        It may still be resumed by request.
        """
        offer = self._missions.offer
        if self._forgot and offer is not None:
            _log.warning("the mission does not go on by itself: resume it, if it was not aborted")
            await self._transactions.remember(DECLINED, offer.stored_id)
        if self._forgot:
            await self._transactions.remember(FORGOTTEN, None)
            self._forgot = False

    async def plan_of_preset(self, preset: str) -> Plan:
        """The plan of a preset, computed unless it is known.

        Raises:
            RefusedRequestError: there is no such preset, or it is wrong.
            PanoexecError: it cannot be planned.
        """
        config = self._config()
        request = with_preset(config, StartRequest.model_validate({"transaction": 0, "preset": preset}))
        spec = spec_of(config, request, camera=self.camera, limits=self._vehicle.turn_limits)
        return await self._plans.for_sender(spec, "stations")

    # --- one request

    def take(self, incoming: Incoming) -> None:
        """Take a request as it came; returns at once and never raises."""
        try:
            request = parse_request(incoming.command, incoming.payload, retained=incoming.retained, size=incoming.size)
            if isinstance(request, StopRequest):
                self.stopping.take(request, incoming)
                return
            is_new = self._transactions.enter(request, partial(self._respond, incoming))
        except RefusedRequestError as error:
            _log.warning("request refused", command=incoming.command[:60], code=error.code, error=error.message[:300])
            self._respond(incoming, dump(failed(error)))
            return
        if not is_new:
            return
        beginning = None
        if isinstance(request, StartRequest | ResumeRequest):
            beginning = self.stopping.expect("start" if isinstance(request, StartRequest) else "resume", incoming)
        self._group.create_task(self._serve(request, incoming, beginning), name=f"request {request.command}")

    async def _serve(self, request: Request, incoming: Incoming, beginning: Beginning | None) -> None:
        try:
            await self._transactions.serve(request, partial(self._response_to, request, incoming, beginning))
        finally:
            if beginning is not None:
                self.stopping.forget(beginning)

    async def _response_to(self, request: Request, incoming: Incoming, beginning: Beginning | None) -> Response:
        """Execute the request unless it has expired; every failure becomes a response."""
        try:
            incoming.check_fresh()
            self._check(request)
            return ok(request.transaction, await self._execute(request, incoming, beginning))
        except Exception as error:  # noqa: BLE001  (the edge of the service: no request may end the daemon)
            refused = refusal_of(error)
            if refused.code == "internal":
                _log.exception("internal error while handling the request", command=request.command)
        _log.warning("request failed", command=request.command, code=refused.code, error=refused.message[:300])
        return failed(refused, request.transaction)

    async def _execute(self, request: Request, incoming: Incoming, beginning: Beginning | None) -> dict[str, Any]:
        _log.info("request", command=request.command, transaction=str(request.transaction)[:128])
        match request:
            case StartRequest():
                assert beginning is not None
                data = await self._start(request, incoming, beginning)
            case PlanRequest():
                request = with_preset(self._config(), request)
                spec = spec_of(self._config(), request, camera=self.camera, limits=self._vehicle.turn_limits)
                plan = await _in_time(self._plans.for_sender(spec, incoming.sender), incoming)
                data = self._planned(plan, request)
            case ResumeRequest():
                assert beginning is not None
                data = await self._resume(request, incoming, beginning)
            case MissionsRequest():
                data = await self._list(request.newest)
            case PresetsRequest():
                data = {"presets": presets_document(self._config())}
            case ThumbnailsRequest():
                data = await self._resend(request)
            case DoctorRequest():
                data = await self._examine(photo=request.photo)
            case SetProfileRequest():
                data = await self._set_profile(request.camera)
            case SkipRequest() | RepeatRequest():
                data = await self._command(request)
            case _:
                data = self._refresh()
        return data

    async def _list(self, newest: int) -> dict[str, Any]:
        found = await asyncio.to_thread(list_missions, self._config().storage.path, newest=newest)
        return {"missions": [entry.document() for entry in found]}

    async def _resend(self, request: ThumbnailsRequest) -> dict[str, Any]:
        record = self._missions.record
        mission_id = request.mission_id or ("" if record is None else record.mission_id)
        if not mission_id:
            raise CommandRefusedError("there is no mission yet: say which by mission_id")
        count = await self._thumbnails.send_again(mission_id, request.shots)
        return {"mission_id": mission_id, "count": count}

    async def _command(self, request: SkipRequest | RepeatRequest) -> dict[str, Any]:
        mission = await self._missions.under_way()
        if mission is None:
            raise CommandRefusedError(f"cannot {request.command}: no mission is under way")
        match request:
            case SkipRequest():
                shot = mission.commands.skip(request.shot, by=sender_of(request.transaction))
            case RepeatRequest():
                shot = mission.commands.repeat(request.shot, by=sender_of(request.transaction))
        return {"shot": shot} | await self._journaled_state(mission)

    async def _journaled_state(self, mission: Mission) -> dict[str, Any]:
        """Wait until the command is in the journal; return mission id and state.

        Raises:
            MissionStorageError: the journal cannot be written; the mission ends.
        """
        try:
            await mission.durable()
        except MissionError as error:
            raise MissionStorageError(str(error)) from error
        return {"mission_id": mission.record.mission_id, "state": mission.record.state.value}

    # --- missions

    async def _start(self, request: StartRequest, incoming: Incoming, beginning: Beginning) -> dict[str, Any]:
        config = self._config()
        request = with_preset(config, request)
        spec = spec_of(config, request, camera=self.camera, limits=self._vehicle.turn_limits)
        settings = settings_of(config, spec)
        if incoming.stop is not None:
            settings = at_stop(settings, incoming.stop)
        async with self._missions.claimed(beginning):
            devices = self._vehicle.ready_devices()
            try:
                plan = await beginning.before_it(self._plans.for_mission(spec), deadline_s=incoming.expires_s)
            except TimeoutError:
                raise expired() from None
            incoming.check_fresh()
            reference = request.reference or config.mission.reference
            mission_id = await self._missions.begin(
                plan, settings, devices, reference, name=request.name, stop=incoming.stop
            )
        return {"mission_id": mission_id} | self._planned(plan, request)

    def _planned(self, plan: Plan, request: PlanRequest) -> dict[str, Any]:
        return planned(plan, hover_s=60 * self._config().guards.hover_min, shots=request.shots)

    async def _resume(self, request: ResumeRequest, incoming: Incoming, beginning: Beginning) -> dict[str, Any]:
        mission = await self._missions.under_way()
        await self._missions.look_again()
        incoming.check_fresh()
        if mission is not None:
            beginning.commit()
            mission.commands.resume(by=sender_of(request.transaction))
            return await self._journaled_state(mission)
        async with self._missions.claimed(beginning):
            incoming.check_fresh()
            if self._missions.offer is None:
                raise CommandRefusedError("cannot resume: no mission is paused and none was interrupted")
            beginning.check()
            await self.stopping.allow_resuming()
            return {"mission_id": await self._missions.go_on(self._vehicle.ready_devices())}

    async def _set_profile(self, camera: str | dict[str, Any] | None) -> dict[str, Any]:
        profile = chosen_profile(self._config(), camera)
        await self._transactions.remember(CAMERA, None if camera is None else json.dumps(camera))
        self.camera = camera
        return {"camera": camera_to_data(profile.camera)}


async def _in_time(work: Coroutine[Any, Any, T], incoming: Incoming) -> T:
    """The result of the work, which is cancelled when the request expires.

    Raises:
        RefusedRequestError: it expired.
    """
    limit = asyncio.timeout_at(incoming.expires_s)  # the event loop's clock is time.monotonic
    try:
        async with limit:
            return await work
    except TimeoutError:
        if limit.expired():
            raise expired() from None
        raise
