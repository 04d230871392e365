"""A conversation with PX4's gimbal manager, held alike with the real one, to record it, and with the embedded one.

Record: `python -m tests.wire.px4_conversation PX4 FILE FILE` (SIH at normal speed; on the ground, then in the air for
RTL; then, for the second file, with a gimbal on its outputs).
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from panoexec.dryrun.autopilot import running_sitl, sitl_binary
from panoexec.dryrun.firmware import SitlOptions
from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_ports
from panoexec.sim.process import running_simulator
from tests.wire.sim_peer import COMPONENT, SYSTEM, Heard, Peer, UdpPeer, command, result_of

NAN = math.nan
PITCHYAW, CONFIGURE = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
INTERVAL, REQUEST = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE
LOCK = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
SET_MODE, AUTO_RTL, AUTO_LOITER = mavlink.MAV_CMD_DO_SET_MODE, (1, 4, 5), (1, 4, 3)
TO_DEVICE = "GIMBAL_DEVICE_ATTITUDE_STATUS"
FIELDS: dict[str, tuple[str, ...]] = {
    "GIMBAL_MANAGER_INFORMATION": ("gimbal_device_id",),
    "GIMBAL_DEVICE_INFORMATION": ("gimbal_device_id", "vendor_name", "model_name"),
}
ANSWER_S = 2.0
GIMBAL = mavlink.MAV_COMP_ID_GIMBAL


def _pitchyaw_message(pitch_deg: float, yaw_deg: float) -> Any:
    return mavlink.MAVLink_gimbal_manager_set_pitchyaw_message(
        1, 1, LOCK, 0, math.radians(pitch_deg), math.radians(yaw_deg), NAN, NAN
    )


ASKED: list[tuple[str, Any]] = [
    ("request 280", command(REQUEST, 280)),
    ("request 281", command(REQUEST, 281)),
    ("request 283 of the autopilot", command(REQUEST, 283)),
    ("request 283 of the gimbal", command(REQUEST, 283, to=154)),
    ("angles without control", command(PITCHYAW, -20, 30, NAN, NAN, LOCK, 0, 0)),
    ("take control, by name", command(CONFIGURE, SYSTEM, COMPONENT, -1, -1, 0, 0, 0)),
    ("angles, locked", command(PITCHYAW, -30, 60, NAN, NAN, LOCK, 0, 154)),
    ("angles of another gimbal", command(PITCHYAW, -10, 20, NAN, NAN, LOCK, 0, 3)),
    ("set pitch and yaw by message", _pitchyaw_message(-50, 10)),
    ("angles, following", command(PITCHYAW, -20, 10, NAN, NAN, 0, 0, 0)),
    ("leave control unchanged", command(CONFIGURE, -1, -1, -1, -1, 0, 0, 0)),
    ("-2 for control", command(CONFIGURE, -2, -2, -1, -1, 0, 0, 0)),
    ("angles after -2", command(PITCHYAW, -40, 0, NAN, NAN, LOCK, 0, 0)),
    ("release what another has", command(CONFIGURE, -3, -3, -1, -1, 0, 0, 0)),
    ("take control again", command(CONFIGURE, SYSTEM, COMPONENT, -1, -1, 0, 0, 0)),
    ("release control", command(CONFIGURE, -3, -3, -1, -1, 0, 0, 0)),
    ("give control to another", command(CONFIGURE, 255, 190, -1, -1, 0, 0, 0)),
    ("no control for anybody", command(CONFIGURE, 0, 0, -1, -1, 0, 0, 0)),
    ("take control at last", command(CONFIGURE, SYSTEM, COMPONENT, -1, -1, 0, 0, 0)),
]


def hold(peer: Peer) -> Iterator[dict[str, Any]]:
    """Hold the conversation on the ground; what came of each step, who has control, where the gimbal points."""
    peer.send(_heartbeat())
    yield {"step": "rates"} | _rates(peer.listen(4.0))
    for step, message in ASKED:
        peer.send(_heartbeat())
        peer.send(message)
        heard = peer.listen(ANSWER_S)
        ack = result_of(heard, message.command) if hasattr(message, "command") else None
        yield {"step": step, "ack": ack} | _answers(heard) | {"control": _control(peer), "pitch_deg": _pitch(heard)}
    peer.send(command(INTERVAL, 285, 20_000))
    peer.listen(1.0)
    yield {"step": "rates, asked for"} | _rates(peer.listen(4.0))


def hold_in_air(peer: Peer) -> Iterator[dict[str, Any]]:
    """The same in the air, in Hold: what RTL does to the control of the gimbal."""
    for step, message in (
        ("take control in the air", command(CONFIGURE, SYSTEM, COMPONENT, -1, -1, 0, 0, 0)),
        ("RTL", command(SET_MODE, *AUTO_RTL)),
        ("angles in RTL", command(PITCHYAW, -40, 0, NAN, NAN, LOCK, 0, 0)),
        ("Hold again", command(SET_MODE, *AUTO_LOITER)),
    ):
        peer.send(_heartbeat())
        peer.send(message)
        heard: list[Heard] = []
        control: list[list[int]] = []
        for _ in range(20):
            heard += peer.listen(0.1)
            now = _control(peer)
            if now and control[-1:] != [now]:
                control.append(now)
        yield {"step": step, "ack": result_of(heard, message.command), "control": control}


def hold_aux(peer: Peer) -> Iterator[dict[str, Any]]:
    """The same with a gimbal on the autopilot's outputs (MNT_MODE_OUT 0), whose attitude nobody measures.

    `turning`: whether a report was anywhere between the attitudes before and after a command.
    """
    peer.send(command(INTERVAL, 285, 20_000))
    peer.listen(2.0)
    for step, message in (
        ("request 280", command(REQUEST, 280)),
        ("request 283 of the autopilot", command(REQUEST, 283)),
        ("take control, by name", command(CONFIGURE, SYSTEM, COMPONENT, -1, -1, 0, 0, 0)),
        ("angles, locked", command(PITCHYAW, -30, 60, NAN, NAN, LOCK, 0, 0)),
        ("angles, locked, elsewhere", command(PITCHYAW, 10, -20, NAN, NAN, LOCK, 0, 0)),
        ("angles, following", command(PITCHYAW, -60, 20, NAN, NAN, 0, 0, 0)),
    ):
        peer.send(_heartbeat())
        peer.send(message)
        heard = peer.listen(ANSWER_S)
        told = [h.message for h in heard if h.name == TO_DEVICE]
        pitches = [_pitch_of(one) for one in told]
        ends = {round(pitches[0]), round(pitches[-1])} if pitches else set()
        yield (
            {"step": step, "ack": result_of(heard, message.command)}
            | _answers(heard)
            | {
                "senders": sorted({h.component for h in heard if h.name == TO_DEVICE}),
                "gimbal_device_id": sorted({one.gimbal_device_id for one in told}),
                "pitch_deg": round(pitches[-1]) if pitches else None,
                "turning": any(
                    abs(pitch - end) > 1 for pitch in pitches for end in [min(ends, key=lambda e: abs(e - pitch))]
                ),
            }
        )


def _heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


def _rates(heard: list[Heard]) -> dict[str, Any]:
    """How often the attitude of the gimbal came, of the autopilot and of the device, in tens per second."""
    counts = {component: sum(h.name == TO_DEVICE and h.component == component for h in heard) for component in (1, 154)}
    return {"rates_hz": {str(component): round(count / 4.0, -1) for component, count in counts.items()}}


def _answers(heard: list[Heard]) -> dict[str, Any]:
    found: dict[str, dict[str, Any]] = {}
    for item in heard:
        if item.name in FIELDS:
            found[f"{item.component} {item.name}"] = {f: getattr(item.message, f) for f in FIELDS[item.name]}
    return {"messages": dict(sorted(found.items()))}


def _control(peer: Peer) -> list[int]:
    """Who has primary control, on request; empty if nothing was said."""
    peer.send(command(REQUEST, 281))
    told = [h.message for h in peer.listen(0.1) if h.name == "GIMBAL_MANAGER_STATUS"]
    return [told[-1].primary_control_sysid, told[-1].primary_control_compid] if told else []


def _pitch(heard: list[Heard]) -> int:
    """Where the device says that it points, whole degrees."""
    return round(_pitch_of([h.message for h in heard if h.name == TO_DEVICE and h.component == GIMBAL][-1]))


def _pitch_of(message: Any) -> float:
    w, x, y, z = message.q
    return math.degrees(math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x)))))


def embedded() -> SimConfig:
    """The embedded vehicle for this conversation, on the ground."""
    config = SimConfig(autopilot="px4")
    return dataclasses.replace(config, airframe=dataclasses.replace(config.airframe, in_air=False))


def embedded_aux() -> SimConfig:
    """The embedded vehicle with a gimbal on its outputs."""
    return dataclasses.replace(embedded(), mount="echo")


def _fly(peer: UdpPeer) -> None:
    """Arm and climb to Hold."""
    for _ in range(60):
        peer.send(_heartbeat())
        peer.send(command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1))
        if result_of(peer.listen(1.0), mavlink.MAV_CMD_COMPONENT_ARM_DISARM) == mavlink.MAV_RESULT_ACCEPTED:
            break
    peer.send(command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN))
    for _ in range(40):
        peer.send(_heartbeat())
        beats = [h.message for h in peer.listen(1.0) if h.name == "HEARTBEAT" and h.component == 1]
        if beats and beats[-1].custom_mode == 4 << 16 | 3 << 24:
            break


def _sitl(binary: Path, parameters: dict[str, float]) -> SitlOptions:
    ground_port, payload_port = free_udp_ports(2)
    return SitlOptions(
        binary=binary,
        ground_port=ground_port,
        payload_port=payload_port,
        speedup=1.0,
        home=(47.4, 8.5, 488.0, 20.0),
        parameters=parameters,
    )


async def record(binary: Path) -> list[dict[str, Any]]:
    """Start the autopilot and hold both conversations."""
    options = _sitl(binary, {"MIS_TAKEOFF_ALT": 15.0})
    ground = UdpPeer(options.ground_port)
    payload = SimConfig(attach_url=f"udpin:127.0.0.1:{options.payload_port}", output=None)
    async with running_simulator(payload, note=lambda _: None), running_sitl(options):
        await asyncio.to_thread(ground.listen, 25.0)
        steps = await asyncio.to_thread(lambda: list(hold(ground)))
        await asyncio.to_thread(_fly, ground)
        return steps + await asyncio.to_thread(lambda: list(hold_in_air(ground)))


async def record_aux(binary: Path) -> list[dict[str, Any]]:
    """Start the autopilot with a gimbal on its outputs, and hold that conversation."""
    options = _sitl(binary, {"MNT_MODE_IN": 4, "MNT_MODE_OUT": 0})
    ground = UdpPeer(options.ground_port)
    async with running_sitl(options):
        await asyncio.to_thread(ground.listen, 25.0)
        return await asyncio.to_thread(lambda: list(hold_aux(ground)))


if __name__ == "__main__":
    for recorded, file in zip((record, record_aux), sys.argv[2:], strict=False):
        lines = [json.dumps(step) + "\n" for step in asyncio.run(recorded(sitl_binary(sys.argv[1])))]
        Path(file).write_text("".join(lines), encoding="utf-8")
