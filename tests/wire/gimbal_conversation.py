"""What an autopilot says to its gimbal while a ground station points it; held with a real one and the embedded one.

Record: `python -m tests.wire.gimbal_conversation ARDUCOPTER FILE` (SITL at normal speed, on the ground, with the
parameters of `config/ardupilot-sitl.parm` and a gimbal that does nothing but report that it is there).
"""

from __future__ import annotations

import asyncio
import json
import math
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from panoexec.dryrun.autopilot import running_sitl, sitl_binary
from panoexec.dryrun.firmware import SitlOptions
from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_ports
from tests.wire.sim_peer import EmbeddedPeer, Heard, Peer, UdpPeer, command, result_of

NAN = math.nan
GIMBAL = mavlink.MAV_COMP_ID_GIMBAL
PITCHYAW = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW
LOCK = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
STEP_S, STATEMENT_S = 0.5, 1.0

ASKED: list[tuple[str, Any]] = [
    ("after its boot", None),
    ("angles, following", command(PITCHYAW, -45, 30, NAN, NAN, 0, 0, 0)),
    ("angles, locked", command(PITCHYAW, -45, 90, NAN, NAN, LOCK, 0, 0)),
    ("the nadir", command(PITCHYAW, -90, -170, NAN, NAN, LOCK, 0, 0)),
    ("pitch beyond the limit", command(PITCHYAW, 120, 0, NAN, NAN, LOCK, 0, 0)),
    ("rates, following", command(PITCHYAW, NAN, NAN, 5, 10, 0, 0, 0)),
    ("rates, locked", command(PITCHYAW, NAN, NAN, -5, 10, LOCK, 0, 0)),
    ("angles again", command(PITCHYAW, 10, -20, NAN, NAN, 0, 0, 0)),
]


def hold(ground: Peer, at_gimbal: Callable[[], list[Heard]]) -> Iterator[dict[str, Any]]:
    """Hold the conversation; what the gimbal heard at each step.

    Args:
        ground: a ground station's link.
        at_gimbal: what came to the gimbal since it was asked last.
    """
    for step, message in ASKED:
        ack = None
        if message is not None:
            ground.send(message)
            ack = result_of(ground.listen(STEP_S), message.command)
        at_gimbal()
        ground.listen(STATEMENT_S)
        yield {"step": step, "ack": ack} | _statement(at_gimbal())


def _statement(heard: list[Heard]) -> dict[str, Any]:
    told = [h.message for h in heard if h.name == "GIMBAL_DEVICE_SET_ATTITUDE"]
    state = [h.message for h in heard if h.name == "AUTOPILOT_STATE_FOR_GIMBAL_DEVICE"]
    last, its_state = told[-1], state[-1]
    return {
        "target_per_s": len(told) / STATEMENT_S,
        "to": [last.target_system, last.target_component],
        "flags": last.flags,
        "q": _numbers(last.q),
        "rates_rad_s": _numbers((last.angular_velocity_x, last.angular_velocity_y, last.angular_velocity_z)),
        "steady": len({(m.flags, *_numbers(m.q)) for m in told}) == 1,
        "state_per_s": len(state) / STATEMENT_S,
        "state_to": [its_state.target_system, its_state.target_component],
        "landed_state": its_state.landed_state,
    }


def _numbers(values: Any) -> tuple[float | None, ...]:
    """To three digits; None for NaN. A quaternion's sign means nothing: the largest part is made positive."""
    if any(math.isnan(value) for value in values):
        return (None,) * len(values)
    sign = math.copysign(1.0, max(values, key=abs)) if len(values) == 4 else 1.0
    return tuple(round(sign * value, 3) + 0.0 for value in values)


class EmbeddedGround(EmbeddedPeer):
    """A ground station of an embedded vehicle that also hears what goes to the gimbal."""

    def __init__(self, config: SimConfig) -> None:
        super().__init__(config)
        self._heard: list[Heard] = []
        payload = self.simulation.payload
        receive = payload.gimbal.receive

        def tapped(message: Any) -> None:
            self._heard.append(Heard(self.simulation.timeline.now_s, message))
            receive(message)

        payload.gimbal.receive = tapped  # type: ignore[method-assign]
        self.listen(1.0)

    def at_gimbal(self) -> list[Heard]:
        """What came to it since it was asked last."""
        heard, self._heard = self._heard, []
        return heard


class _StillGimbal:
    """Component 154 of a real autopilot: says that it is there, and nothing else; hears everything."""

    def __init__(self, port: int) -> None:
        self._peer = UdpPeer(port)
        self._heard: list[Heard] = []
        self._aimed = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    def at_gimbal(self) -> list[Heard]:
        heard, self._heard = self._heard, []
        return heard

    def wait_for_targets(self) -> None:
        if not self._aimed.wait(60):
            raise SystemExit("the autopilot did not take to the gimbal")

    def _run(self) -> None:
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GIMBAL, 8, 0, 0, 4, 3)
        level = mavlink.MAVLink_gimbal_device_attitude_status_message(0, 0, 0, 44, (1, 0, 0, 0), 0, 0, 0, 0, NAN, NAN)
        limit = math.pi / 2
        about = mavlink.MAVLink_gimbal_device_information_message(
            0, b"still", b"gimbal", b"", 1, 1, 1, 0, 0, -limit, limit, -limit, limit, -math.pi, math.pi
        )
        while True:
            heard = self._peer.listen(0.2)
            self._heard = self._heard + heard
            if any(item.name == "GIMBAL_DEVICE_SET_ATTITUDE" for item in heard):
                self._aimed.set()
            if heard:
                asks = [h for h in heard if h.name == "COMMAND_LONG" and h.message.param1 == about.get_msgId()]
                for message in (beat, level, *([about] if asks else [])):
                    self._peer.send(message, component=GIMBAL)


async def record(binary: Path) -> list[dict[str, Any]]:
    """Start the autopilot, fly nothing, hold the conversation."""
    ground_port, payload_port = free_udp_ports(2)
    gimbal, ground = _StillGimbal(payload_port), UdpPeer(ground_port)
    options = SitlOptions(
        binary=binary,
        ground_port=ground_port,
        payload_port=payload_port,
        speedup=1.0,
        home=(47.4, 8.5, 488.0, 20.0),
        parameters={},
    )
    async with running_sitl(options):
        await asyncio.to_thread(gimbal.wait_for_targets)
        await asyncio.to_thread(ground.listen, 3.0)
        return await asyncio.to_thread(lambda: list(hold(ground, gimbal.at_gimbal)))


if __name__ == "__main__":
    lines = [json.dumps(step) + "\n" for step in asyncio.run(record(sitl_binary(sys.argv[1])))]
    Path(sys.argv[2]).write_text("".join(lines), encoding="utf-8")
