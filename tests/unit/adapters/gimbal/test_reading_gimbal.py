"""Reading a gimbal's newest attitude, or its age, does not ingest messages."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import Handler, MavMessage


class FakeLink:
    """A link on which a test sends what it likes; nothing that is posted runs."""

    def __init__(self) -> None:
        self.handlers: dict[str, Handler] = {}
        self.streams = SimpleNamespace(throttled={})
        self.components: dict[int, tuple[int, float]] = {}

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        self.handlers[name] = handler
        return lambda: None

    def when_attached(self, _callback: Callable[[], None]) -> Callable[[], None]:
        return lambda: None

    when_back = when_attached

    def post(self, callback: Callable[..., None], *args: object) -> None: ...

    def send(self, time_s: float) -> None:
        fields = {
            "time_boot_ms": round(1000 * time_s),
            "flags": 64,
            "q": [1.0, 0.0, 0.0, 0.0],
            "angular_velocity_x": 0.0,
            "angular_velocity_y": 0.0,
            "angular_velocity_z": 0.0,
            "failure_flags": 0,
            "gimbal_device_id": 0,
        }
        self.handlers["GIMBAL_DEVICE_ATTITUDE_STATUS"](MavMessage("GIMBAL_DEVICE_ATTITUDE_STATUS", 1, fields, time_s))


async def test_what_arrived_counts_for_the_age_and_is_read_only_once_it_is_ingested() -> None:
    link = FakeLink()
    async with MavsdkGimbal(cast("MavsdkLink", link)) as gimbal:
        assert gimbal.age_s == float("inf")
        link.send(1.0)
        link.send(1.02)
        assert gimbal.age_s < 5.0
        assert gimbal.feed.latest is None
        assert gimbal.feed.since(0.0) == []
        gimbal.feed.ingest()
        latest = gimbal.feed.latest
        assert latest is not None
        assert latest.vehicle_s == 1.02
        assert len(gimbal.feed.since(0.0)) == 2
        assert gimbal.age_s < 5.0
