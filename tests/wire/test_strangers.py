"""Other systems on the link: the vehicle's autopilot is told for certain, and nobody else's messages count."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack

import pytest

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.roster import AutopilotKind
from panoexec.adapters.mavsdk_vehicle import MavsdkVehicle
from panoexec.clock import SystemClock
from panoexec.doctor.camera import check_camera
from panoexec.doctor.findings import Findings
from panoexec.errors import LinkError
from panoexec.inputs.config import Config
from panoexec.sim.mavlink.dialect import mavlink
from tests.waiting import eventually
from tests.wire.scripted_peer import ACCEPTED, DENIED, ScriptedPeer, listening

CLOCK = SystemClock()
ARDUPILOT, PX4 = 3, 12
TIMES = 8


class Autopilot(ScriptedPeer):
    """An autopilot of either kind; PX4 in Hold."""

    def __init__(self, kind: AutopilotKind, *, system: int = 1) -> None:
        super().__init__(system=system)
        self.is_px4 = kind == "px4"
        self.repositions: list[object] = []
        self.answers |= {115: lambda _: ACCEPTED}

    def send(self, message: object, component: int = 1) -> None:
        if component == 1 and message.get_type() == "HEARTBEAT" and self.is_px4:  # type: ignore[attr-defined]
            message = mavlink.MAVLink_heartbeat_message(2, PX4, 81, 4 << 16 | 3 << 24, 4, 3)
        super().send(message, component)

    def data_received(self, data: bytes) -> None:
        before = len(self.others)
        super().data_received(data)
        for message in self.others[before:]:
            if message.get_type() == "COMMAND_INT":
                self.repositions.append(message)
                self.acknowledge(message, ACCEPTED)


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
async def test_the_autopilot_is_known_for_certain_as_soon_as_it_is_found(kind: AutopilotKind) -> None:
    """Every time, though a component that says another kind beats as often as the autopilot."""

    async def once(number: int) -> None:
        async with AsyncExitStack() as stack:
            peer = await stack.enter_async_context(listening(Autopilot(kind)))
            other = PX4 if kind == "ardupilot" else ARDUPILOT
            link = await stack.enter_async_context(MavsdkLink(peer.url, clock=CLOCK))
            vehicle = await stack.enter_async_context(MavsdkVehicle(link))
            if number % 2:  # before the autopilot, in its system
                for _ in range(3):
                    peer.send(mavlink.MAVLink_heartbeat_message(2, other, 81, 4, 4, 3), 191)
            async with asyncio.TaskGroup() as group:
                chatter = group.create_task(chatting(peer, other))
                await link.wait_autopilot(20)
                assert (link.autopilot, link.is_ardupilot) == (kind, kind == "ardupilot")
                assert vehicle.turn_modes == (("OFFBOARD",) if kind == "ardupilot" else ("HOLD",))
                await eventually(lambda: vehicle.status.mode == vehicle.turn_modes[0])
                chatter.cancel()

    async def chatting(peer: Autopilot, other: int) -> None:
        while True:
            peer.send(mavlink.MAVLink_heartbeat_message(2, other, 81, 0, 4, 3), 155)
            await asyncio.sleep(0.01)

    for number in range(TIMES):
        await once(number)


async def test_each_autopilot_is_turned_in_its_own_way() -> None:
    async with (
        listening(Autopilot("px4")) as peer,
        MavsdkLink(peer.url, clock=CLOCK) as link,
        MavsdkVehicle(link) as vehicle,
    ):
        await link.wait_autopilot(20)
        await eventually(lambda: vehicle.status.altitude_m == 488.0)
        await vehicle.turn(270.0, 30.0)
        (sent,) = peer.repositions
        assert sent.command == 192  # type: ignore[attr-defined]
        assert (sent.x, sent.y, sent.z) == (473977420, 85455940, 488.0)  # type: ignore[attr-defined]
        assert sent.param4 == pytest.approx(-1.5707964)  # type: ignore[attr-defined]
        assert (sent.param1, sent.param2) == (-1.0, 1.0)  # type: ignore[attr-defined]
        assert peer.sent(115) == []
    async with (
        listening(Autopilot("ardupilot")) as peer,
        MavsdkLink(peer.url, clock=CLOCK) as link,
        MavsdkVehicle(link) as vehicle,
    ):
        await link.wait_autopilot(20)
        await vehicle.turn(270.0, 30.0)
        assert [command.param1 for command in peer.sent(115)] == [270.0]
        assert peer.repositions == []


async def test_a_stranger_that_beats_before_power_on_does_not_get_a_pinned_daemon() -> None:
    async with (
        listening(Autopilot("px4", system=3)) as stranger,
        MavsdkLink(stranger.url, clock=CLOCK, vehicle_system_id=4) as link,
    ):
        await eventually(lambda: link.roster.member(3, 1) is not None, 20)
        with pytest.raises(LinkError, match=r"\[vehicle\] system_id is 4, but the vehicles on this link .* ids 3"):
            await link.wait_autopilot(0.2)
        async with listening(Autopilot("ardupilot", system=4), stranger.port) as ours:
            await link.wait_autopilot(20)
            assert (link.vehicle_system_id, link.autopilot, link.own_ids) == (4, "ardupilot", (4, 191))
            assert link.identity.problem == ""
            await ours.until(lambda: 30 in ours.streams)
            # MAVSDK sends to everybody on a UDP port, and asks each autopilot for its version itself
            assert {command.target_system for command in stranger.sent(511)} == {4}


async def test_the_first_vehicle_is_taken_and_a_second_one_is_told() -> None:
    async with listening(Autopilot("px4", system=3)) as first, MavsdkLink(first.url, clock=CLOCK) as link:
        await link.wait_autopilot(20)
        assert (link.vehicle_system_id, link.autopilot) == (3, "px4")
        assert link.identity.problem == ""
        async with listening(Autopilot("ardupilot", system=4), first.port):
            await eventually(lambda: link.identity.problem, 20)
            assert "system 3, which was heard first, and system 4: set [vehicle] system_id" in link.identity.problem
            first.beating = False
            await eventually(lambda: "is silent" in link.identity.problem, 20)
            assert "set [vehicle] system_id = 4" in link.identity.problem
            assert link.autopilot == "px4", "what is turned, and how, does not change by itself"


async def test_messages_of_other_systems_reach_no_handler() -> None:
    """Reports that would prove a photo or a pose, told by another system over the same link."""
    names = ("ATTITUDE", "GLOBAL_POSITION_INT", "CAMERA_IMAGE_CAPTURED", "GIMBAL_DEVICE_ATTITUDE_STATUS")
    heard: list[tuple[str, int, int]] = []
    urls: set[str] = set()
    async with listening(Autopilot("ardupilot", system=4)) as ours, MavsdkLink(ours.url, clock=CLOCK) as link:
        for name in names:
            link.on(name, lambda message: heard.append((message.name, message.system_id, message.component_id)))
        link.on("CAMERA_IMAGE_CAPTURED", lambda message: urls.add(message.fields["file_url"]))
        await link.wait_autopilot(20)
        async with listening(Autopilot("px4", system=3), ours.port) as stranger:
            await eventually(lambda: link.roster.member(3, 1) is not None, 20)
            for peer in (stranger, ours) * 5:
                peer.send(mavlink.MAVLink_attitude_message(5000, 0, 0, 0, 0, 0, 0))
                peer.send(mavlink.MAVLink_global_position_int_message(5000, 1, 1, 1, 1, 0, 0, 0, 0))
                for component in (1, 100, 154):
                    peer.send(
                        mavlink.MAVLink_camera_image_captured_message(
                            5000, 0, 1, 0, 0, 0, 0, [1, 0, 0, 0], 7, 1, b"file:///etc/hostname"
                        ),
                        component,
                    )
                    peer.send(
                        mavlink.MAVLink_gimbal_device_attitude_status_message(
                            0, 0, 5000, 44, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, 0
                        ),
                        component,
                    )
            await eventually(lambda: sum(name == names[-1] for name, _, _ in heard) >= 15, 20)
    assert {system for _, system, _ in heard} == {4}
    assert urls == {""}, "a file of this computer that no configuration expects is dropped"
    assert "file:///etc/hostname" in link.files.refused
    assert {name for name, _, _ in heard} == set(names)
    assert link.boot_count <= 1


async def test_a_camera_with_another_system_id_is_named_with_what_to_set_and_nothing_else() -> None:
    async with listening(Autopilot("ardupilot", system=4)) as ours, MavsdkLink(ours.url, clock=CLOCK) as link:
        await link.wait_autopilot(20)
        async with listening(Autopilot("px4", system=1), ours.port) as foreign:
            foreign.beating = False

            def is_heard() -> bool:
                foreign.beat(100, 30)
                return link.roster.member(1, 100) is not None

            await eventually(is_heard, 20)
            findings = Findings()
            await check_camera(link, Config(), findings, patience_s=0.5, photo=False)
    (finding,) = findings.all
    assert "system 1" in finding.found
    assert "but the vehicle is system 4" in finding.found
    assert finding.advice == "the camera's own settings: system id 4"


async def test_an_acknowledgement_of_another_system_is_none() -> None:
    """A stranger that hears our commands accepts each of them at once; ours answers later, and refuses."""
    async with listening(Autopilot("ardupilot", system=4)) as ours, MavsdkLink(ours.url, clock=CLOCK) as link:
        await link.wait_autopilot(20)
        async with listening(Autopilot("px4", system=3), ours.port) as stranger:
            await eventually(lambda: link.roster.member(3, 1) is not None, 20)
            stranger.answers[31_000] = lambda _: ACCEPTED
            loop = asyncio.get_running_loop()

            def later(command: object) -> None:
                loop.call_later(0.2, ours.acknowledge, command, DENIED)

            ours.answers[31_000] = later
            assert await link.requests.command(31_000) == DENIED
            assert stranger.sent(31_000), "it was heard"
