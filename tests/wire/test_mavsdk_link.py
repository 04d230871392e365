"""The link over real sockets: found, kept, healed."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import pty
import socket
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.stream_health import HEARTBEAT_LOST_S
from panoexec.adapters.link.stream_keeper import StreamReport
from panoexec.clock import SystemClock
from panoexec.errors import DeviceError, LinkError, UsageError
from panoexec.sim.ports import free_tcp_port, free_udp_port
from tests.waiting import eventually
from tests.wire.scripted_peer import FAILED, ScriptedPeer, listening

CLOCK = SystemClock()


def interval_requests(autopilot: ScriptedPeer, message: int) -> list[float]:
    """The rates, Hz, that were asked for."""
    return [1e6 / command.param2 for command in autopilot.sent(511) if command.param1 == message]


async def test_finds_the_autopilot_and_asks_for_its_streams(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    assert link.connected
    assert link.vehicle_system_id == 1
    assert link.own_ids == (1, 191)
    assert link.is_ardupilot
    await autopilot.until(lambda: 33 in autopilot.streams)
    assert interval_requests(autopilot, 30) == [2.0]
    await link.use_rates(active=True)
    assert interval_requests(autopilot, 30)[-1] == pytest.approx(50.0)
    assert interval_requests(autopilot, 33)[-1] == pytest.approx(5.0)
    await link.use_rates(active=False)
    assert interval_requests(autopilot, 30)[-1] == pytest.approx(2.0)
    sender = autopilot.commands[0]
    assert (sender.get_srcSystem(), sender.get_srcComponent()) == (1, 191)
    await autopilot.until(lambda: (1, 191) in autopilot.heard)


async def test_messages_find_the_thread_that_brings_them_as_the_last_one_left_it(
    autopilot: ScriptedPeer, link: MavsdkLink
) -> None:
    local, counts = threading.local(), []

    def heard(_message: object) -> None:
        local.count = getattr(local, "count", 0) + 1
        counts.append(local.count)

    off = link.on("HEARTBEAT", heard)
    await eventually(lambda: len(counts) >= 3, 20)
    off()
    # in a thread that Python meets anew with each message, each would be the first
    assert counts == list(range(1, len(counts) + 1))


async def test_reports_how_streams_do(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    await link.use_rates(active=True)

    def rate(message: int) -> StreamReport:
        return next(report for report in link.streams.reports() if report.stream.message_id == message)

    assert rate(30).wanted_hz == 50.0
    # the first two seconds that are measured may have begun before the request
    await eventually(lambda: 30 < rate(30).measured_hz < 70 and rate(30).age_s < 0.5)
    await eventually(lambda: rate(285).refused)  # this autopilot has no gimbal
    assert rate(285).measured_hz == 0.0


async def test_after_a_reboot_everything_is_asked_for_again(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    back = asyncio.Event()
    link.when_back(back.set)
    await autopilot.until(lambda: {30, 33} <= autopilot.streams.keys())
    autopilot.boot_at -= 3600  # an hour after boot
    heard_ms: list[int] = []
    off = link.on("ATTITUDE", lambda message: heard_ms.append(message.fields["time_boot_ms"]))
    await eventually(lambda: heard_ms and heard_ms[-1] >= 3_600_000)
    off()
    assert link.boot_count == 0
    autopilot.reboot()
    assert not autopilot.streams
    await autopilot.until(lambda: {30, 33} <= autopilot.streams.keys())
    async with asyncio.timeout(30):
        await back.wait()
    assert link.boot_count == 1


async def test_a_reboot_right_after_power_on_is_detected(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    """Its time since boot is longer than before when the autopilot is heard again: all streams must be requested."""
    await eventually(lambda: any(math.isfinite(report.age_s) for report in link.streams.reports()))
    # nothing is under way any more when it reboots, as the answer arrives after all that was sent before it
    autopilot.streams.clear()
    cleared_ms = autopilot.boot_ms()
    await asyncio.sleep(0.002)
    await link.requests.message(
        33, "GLOBAL_POSITION_INT", fits=lambda message: message.fields["time_boot_ms"] > cleared_ms
    )
    autopilot.reboot()
    await autopilot.until(lambda: {30, 33} <= autopilot.streams.keys())
    await eventually(lambda: link.boot_count)
    assert link.boot_count == 1


async def test_a_lost_link_is_noticed_and_its_return_too(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    await autopilot.until(lambda: {30, 33} <= autopilot.streams.keys())
    autopilot.beating = False
    autopilot.streams.clear()
    began, age_s = time.monotonic(), link.heartbeat_age_s
    await eventually(lambda: not link.connected)
    assert time.monotonic() - began + age_s > 2.5
    assert HEARTBEAT_LOST_S == 3.0
    autopilot.answers[31_000] = lambda _: None
    with pytest.raises(LinkError, match="no link to the autopilot"):
        await link.requests.command(31_000)
    autopilot.commands.clear()
    autopilot.beating = True
    await link.wait_autopilot(60)
    await autopilot.until(lambda: {30, 33} <= autopilot.streams.keys())


async def test_no_autopilot_says_what_to_look_at() -> None:
    url = f"udpin://127.0.0.1:{free_udp_port()}"
    async with MavsdkLink(url, clock=CLOCK) as link:
        assert not link.connected
        with pytest.raises(LinkError, match=r"no autopilot on udpin://127\.0\.0\.1:\d+ within 0\.3 s: is it on"):
            await link.wait_autopilot(0.3)
        with pytest.raises(LinkError, match="no autopilot"):
            await link.requests.command(511)
        await link.requests.say("nobody listens")


async def test_a_busy_port_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(LinkError, match=f"UDP port {port} is in use by another program") as caught:
            async with MavsdkLink(f"udpin://0.0.0.0:{port}", clock=CLOCK):
                pass
        assert caught.value.exit_code == 3


async def test_a_second_daemon_does_not_steal_the_first_ones_port(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    with pytest.raises(LinkError, match=f"UDP port {autopilot.port} is in use"):
        async with MavsdkLink(autopilot.url, clock=CLOCK):
            pass
    assert link.connected


@pytest.mark.parametrize(
    ("url", "complaint"),
    [
        ("udpin://203.0.113.7:24999", "203.0.113.7 is not an address of this machine"),
        ("udpin://no-such-host.invalid:24999", "host 'no-such-host.invalid' cannot be resolved"),
        ("serial:///dev/no-such-device:57600", "no such device; is it plugged in"),
        ("serial:///dev/null:57600", "does not answer as a serial port"),
    ],
)
async def test_what_cannot_be_opened_says_why(url: str, complaint: str) -> None:
    with pytest.raises(LinkError, match=complaint):
        async with MavsdkLink(url, clock=CLOCK):
            pass


def test_a_wrong_url_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="accepted forms: udpin://"):
        MavsdkLink("usb://here", clock=CLOCK)


async def test_takes_the_system_id_of_the_vehicle() -> None:
    async with (
        listening(ScriptedPeer(system=7)) as peer,
        MavsdkLink(peer.url, clock=CLOCK, component_id=195) as link,
    ):
        await link.wait_autopilot(60)
        assert link.own_ids == (7, 195)
        await peer.until(lambda: peer.commands)
        assert (peer.commands[-1].get_srcSystem(), peer.commands[-1].get_srcComponent()) == (7, 195)
        assert peer.commands[-1].target_system == 7


async def test_takes_the_vehicle_it_was_told_to() -> None:
    async with (
        listening(ScriptedPeer(system=3)) as other,
        listening(ScriptedPeer(system=4), other.port) as ours,
        MavsdkLink(ours.url, clock=CLOCK, system_id=9, vehicle_system_id=4) as link,
    ):
        await link.wait_autopilot(60)
        assert link.vehicle_system_id == 4
        assert link.own_ids == (9, 191)
        await ours.until(lambda: 30 in ours.streams)


async def test_a_twin_on_the_vehicle_is_noticed(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    assert not link.has_id_conflict
    for _ in range(3):
        autopilot.beat(191, 18)
    autopilot.beat(154, 26)
    await eventually(lambda: link.has_id_conflict and 154 in link.components)
    assert link.components[154][0] == 26


async def test_tells_the_pilot_in_lines_of_fifty(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    await link.requests.say(
        "panoexec: 37 of 64 shots, paused, the vehicle drifted 4.2 m from where it began — bring it back"
    )
    await autopilot.until(lambda: len(autopilot.others) >= 2)
    told = [message for message in autopilot.others if message.get_type() == "STATUSTEXT"]
    assert [message.severity for message in told] == [5, 5]
    assert all(len(message.text) <= 50 for message in told)
    assert " ".join(message.text for message in told).startswith(
        "panoexec: 37 of 64 shots, paused, the vehicle drifted"
    )
    assert told[0].get_srcComponent() == 191


async def test_commands_say_how_they_were_answered(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    autopilot.answers[31_001] = lambda _: FAILED
    assert await link.requests.command(31_001, [1.5, 2.5], component=1) == FAILED
    sent = autopilot.sent(31_001)[0]
    assert (sent.param1, sent.param2, sent.param3, sent.target_component) == (1.5, 2.5, 0.0, 1)
    autopilot.answers[31_002] = lambda _: None
    with pytest.raises(DeviceError, match="command 31002: not answered"):
        await link.requests.command(31_002)


async def test_asks_for_single_messages_and_parameters(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    message = await link.requests.message(33, "GLOBAL_POSITION_INT")
    assert message.fields["lat"] == 473977420
    with pytest.raises(DeviceError, match=r"requesting HOME_POSITION \(242\): failed"):
        await link.requests.message(242, "HOME_POSITION")
    autopilot.answers[512] = lambda _: 0
    with pytest.raises(DeviceError, match="accepted, but the message did not arrive"):
        await link.requests.message(242, "HOME_POSITION", timeout_s=0.1)
    autopilot.parameters["MNT1_TYPE"] = 6
    assert await link.requests.parameter("MNT1_TYPE") == 6


async def test_handlers_can_be_taken_away_and_may_fail(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    good: list[float] = []

    def bad(_: object) -> None:
        raise ValueError("a handler's own trouble")

    off_bad = link.on("ATTITUDE", bad)
    off_good = link.on("GLOBAL_POSITION_INT", lambda message: good.append(message.received_s))
    await autopilot.until(lambda: {30, 33} <= autopilot.streams.keys())
    await eventually(lambda: len(good) >= 3)
    assert good == sorted(good)
    await eventually(lambda: abs(good[-1] - CLOCK.monotonic()) < 1.0)
    off_bad()
    off_good()
    off_good()
    heard = len(good)
    await asyncio.sleep(0.3)
    assert len(good) <= heard + 1


async def test_tcp_heals_when_the_other_side_comes_back() -> None:
    loop = asyncio.get_running_loop()
    first = ScriptedPeer()
    port = free_tcp_port()
    server = await loop.create_server(lambda: first, "127.0.0.1", port)
    async with MavsdkLink(f"tcp:127.0.0.1:{port}", clock=CLOCK) as link:
        await link.wait_autopilot(60)
        await first.until(lambda: 30 in first.streams)
        first.close()
        server.close()
        await server.wait_closed()
        second = ScriptedPeer()
        server = await loop.create_server(lambda: second, "127.0.0.1", port)
        await second.until(lambda: 30 in second.streams)
        assert link.connected
        second.close()
        server.close()
        await server.wait_closed()


class Cable:
    """A pseudo-terminal under a stable name: what is plugged in there, if anything."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.plugged: ScriptedPeer | None = None
        self._master = -1

    def plug(self) -> ScriptedPeer:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(slave))
        os.close(slave)
        os.set_blocking(self._master, False)
        peer = self.plugged = ScriptedPeer()
        asyncio.get_running_loop().add_reader(self._master, self._read)
        peer.use(self._write)
        return peer

    def unplug(self) -> None:
        if self.plugged is not None:
            self.plugged.close()
            asyncio.get_running_loop().remove_reader(self._master)
            os.close(self._master)
            self.plugged = None
            self.name.unlink(missing_ok=True)

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            if self.plugged is not None:
                self.plugged.data_received(os.read(self._master, 4096))

    def _write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._master, data)


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    one = Cable(tmp_path / "usb-ArduPilot-if00")
    yield one
    assert one.plugged is None, "unplug it"


async def test_a_serial_device_may_be_absent_at_first_and_unplugged_later(cable: Cable) -> None:
    async with MavsdkLink(f"serial://{cable.name}:57600", clock=CLOCK, patient=True) as link:
        with pytest.raises(LinkError, match="is it powered"):
            await link.wait_autopilot(0.1)
        peer = cable.plug()
        await link.wait_autopilot(60)
        await peer.until(lambda: 30 in peer.streams)
        cable.unplug()
        await eventually(lambda: not link.connected)
        peer = cable.plug()
        await peer.until(lambda: 30 in peer.streams, 60)
        await link.wait_autopilot(60)
        cable.unplug()
