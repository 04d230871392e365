import asyncio
import math

import pytest

from panoexec.adapters.gimbal.attitude_buffer import KEEP_S, AttitudeBuffer
from panoexec.devices import AttitudeSample, VehicleAttitude, YawFrame

AUTOPILOT, DEVICE = 1, 154


def sample(received_s: float, vehicle_s: float = math.nan) -> AttitudeSample:
    return AttitudeSample(
        received_s=received_s,
        vehicle_s=vehicle_s,
        q_wxyz=(1.0, 0.0, 0.0, 0.0),
        yaw_frame=YawFrame.VEHICLE,
        rate_deg_s=0.0,
    )


def feed(buffer: AttitudeBuffer, times_s: list[float]) -> None:
    for time_s in times_s:
        buffer.put_sample(sample(time_s), AUTOPILOT)


def turned(yaw_deg: float) -> tuple[float, float, float, float]:
    half = math.radians(yaw_deg) / 2
    return math.cos(half), 0.0, 0.0, math.sin(half)


def yaw_of(attitude: VehicleAttitude | None) -> float:
    assert attitude is not None
    return math.degrees(2 * math.atan2(attitude.q_wxyz[3], attitude.q_wxyz[0]))


def test_the_newest_is_kept_and_the_old_go() -> None:
    buffer = AttitudeBuffer()
    assert buffer.latest is None
    assert buffer.since(0.0) == []
    for tick in range(100):
        buffer.put_sample(sample(float(tick)), AUTOPILOT)
    assert buffer.latest == sample(99.0)
    assert [s.received_s for s in buffer.since(96.0)] == [97.0, 98.0, 99.0]
    assert buffer.since(-1.0)[0].received_s == 99.0 - KEEP_S


def test_the_gimbals_own_reports_are_preferred_to_the_autopilots_copy() -> None:
    buffer = AttitudeBuffer()
    buffer.put_sample(sample(1.0), AUTOPILOT)
    buffer.put_sample(sample(1.1), DEVICE)
    buffer.put_sample(sample(1.2), AUTOPILOT)
    assert [s.received_s for s in buffer.since(0.0)] == [1.0, 1.1]
    assert buffer.source_component == DEVICE
    # and when the gimbal's own fall silent, the copy is better than nothing
    buffer.put_sample(sample(2.0), AUTOPILOT)
    buffer.put_sample(sample(2.2), AUTOPILOT)
    assert buffer.source_component == AUTOPILOT
    assert [s.received_s for s in buffer.since(1.5)] == [2.2]


async def test_waiters_get_the_first_newer_sample() -> None:
    buffer = AttitudeBuffer()
    buffer.put_sample(sample(1.0), AUTOPILOT)
    assert not buffer.is_awaited
    async with asyncio.TaskGroup() as group:
        waiters = [group.create_task(buffer.newer_than(1.0)) for _ in range(3)]
        await asyncio.sleep(0)
        assert not any(waiter.done() for waiter in waiters)
        assert buffer.is_awaited
        feed(buffer, [1.1, 1.2, 1.3])
    assert {waiter.result().received_s for waiter in waiters} == {1.1}
    assert not buffer.is_awaited


async def test_a_report_that_is_not_listened_to_ends_no_waiting() -> None:
    buffer = AttitudeBuffer()
    assert buffer.put_sample(sample(1.0), DEVICE)
    waiter = asyncio.create_task(buffer.newer_than(1.0))
    await asyncio.sleep(0)
    assert not buffer.put_sample(sample(1.1), AUTOPILOT)
    await asyncio.sleep(0)
    assert not waiter.done()
    assert buffer.put_sample(sample(1.2), DEVICE)
    assert (await waiter).received_s == 1.2


async def test_a_sample_that_is_there_needs_no_waiting() -> None:
    buffer = AttitudeBuffer()
    buffer.put_sample(sample(5.0), AUTOPILOT)
    buffer.put_sample(sample(6.0), AUTOPILOT)
    assert (await buffer.newer_than(4.0)).received_s == 5.0


async def test_a_waiter_may_give_up() -> None:
    buffer = AttitudeBuffer()
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await buffer.newer_than(0.0)
    assert not buffer.is_awaited


