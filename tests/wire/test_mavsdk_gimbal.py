"""The gimbal over real sockets: found, taken, pointed, watched, lost, given back."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from panoexec.adapters.gimbal import mavsdk_gimbal
from panoexec.adapters.gimbal.feedback_kind import Feedback
from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.devices import Gimbal, YawFrame
from panoexec.errors import DeviceError, LinkError
from panoexec.mission.pointing.poses import pose_of, read_pose
from panoexec.sim.mavlink.dialect import mavlink
from tests.waiting import eventually
from tests.wire.scripted_peer import DENIED, NAN, GimbalPeer, ScriptedPeer

DEVICE = 154


@pytest.fixture
async def gimbal(gimbal_link: MavsdkLink) -> AsyncIterator[MavsdkGimbal]:
    async with MavsdkGimbal(gimbal_link) as one:
        await one.discover()
        yield one


def half_turn(yaw_deg: float, pitch_deg: float) -> list[float]:
    y, p = math.radians(yaw_deg) / 2, math.radians(pitch_deg) / 2
    return [
        math.cos(p) * math.cos(y),
        -math.sin(p) * math.sin(y),
        math.sin(p) * math.cos(y),
        math.cos(p) * math.sin(y),
    ]


async def test_is_found_with_its_limits(gimbal: MavsdkGimbal) -> None:
    protocol: Gimbal = gimbal
    found = gimbal.found
    assert found is not None
    assert (found.manager_component, found.device_id, found.vendor, found.feedback) == (1, 1, "", "vehicle")
    limits = protocol.limits
    assert limits is not None
    assert (limits.pitch_min_deg, limits.pitch_max_deg) == (-90.0, 28.648)
    assert limits.yaw_endless
    await eventually(lambda: gimbal.age_s < 1.0)


async def test_is_not_found_without_its_attitude_and_says_which_message_is_missing(
    autopilot: ScriptedPeer, link: MavsdkLink
) -> None:
    async with MavsdkGimbal(link) as gimbal:
        with pytest.raises(
            DeviceError, match=r"no gimbal within 0\.3 s: GIMBAL_DEVICE_ATTITUDE_STATUS \(285\) is not received"
        ):
            await gimbal.discover(timeout_s=0.3)
        assert gimbal.feed.latest is None
        assert not gimbal.in_control
        await gimbal.release()


async def test_is_not_found_without_a_manager_and_says_so(
    gimbal_autopilot: GimbalPeer, gimbal_link: MavsdkLink
) -> None:
    del gimbal_autopilot.builders[280]
    async with MavsdkGimbal(gimbal_link) as gimbal:
        await eventually(lambda: gimbal.feed.latest is not None)
        with pytest.raises(
            DeviceError, match=r"no gimbal manager answers the request for GIMBAL_MANAGER_INFORMATION \(280\)"
        ):
            await gimbal.discover(timeout_s=0.3)


async def test_is_found_only_once_its_attitude_tells_who_sends_it(
    gimbal_autopilot: GimbalPeer, gimbal_link: MavsdkLink
) -> None:
    gimbal_autopilot.parameters["MNT1_TYPE"] = 7
    await gimbal_autopilot.until(lambda: 285 in gimbal_autopilot.streams)
    attitude, interval_s = gimbal_autopilot.builders.pop(285), gimbal_autopilot.streams.pop(285)
    # no attitude is under way any more, as the answer arrives after all that was sent before it
    last_ms = gimbal_autopilot.boot_ms()
    await asyncio.sleep(0.002)
    await gimbal_link.requests.message(
        33, "GLOBAL_POSITION_INT", fits=lambda message: message.fields["time_boot_ms"] > last_ms
    )
    async with MavsdkGimbal(gimbal_link) as gimbal:
        await gimbal_autopilot.until(lambda: any(ask.param1 == 280 for ask in gimbal_autopilot.sent(512)))
        finding = asyncio.create_task(gimbal.discover())
        await eventually(lambda: gimbal.limits is not None)
        assert not finding.done()
        gimbal_autopilot.builders[285], gimbal_autopilot.streams[285] = attitude, interval_s
        assert (await finding).feedback == "none"


async def test_is_taken_and_given_back_with_confirmation(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    assert not gimbal.in_control
    await gimbal.acquire()
    assert gimbal.in_control
    assert gimbal.controlled_by == (1, 191)
    assert gimbal_autopilot.streams[285] == pytest.approx(1 / 50)
    assert gimbal_autopilot.streams[30] == pytest.approx(1 / 50)
    await gimbal.release()
    assert gimbal_autopilot.control == (0, 0)
    assert not gimbal.in_control
    assert gimbal_autopilot.streams[285] == pytest.approx(1 / 2)


async def test_taking_it_is_not_believed_without_confirmation(
    gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal
) -> None:
    gimbal_autopilot.control = (255, 190)
    gimbal_autopilot.answers[1001] = lambda _: 0  # accepted, and nothing done
    with pytest.raises(DeviceError, match="accepted, but its manager reports system 255 component 190 after 3 s"):
        await gimbal.acquire()


async def test_a_confirmation_that_is_lost_is_asked_for_again(
    gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a manager that sends its status on request only."""
    monkeypatch.setattr(mavsdk_gimbal, "_TAKE_S", 30.0)  # it does not need to be asked quickly
    requested, interval, asked = gimbal_autopilot.answers[512], gimbal_autopilot.answers[511], []

    def loses_the_first(command: Any) -> int | None:
        if command.param1 != 281:
            return requested(command)
        asked.append(command)
        return 0 if len(asked) == 1 else requested(command)

    gimbal_autopilot.answers[512] = loses_the_first
    gimbal_autopilot.answers[511] = lambda command: DENIED if command.param1 == 281 else interval(command)
    gimbal_autopilot.streams.pop(281, None)
    await gimbal.acquire()
    assert gimbal.in_control
    assert len(asked) >= 2


