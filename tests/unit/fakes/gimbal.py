"""A gimbal that obeys the protocol of `panoexec.devices` and can misbehave in every way that hardware does."""

from __future__ import annotations

import asyncio
import math
import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from panoexec.angles import wrap_180
from panoexec.clock import Clock
from panoexec.devices import (
    AttitudeSample,
    GimbalKnowledge,
    Quaternion,
    VehicleAttitude,
    YawFrame,
)
from panoexec.errors import DeviceError
from panoexec.planning.model import GimbalLimits

Angles = tuple[float, float, float]
"""Yaw from north, pitch, roll."""


def eased(start: float, end: float, elapsed: float, rate: float, acceleration: float) -> float:
    """Position on a trapezoid of speed from rest to rest."""
    distance, sign = abs(end - start), math.copysign(1.0, end - start)
    ramp = min(rate / acceleration, math.sqrt(distance / acceleration))
    top = acceleration * ramp
    cruise = max(0.0, distance / top - ramp) if top > 0 else 0.0
    t = min(max(elapsed, 0.0), 2 * ramp + cruise)
    if t <= ramp:
        return start + sign * acceleration * t * t / 2
    if t <= ramp + cruise:
        return start + sign * (top * ramp / 2 + top * (t - ramp))
    left = 2 * ramp + cruise - t
    return end - sign * acceleration * left * left / 2


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def quaternion(angles: Angles) -> Quaternion:
    """Of yaw, pitch, roll in 3-1-2 order."""
    yaw, pitch, roll = (math.radians(angle) / 2 for angle in angles)
    about_x = (math.cos(roll), math.sin(roll), 0.0, 0.0)
    about_y = (math.cos(pitch), 0.0, math.sin(pitch), 0.0)
    return product(product((math.cos(yaw), 0.0, 0.0, math.sin(yaw)), about_x), about_y)


class FakeFeed:
    """Samples at a fixed rate, from what the gimbal claims."""

    def __init__(self, *, clock: Clock) -> None:
        self._clock = clock
        self._samples: deque[AttitudeSample] = deque(maxlen=100_000)
        self._arrived = asyncio.Event()
        self.vehicle: deque[VehicleAttitude] = deque(maxlen=100_000)
        self.late_s = 0.0

    def push(self, sample: AttitudeSample) -> None:
        self._samples.append(sample)
        arrived, self._arrived = self._arrived, asyncio.Event()
        arrived.set()

    def ingest(self) -> None:
        """Samples are pushed: nothing waits to be ingested."""

    @property
    def latest(self) -> AttitudeSample | None:
        return self._samples[-1] if self._samples else None

    def since(self, received_s: float) -> Sequence[AttitudeSample]:
        out = []
        for sample in reversed(self._samples):
            if sample.received_s <= received_s:
                break
            out.append(sample)
        return out[::-1]

    async def newer_than(self, received_s: float) -> AttitudeSample:
        while not (newer := self.since(received_s)):
            await self._arrived.wait()
        return newer[0]

    def vehicle_attitude_at(self, sample: AttitudeSample) -> VehicleAttitude | None:
        for vehicle in reversed(self.vehicle):
            if vehicle.received_s <= sample.received_s:
                return vehicle if sample.received_s - vehicle.received_s <= 0.1 else None
        return None