async def test_a_getter_only_gets_and_a_wait_ingests() -> None:
    coming = [sample(1.0), sample(2.0)]

    def put_in() -> None:
        while coming:
            buffer.put_sample(coming.pop(0), AUTOPILOT)

    buffer = AttitudeBuffer(ingest=put_in)
    assert buffer.latest is None
    assert buffer.since(0.0) == []
    assert buffer.vehicle_attitude_at(sample(1.0)) is None
    assert len(coming) == 2
    buffer.ingest()
    assert buffer.latest == sample(2.0)
    coming.append(sample(3.0))
    assert [s.received_s for s in buffer.since(1.0)] == [2.0]
    assert await buffer.newer_than(2.0) == sample(3.0)
    assert [s.received_s for s in buffer.since(1.0)] == [2.0, 3.0]


def test_a_sample_is_paired_by_boot_time_when_the_autopilot_stamped_both() -> None:
    buffer = AttitudeBuffer()
    buffer.put_sample(sample(50.0, vehicle_s=10.0), AUTOPILOT)
    # arrival says the opposite of the stamps: late on the way, right in time
    for received_s, vehicle_s, yaw_deg in ((49.9, 9.98, 10.0), (49.95, 10.02, 20.0), (50.0, 10.04, 90.0)):
        buffer.put_vehicle(VehicleAttitude(received_s, vehicle_s, turned(yaw_deg)))
    newest = buffer.latest
    assert newest is not None
    assert yaw_of(buffer.vehicle_attitude_at(newest)) == pytest.approx(15.0, abs=1e-3)


def test_a_gimbal_with_a_clock_of_its_own_is_paired_by_arrival() -> None:
    buffer = AttitudeBuffer()
    buffer.put_sample(sample(50.0, vehicle_s=10.0), DEVICE)
    for received_s, vehicle_s, yaw_deg in ((49.98, 3000.0, 10.0), (50.02, 3000.04, 30.0)):
        buffer.put_vehicle(VehicleAttitude(received_s, vehicle_s, turned(yaw_deg)))
    newest = buffer.latest
    assert newest is not None
    assert yaw_of(buffer.vehicle_attitude_at(newest)) == pytest.approx(20.0, abs=0.01)


@pytest.mark.parametrize(
    ("times", "yaw_deg"),
    [
        ((9.95,), 0.0),
        ((10.05,), 0.0),
        ((9.85, 9.95), 1.5),  # continued, by less than the time between the two
        ((9.92, 9.95), 1.0),  # not continued further than that
        ((9.7, 9.95), 1.0),  # nor from two that are far apart
        ((9.8, 10.05), 1.0),
        ((9.95, 10.2), 0.0),
        ((9.85,), None),
        ((10.15,), None),
        ((), None),
    ],
)
def test_too_far_in_time_is_no_pair(times: tuple[float, ...], yaw_deg: float | None) -> None:
    buffer = AttitudeBuffer()
    buffer.put_sample(sample(50.0, vehicle_s=10.0), AUTOPILOT)
    for number, vehicle_s in enumerate(times):
        buffer.put_vehicle(VehicleAttitude(50.0, vehicle_s, turned(float(number))))
    newest = buffer.latest
    assert newest is not None
    found = buffer.vehicle_attitude_at(newest)
    assert (found is None) == (yaw_deg is None)
    if yaw_deg is not None:
        assert yaw_of(found) == pytest.approx(yaw_deg, abs=1e-3)


def test_after_a_reboot_old_stamps_mean_nothing() -> None:
    buffer = AttitudeBuffer()
    buffer.put_vehicle(VehicleAttitude(49.0, 10.0, turned(5.0)))
    buffer.rebooted()
    buffer.put_sample(sample(50.0, vehicle_s=10.0), AUTOPILOT)
    newest = buffer.latest
    assert newest is not None
    assert buffer.vehicle_attitude_at(newest) is None


def test_a_pinned_source_is_the_only_one_for_good() -> None:
    buffer = AttitudeBuffer()
    buffer.put_sample(sample(1.0), AUTOPILOT)
    buffer.pin(DEVICE)
    assert buffer.since(0.0) == [], "the samples of another component are forgotten"
    assert buffer.put_sample(sample(1.1), DEVICE)
    for time_s in (1.2, 5.0, 100.0):
        assert not buffer.put_sample(sample(time_s), AUTOPILOT)
        assert not buffer.put_sample(sample(time_s), 155)
    assert buffer.source_component == DEVICE
    assert [s.received_s for s in buffer.since(0.0)] == [1.1]