async def test_a_refusal_is_a_device_error(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    gimbal_autopilot.answers[1001] = lambda _: DENIED
    with pytest.raises(DeviceError, match="taking control of the gimbal: "):
        await gimbal.acquire()
    gimbal_autopilot.answers[1000] = lambda _: DENIED
    with pytest.raises(DeviceError, match=r"pointing the gimbal at pitch -10\.0° yaw 20\.0°: ") as caught:
        await gimbal.point(-10.0, 20.0)
    assert not isinstance(caught.value, LinkError)
    assert caught.value.__cause__ is not None


async def test_loss_of_control_is_noticed(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    await gimbal.acquire()
    gimbal_autopilot.control = (255, 190)
    await eventually(lambda: not gimbal.in_control)
    assert gimbal.controlled_by == (255, 190)


async def test_points_in_the_earth_frame(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    for yaw_deg, sent_deg in ((0.0, 0.0), (-120.5, -120.5), (180.0, -180.0), (190.0, -170.0), (-540.0, -180.0)):
        await gimbal.point(-33.25, yaw_deg)
        command = gimbal_autopilot.sent(1000)[-1]
        assert (command.param1, command.param2) == (-33.25, sent_deg)
        assert int(command.param5) & 16  # YAW_LOCK: yaw from north
        assert (command.target_component, command.param7) == (1, 1)


async def test_points_along_the_nose(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    await gimbal.point(-33.25, None)
    command = gimbal_autopilot.sent(1000)[-1]
    assert (command.param1, command.param2) == (-33.25, 0.0)
    assert not int(command.param5) & 16  # YAW_LOCK: yaw from the nose without it


async def test_does_not_point_nowhere(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    with pytest.raises(ValueError, match="cannot point at pitch nan"):
        await gimbal.point(math.nan, 0.0)
    assert not gimbal_autopilot.sent(1000)


async def test_pointing_at_a_dead_link_is_a_link_error_and_release_is_bounded(
    gimbal_autopilot: GimbalPeer,
    gimbal_link: MavsdkLink,
    gimbal: MavsdkGimbal,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def never(*_: object, **__: object) -> None:
        await asyncio.Event().wait()

    await gimbal.acquire()
    gimbal_autopilot.close()
    await eventually(lambda: not gimbal_link.connected)
    with pytest.raises(LinkError, match="no link to the autopilot"):
        await gimbal.point(0.0, 0.0)
    await gimbal.release()
    assert mavsdk_gimbal._RELEASE_S < 3.0
    monkeypatch.setattr(gimbal._commands, "release", never)
    async with asyncio.timeout(30):
        await gimbal.release()


async def test_the_feed_delivers_what_was_sent_when_it_comes(
    gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal
) -> None:
    sent_s: list[float] = []
    attitude = gimbal_autopilot.attitude

    def noted() -> Any:
        message = attitude()
        sent_s.append(message.time_boot_ms / 1000)
        return message

    await gimbal.acquire()
    assert gimbal_autopilot.streams[285] == pytest.approx(1 / 50)
    gimbal_autopilot.builders[285] = noted
    first = await gimbal.feed.newer_than(-math.inf)
    async with asyncio.timeout(30):
        while not sent_s or first.vehicle_s < sent_s[0]:
            first = await gimbal.feed.newer_than(first.received_s)
    newest = first.received_s
    for _ in range(20):
        sample = await gimbal.feed.newer_than(newest)
        assert sample.received_s > newest
        newest = sample.received_s
    came_s = [first.vehicle_s, *(one.vehicle_s for one in gimbal.feed.since(first.received_s))]
    assert len(came_s) >= 20
    begin = sent_s.index(came_s[0])
    assert came_s == sent_s[begin : begin + len(came_s)], "each of them, in order"
    gimbal_autopilot.q = [NAN] * 4
    gimbal_autopilot.rates = (NAN, 0.0, 0.0)
    gimbal_autopilot.failures = 32
    await eventually(lambda: gimbal.feed.latest is not None and gimbal.feed.latest.failure_flags == 32)
    worst = gimbal.feed.latest
    assert worst is not None
    assert all(math.isnan(part) for part in worst.q_wxyz)
    assert math.isnan(worst.rate_deg_s)


async def test_the_pose_is_the_same_whatever_frame_it_comes_in(
    gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal
) -> None:
    """The vehicle heads 90°; the camera looks 30° from the nose or from north, level, whatever the vehicle's lean."""
    gimbal_autopilot.euler = (math.radians(14), math.radians(-8), math.radians(90))
    gimbal_autopilot.q = half_turn(30.0, -20.0)
    await gimbal.acquire()

    def pose() -> tuple[float, float, float] | None:
        gimbal.feed.ingest()
        sample = gimbal.feed.latest
        assert sample is not None
        rotation = read_pose(sample, gimbal.feed.vehicle_attitude_at(sample), 0.0).rotation
        if rotation is None:
            return None
        found = pose_of(rotation)
        return found.yaw_deg, found.pitch_deg, found.roll_deg

    # vehicle; as ArduPilot says when yaw is locked; earth; and the two of before the frame flags existed
    for flags, yaw_deg in ((44, 120.0), (76, 30.0), (60, 120.0), (28, 30.0), (12, 120.0)):
        gimbal_autopilot.flags = flags
        expected = pytest.approx((yaw_deg, -20.0, 0.0), abs=1e-3)

        def is_right(expected: object = expected) -> bool:
            return pose() == expected

        await eventually(is_right)


@contextlib.asynccontextmanager
async def telling(peer: GimbalPeer, component: int, *, hz: float = 50.0, flags: int = 76) -> AsyncIterator[None]:
    """A component that tells an attitude of its own meanwhile."""

    async def tell() -> None:
        while True:
            kept, peer.flags = peer.flags, flags
            peer.send(peer.attitude(device=0), component)
            peer.flags = kept
            await asyncio.sleep(1 / hz)

    task = asyncio.create_task(tell())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_the_gimbals_own_reports_spare_the_autopilots_copy(
    gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal
) -> None:
    async with telling(gimbal_autopilot, DEVICE):
        await eventually(lambda: DEVICE in gimbal.reports.heard())
        await gimbal.acquire()
        assert gimbal.known.device == DEVICE
        # its copy of the attitude, and of the airframe's, which reports relative to the earth do not need
        await eventually(lambda: gimbal_autopilot.streams[285] > 0.9 and gimbal_autopilot.streams[30] > 0.9)
        gimbal.feed.ingest()
        latest = gimbal.feed.latest
        assert latest is not None
        assert latest.yaw_frame is YawFrame.EARTH
    # when they fall silent, the gimbal is silent, whoever else tells attitudes
    async with telling(gimbal_autopilot, 171, flags=44), telling(gimbal_autopilot, 155, flags=44):
        gimbal_autopilot.beat(155, 26)
        # when theirs have come, the last ones of the gimbal have come before
        await eventually(lambda: gimbal.known.strangers == {155, 171})
        gimbal.feed.ingest()
        silent = gimbal.feed.latest
        assert silent is not None
        await asyncio.sleep(1.2)
        gimbal.feed.ingest()
        assert gimbal.feed.latest == silent
        assert gimbal.age_s > 1.0
        await gimbal.acquire()
        assert gimbal.known.device == DEVICE


async def test_no_attitude_comes_from_another_system(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    gimbal.feed.ingest()
    before = gimbal.feed.latest
    assert before is not None
    stranger = mavlink.MAVLink(None, 7, DEVICE)
    for _ in range(20):
        gimbal_autopilot._write(gimbal_autopilot.attitude(boot_ms=77_000, device=0).pack(stranger))
    await gimbal.feed.newer_than(before.received_s)
    assert DEVICE not in gimbal.reports.heard()
    assert all(sample.vehicle_s < 70 for sample in gimbal.feed.since(0.0))


async def test_a_configured_manager_that_is_not_there_is_named(
    gimbal_autopilot: GimbalPeer, gimbal_link: MavsdkLink
) -> None:
    async with MavsdkGimbal(gimbal_link, manager=42) as gimbal:
        await eventually(lambda: bool(gimbal.candidates) and gimbal.reports.has_any)
        with pytest.raises(DeviceError, match=r"\[gimbal\] manager = 42, device = 0 is none of unnamed \(manager 1"):
            await gimbal.discover(timeout_s=0.5)


@pytest.mark.parametrize("answer", [0, 3])
async def test_a_slow_gimbal_is_asked_itself(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal, answer: int) -> None:
    own = gimbal_autopilot.answers[511]
    gimbal_autopilot.answers[511] = lambda command: answer if command.target_component == DEVICE else own(command)

    def asked() -> list[float]:
        return [command.param2 for command in gimbal_autopilot.sent(511) if command.target_component == DEVICE]

    async with telling(gimbal_autopilot, DEVICE, hz=10.0, flags=44):
        await eventually(lambda: DEVICE in gimbal.reports.heard())
        await gimbal.acquire()
        await eventually(lambda: asked() != [])
        assert asked()[0] == 20_000
        await gimbal.release()
        assert (asked()[-1] == 0) == (answer == 0), "its own rate comes back only if it was changed"


@pytest.mark.parametrize(("kind", "feedback"), [(1, "none"), (6, "vehicle"), (7, "none")])
async def test_the_mounts_type_tells_what_its_reports_are_worth(
    gimbal_autopilot: GimbalPeer, gimbal_link: MavsdkLink, kind: int, feedback: Feedback
) -> None:
    gimbal_autopilot.parameters["MNT1_TYPE"] = kind
    async with MavsdkGimbal(gimbal_link) as gimbal:
        assert (await gimbal.discover()).feedback == feedback
        await gimbal.acquire()
        gimbal.feed.ingest()
        latest = gimbal.feed.latest
        assert latest is not None
        sample = await gimbal.feed.newer_than(latest.received_s)
        assert sample.yaw_frame is (YawFrame.BODY if kind == 1 else YawFrame.VEHICLE)
        assert gimbal.known.echo.startswith(f"MNT1_TYPE = {kind} (") == (feedback == "none")


async def test_the_config_overrules_detection(gimbal_autopilot: GimbalPeer, gimbal_link: MavsdkLink) -> None:
    gimbal_autopilot.parameters["MNT1_TYPE"] = 7
    async with MavsdkGimbal(gimbal_link, feedback="earth") as gimbal:
        assert (await gimbal.discover()).feedback == "earth"
        assert (await gimbal.feed.newer_than(0.0)).yaw_frame is YawFrame.EARTH
        assert "MNT1_TYPE = 7" in gimbal.known.echo, "what the autopilot says is not forgotten"


async def test_a_second_mount_does_not_mix_in(gimbal_autopilot: GimbalPeer, gimbal: MavsdkGimbal) -> None:
    gimbal.feed.ingest()
    before = gimbal.feed.latest
    assert before is not None
    for _ in range(20):
        gimbal_autopilot.send(gimbal_autopilot.attitude(boot_ms=999_999, device=2))
    await gimbal.feed.newer_than(before.received_s)
    assert all(sample.vehicle_s < 900 for sample in gimbal.feed.since(0.0))


async def test_the_stream_comes_back_after_a_reboot_in_flight(
    gimbal_autopilot: GimbalPeer, gimbal_link: MavsdkLink, gimbal: MavsdkGimbal
) -> None:
    gimbal_autopilot.boot_at -= 1000
    await gimbal.acquire()

    def vehicle_s() -> float:
        gimbal.feed.ingest()
        return gimbal.feed.latest.vehicle_s if gimbal.feed.latest is not None else math.nan

    await eventually(lambda: vehicle_s() > 1000)
    gimbal_autopilot.control = (0, 0)
    gimbal_autopilot.reboot()
    await eventually(lambda: vehicle_s() < 100)
    await eventually(lambda: gimbal_link.boot_count == 1)
    await eventually(lambda: gimbal_autopilot.streams.get(285) == pytest.approx(1 / 50))
    await eventually(lambda: not gimbal.in_control)
    await gimbal.acquire()
    assert gimbal.in_control


async def test_a_daemon_that_waits_looks_only_now_and_then(gimbal_autopilot: GimbalPeer) -> None:
    gimbal_autopilot.flags = 76
    async with (
        MavsdkLink(gimbal_autopilot.url, clock=SystemClock(), throttling=True) as link,
        MavsdkGimbal(link) as gimbal,
    ):
        await link.wait_autopilot(60)
        heard: list[int] = []
        link.on("GIMBAL_DEVICE_ATTITUDE_STATUS", lambda message: heard.append(message.component_id))
        await link.use_rates(active=False)
        own = 0
        async with asyncio.timeout(60):
            # each look may bring what has waited meanwhile
            while heard.count(DEVICE) < 3 or own < 10 * heard.count(DEVICE):
                gimbal_autopilot.send(gimbal_autopilot.attitude(device=0), DEVICE)
                own += 1
                await asyncio.sleep(0.01)
        assert len(gimbal.feed.since(0.0)) >= 3
        # a mission has them all
        await link.use_rates(active=True)
        gimbal.feed.ingest()
        latest = gimbal.feed.latest
        assert latest is not None
        for _ in range(30):
            gimbal_autopilot.send(gimbal_autopilot.attitude(device=0), DEVICE)
            await asyncio.sleep(0.005)
        await eventually(lambda: len(gimbal.feed.since(latest.received_s)) >= 30)


def test_the_peer_speaks_of_the_right_gimbal() -> None:
    assert mavlink.MAV_COMP_ID_GIMBAL == DEVICE
