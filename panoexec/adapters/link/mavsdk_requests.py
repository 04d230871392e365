"""Requests to an autopilot and other components: commands, messages, parameters, calls of MAVSDK's plugins.

Nothing here waits for a connection: without one a request fails, and the caller repeats it.
"""

from __future__ import annotations

import asyncio
import json
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeVar

import structlog
from mavsdk import MavsdkError, System
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.param import Param, ParamError, ParamResult

from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS, device_error
from panoexec.adapters.link.mavsdk_session import MavsdkSession
from panoexec.adapters.link.message_hub import MavMessage, MessageHub
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.adapters.link.worker_calls import WorkerCalls
from panoexec.clock import Clock, work
from panoexec.devices import Severity
from panoexec.errors import DeviceError, LinkError

T = TypeVar("T")
P = TypeVar("P")

REQUEST_MESSAGE: Final = 512
_FRAME_GLOBAL: Final = 5
"""MAV_FRAME_GLOBAL_INT: altitude above mean sea level."""
_PARAMETER_TRIES: Final = 3
_PARAMETER_PAUSE_S: Final = 0.2

_log = structlog.get_logger(__name__)


class MavsdkRequests:
    """The requests of one `MavsdkLink`; valid across reconnections.

    Attributes:
        system_id: MAVLink system id of the vehicle; the link sets it when it has found the vehicle.
    """

    def __init__(
        self,
        session: MavsdkSession,
        calls: WorkerCalls,
        hub: MessageHub,
        *,
        clock: Clock,
        system_id: int,
        connected: Callable[[], bool],
        post: Callable[..., None],
    ) -> None:
        """Create it; nothing is sent.

        Args:
            session: creates plugins for the vehicle, once it was found.
            calls: runs blocking calls.
            hub: source of the answers.
            clock: of the mission; a vehicle clock waits while a call runs.
            system_id: see the attribute.
            connected: whether heartbeats of the autopilot arrive.
            post: schedules a callback on the event loop from MAVSDK's thread.
        """
        self.system_id = system_id
        self._session = session
        self._calls = calls
        self._hub = hub
        self._clock = clock
        self._connected = connected
        self._post = post

    def plugin(self, kind: Callable[[System], P]) -> P:
        """The MAVSDK plugin of that kind, created at the first call.

        Raises:
            LinkError: the autopilot has not been found yet.
        """
        return self._session.plugin(kind)

    async def mavsdk_call(self, what: str, call: Callable[[], T]) -> T:
        """Run a blocking call of MAVSDK in a thread.

        Args:
            what: the request, for messages: "pointing the gimbal".
            call: the blocking call; a cancellation does not interrupt it.

        Raises:
            DeviceError: refused or not answered.
            LinkError: not answered, and no heartbeats either; or the link is closed.
        """
        try:
            with work(self._clock):
                return await self._calls.run(call)
        except MavsdkError as error:
            raise device_error(what, error, connected=self._connected()) from error
        except RuntimeError as error:  # a plugin whose connection was closed
            raise LinkError(f"{what}: the link is closed") from error

    async def command(self, command: int, params: Sequence[float] = (), *, component: int = AUTOPILOT) -> int:
        """Send a COMMAND_LONG and return its MAV_RESULT.

        Args:
            command: MAV_CMD.
            params: the first of its seven parameters; the others are 0.
            component: the target.

        Raises:
            DeviceError: not answered, or not sent.
            LinkError: as `mavsdk_call`.
        """
        fields: dict[str, float] = {"target_system": self.system_id, "target_component": component}
        fields |= {"command": command, "confirmation": 0}
        for number in range(1, 8):
            fields[f"param{number}"] = params[number - 1] if number <= len(params) else 0.0
        return await self._send_command("COMMAND_LONG", command, fields, component)

    async def command_at(
        self, command: int, params: Sequence[float], *, latitude_deg: float, longitude_deg: float, altitude_m: float
    ) -> int:
        """Send a COMMAND_INT for a position to the autopilot and return its MAV_RESULT.

        Args:
            command: MAV_CMD.
            params: its first four parameters.
            latitude_deg: of the position.
            longitude_deg: of the position.
            altitude_m: above mean sea level.

        Raises:
            DeviceError: not answered, or not sent.
            LinkError: as `mavsdk_call`.
        """
        fields: dict[str, float] = {
            "target_system": self.system_id,
            "target_component": AUTOPILOT,
            "frame": _FRAME_GLOBAL,
            "command": command,
            "current": 0,
            "autocontinue": 0,
            **{f"param{number}": value for number, value in enumerate(params, start=1)},
            "x": round(latitude_deg * 1e7),
            "y": round(longitude_deg * 1e7),
            "z": altitude_m,
        }
        return await self._send_command("COMMAND_INT", command, fields, AUTOPILOT)

    async def _send_command(self, name: str, command: int, fields: Mapping[str, float], component: int) -> int:
        text = json.dumps(fields, allow_nan=False)
        message = MavlinkMessage(name, 0, 0, self.system_id, component, text)
        direct = self.plugin(MavlinkDirect)
        ack = await self.mavsdk_call(f"command {command}", lambda: direct.send_command(message))
        return int(json.loads(ack.fields_json)["result"])

    async def message(
        self,
        message_id: int,
        name: str,
        *,
        component: int = AUTOPILOT,
        timeout_s: float = 2.0,
        index: int = 0,
        fits: Callable[[MavMessage], bool] = lambda _: True,
    ) -> MavMessage:
        """Request a message once (MAV_CMD_REQUEST_MESSAGE, 512) and return it.

        Args:
            message_id: MAVLink message id.
            name: MAVLink message name.
            component: the target component.
            timeout_s: real seconds between the acknowledgement and the message.
            index: param2 of the request: the index, if there are several.
            fits: whether a received message of that name is the requested one.

        Raises:
            DeviceError: refused, or the message did not arrive within `timeout_s`.
            LinkError: as `mavsdk_call`.
        """
        arrived: asyncio.Future[MavMessage] = asyncio.get_running_loop().create_future()

        def deliver(message: MavMessage) -> None:
            if not arrived.done() and fits(message):
                arrived.set_result(message)

        off = self._hub.on(name, lambda m: self._post(deliver, m) if m.component_id == component else None)
        try:
            result = await self.command(REQUEST_MESSAGE, [message_id, index], component=component)
            if result != 0:
                raise DeviceError(f"requesting {name} ({message_id}): {MAV_RESULTS.get(result, result)}")
            async with asyncio.timeout(timeout_s):
                return await arrived
        except TimeoutError as error:
            raise DeviceError(f"requesting {name} ({message_id}): accepted, but the message did not arrive") from error
        finally:
            off()

    async def parameter(self, name: str) -> float | None:
        """A parameter of the autopilot; None if it does not exist or the autopilot does not answer.

        Raises:
            LinkError: the autopilot has not been found yet.
        """
        plugin = self.plugin(Param)

        def read() -> float:
            try:
                return float(plugin.get_param_int(name))
            except ParamError as error:
                if error.result != ParamResult.WRONG_TYPE:
                    raise
            return float(plugin.get_param_float(name))

        for left in reversed(range(_PARAMETER_TRIES)):
            try:
                return await self.mavsdk_call(f"reading {name}", read)
            except DeviceError as error:
                # an autopilot that was just found may not answer at first; the kind of a mount's feedback depends on
                # the answer
                _log.debug("parameter could not be read", name=name, error=str(error))
                if left:
                    await asyncio.sleep(_PARAMETER_PAUSE_S)
        return None

    async def send(self, what: str, name: str, fields: Mapping[str, object]) -> None:
        """Send a message without acknowledgement.

        Args:
            what: the request, for error messages.
            name: MAVLink message name.
            fields: by MAVLink's field names.

        Raises:
            DeviceError: not sent.
            LinkError: as `mavsdk_call`.
        """
        message = MavlinkMessage(name, fields_json=json.dumps(fields, allow_nan=False))
        direct = self.plugin(MavlinkDirect)
        await self.mavsdk_call(what, lambda: direct.send_message(message))

    async def say(self, text: str, severity: Severity = Severity.NOTICE) -> None:
        """Send text to the ground stations (STATUSTEXT, 253), in lines of 50 characters; never raises."""
        for line in textwrap.wrap(text.encode("ascii", "replace").decode(), 50):
            fields = {"severity": int(severity), "text": line, "id": 0, "chunk_seq": 0}
            try:
                await self.send("sending a message to the pilot", "STATUSTEXT", fields)
            except DeviceError as error:
                _log.info("message to the pilot could not be sent", text=text, error=str(error))
                return