@dataclass
class FakeGimbal:
    """A gimbal with limited rates that reports where it is, or lies about it."""

    clock: Clock
    seed: int = 0
    rate_hz: float = 25.0
    noise_deg: float = 0.005
    frame: YawFrame = YawFrame.EARTH
    tells_rate: bool = True
    limits: GimbalLimits | None = field(default_factory=GimbalLimits)
    ours: bool = False
    # faults
    drift: Callable[[float], Angles] | None = None
    silent: bool = False
    mute: Callable[[float], bool] | None = None
    held_up: Callable[[float], bool] = lambda _: False
    """Whether samples do not arrive at a time, but later, all at once."""
    report_age_s: float = 0.0
    """How old its reports are."""
    frozen: bool = False
    nan: bool = False
    stuck: bool = False
    echoes: bool = False
    """Whether it reports where it was told to look, instead of where it looks."""
    echoes_axis: Literal["", "yaw", "pitch"] = ""
    """The same of one axis, while it measures the other."""
    refusals: int = 0
    refuse_control: int = 0
    failure_flags: int = 0
    release_hangs: bool = False
    vehicle_angles: Angles = (30.0, 4.0, -6.0)
    """Yaw, pitch, roll (3-1-2) of the airframe, for the frames that are relative to it."""
    # what happened
    other: tuple[int, int] = (255, 190)
    """Who has control while we have not; (0, 0): nobody."""
    unknown: bool = False
    """The manager has not said who has control since a link gap; it answers the next time that it is asked."""
    mute_manager: bool = False
    """The manager does not answer the question."""
    asked: int = 0
    acquire_s: float = 0.05
    commands: list[tuple[float, float, float]] = field(default_factory=list)
    nose: Callable[[float], float] | None = None
    """Heading of the vehicle at a time: the camera looks there when told no yaw, and its pan range is about it."""
    known: GimbalKnowledge = field(default_factory=GimbalKnowledge)
    _follows: bool = False
    _under_way: deque[AttitudeSample] = field(default_factory=deque)
    acquired: int = 0
    released: int = 0

    def __post_init__(self) -> None:
        self.feed = FakeFeed(clock=self.clock)
        self._random = random.Random(self.seed)
        self._start: Angles = (0.0, 0.0, 0.0)
        self._end: Angles = (0.0, 0.0, 0.0)
        self._since = -math.inf
        self._last: Quaternion | None = None
        self._airframe_q = quaternion(self.vehicle_angles)

    def _limits(self) -> GimbalLimits:
        return self.limits or GimbalLimits()

    def commanded(self, at_s: float) -> Angles:
        """Where the motors are at a time, without drift."""
        limits, elapsed = self._limits(), at_s - self._since
        yaw = eased(self._start[0], self._end[0], elapsed, limits.yaw_rate_deg_s, limits.yaw_acceleration_deg_s2)
        pitch = eased(self._start[1], self._end[1], elapsed, limits.pitch_rate_deg_s, limits.pitch_acceleration_deg_s2)
        if self.nose is not None and math.isfinite(at_s):
            nose = self.nose(at_s)
            if self._follows or not limits.pans:
                yaw = nose
            elif not limits.yaw_endless:
                yaw = nose + min(max(float(wrap_180(yaw - nose)), limits.yaw_min_deg), limits.yaw_max_deg)
        return yaw, pitch, 0.0

    def _angles(self, at_s: float) -> Angles:
        yaw, pitch, roll = self._end if self.echoes else self.commanded(at_s)
        if self.echoes_axis:
            yaw, pitch = (self._end[0], pitch) if self.echoes_axis == "yaw" else (yaw, self._end[1])
        if self.drift is None:
            return yaw, pitch, roll
        d = self.drift(at_s)
        return yaw + d[0], pitch + d[1], roll + d[2]

    async def stream(self) -> None:
        """Report for ever."""
        while True:
            await self.clock.sleep(1 / self.rate_hz)
            if not self.silent and not (self.mute is not None and self.mute(self.clock.monotonic())):
                self.report()

    def report(self) -> None:
        now = self.clock.monotonic()
        if self._last is None or not self.frozen:
            noise = [self._random.gauss(0, self.noise_deg) for _ in range(3)]
            here = self._angles(now - self.report_age_s)
            self._last = quaternion((here[0] + noise[0], here[1] + noise[1], here[2] + noise[2]))
        w, x, y, z = self._airframe_q
        q = self._last
        if self.frame is YawFrame.BODY:
            q = product((w, -x, -y, -z), q)
        elif self.frame is YawFrame.VEHICLE:
            heading = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
            q = product((math.cos(heading / 2), 0.0, 0.0, -math.sin(heading / 2)), q)
        nan = float("nan")
        step = 1e-3
        speed = math.dist(self._angles(now), self._angles(now - step)) / step
        self.feed.vehicle.append(VehicleAttitude(now, now, self._airframe_q))
        self._under_way.append(
            AttitudeSample(
                received_s=now,
                vehicle_s=now,
                q_wxyz=(nan, nan, nan, nan) if self.nan else q,
                yaw_frame=self.frame,
                rate_deg_s=speed if self.tells_rate else nan,
                failure_flags=self.failure_flags,
            )
        )
        if not self.held_up(now):
            while self._under_way:
                self.feed.push(self._under_way.popleft())

    @property
    def in_control(self) -> bool:
        return self.ours and not self.unknown

    @in_control.setter
    def in_control(self, ours: bool) -> None:
        self.ours, self.unknown = ours, False

    @property
    def controlled_by(self) -> tuple[int, int] | None:
        return None if self.unknown else (1, 191) if self.ours else self.other

    async def ask_control(self) -> None:
        self.asked += 1
        await self.clock.sleep(0.02)
        self.unknown = self.unknown and self.mute_manager

    async def acquire(self) -> None:
        await self.clock.sleep(self.acquire_s)
        if self.refuse_control > 0:
            self.refuse_control -= 1
            raise DeviceError("the gimbal manager refused control")
        self.in_control = True
        self.acquired += 1

    async def release(self) -> None:
        if self.release_hangs:
            await self.clock.sleep(3600.0)
        await self.clock.sleep(0.02)
        self.in_control = False
        self.released += 1

    async def point(self, pitch_deg: float, yaw_deg: float | None) -> None:
        await self.clock.sleep(0.004)
        if self.refusals > 0:
            self.refusals -= 1
            raise DeviceError("the gimbal refused the angles")
        if not self.ours:
            raise DeviceError("gimbal control was lost")
        now = self.clock.monotonic()
        self.commands.append((now, pitch_deg, math.nan if yaw_deg is None else yaw_deg))
        if self.stuck:
            return
        self._start, self._since = self.commanded(now), now
        self._follows = yaw_deg is None
        if yaw_deg is None:
            self._end = (self._start[0], pitch_deg, 0.0)
            return
        self._end = (self._start[0] + float(wrap_180(yaw_deg - self._start[0])), pitch_deg, 0.0)
