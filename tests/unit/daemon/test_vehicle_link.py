"""What the daemon says of its vehicle while there is none."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any, cast

import pytest

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.daemon import vehicle_link
from panoexec.daemon.errors import VehicleNotReadyError
from panoexec.daemon.live_config import _RELOADABLE
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.errors import DeviceError
from panoexec.inputs.config import Config
from panoexec.store.session import Devices
from tests.repository import ROOT
from tests.waiting import eventually

GROUND_STATION = (ROOT / "docs" / "ground-station.md").read_text(encoding="utf-8")


def test_tells_what_it_lost_after_all_had_been_found() -> None:
    config = Config.model_validate({"vehicle": {"connection": "udpin://127.0.0.1:14540"}})
    vehicle = VehicleLink(lambda: config, clock=SystemClock())
    assert vehicle.lacking == "not connected yet"
    vehicle.reason = ""  # all were found, and nothing is heard any more
    assert vehicle.lacking == "lost: autopilot, gimbal, camera"
    assert not any(link.ok for link in (vehicle.links().autopilot, vehicle.links().gimbal, vehicle.links().camera))


def test_a_vehicle_that_may_be_another_one_is_not_ready() -> None:
    config = Config.model_validate({"vehicle": {"connection": "udpin://127.0.0.1:14540"}})
    vehicle = VehicleLink(lambda: config, clock=SystemClock())
    told = "several vehicles are on this link: set [vehicle] system_id"
    link = SimpleNamespace(heartbeat_age_s=0.1, connected=True, identity=SimpleNamespace(problem=told))
    vehicle._link = cast("MavsdkLink", link)
    vehicle.devices, vehicle.reason = cast("Devices", object()), ""
    with pytest.raises(VehicleNotReadyError, match=r"not certain: several vehicles .* \[vehicle\] system_id"):
        vehicle.ready_devices()
    assert told in vehicle.lacking
    link.identity.problem = ""
    assert vehicle.ready_devices() is vehicle.devices


def configured(**camera: Any) -> Config:
    return Config.model_validate({"vehicle": {"connection": "udpin://127.0.0.1:14540"}, "camera": camera})


async def test_devices_that_are_configured_anew_are_opened_anew_when_no_mission_needs_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def nothing(*_: object, **__: object) -> None: ...

    opened: list[int | None] = []

    async def discover(_patience_s: float) -> None:
        if opened[-1] == 1:
            await asyncio.sleep(0.01)
            raise DeviceError("there is no camera 1")

    @asynccontextmanager
    async def a_link(*_: object, **__: object) -> AsyncIterator[Any]:
        identity = SimpleNamespace(problem="")
        link = SimpleNamespace(
            heartbeat_age_s=0.1, connected=True, identity=identity, wait_autopilot=nothing, use_rates=nothing
        )
        gimbal = SimpleNamespace(age_s=0.1, feed=SimpleNamespace(ingest=lambda: None), discover=nothing)
        yield SimpleNamespace(link=link, gimbal=gimbal, vehicle=SimpleNamespace(status=None))

    @asynccontextmanager
    async def a_camera(section: Any, *_: object, **__: object) -> AsyncIterator[Any]:
        opened.append(section.component)
        yield SimpleNamespace(age_s=0.1, is_present=True, discover=discover)

    monkeypatch.setattr(vehicle_link, "linked_vehicle", a_link)
    monkeypatch.setattr(vehicle_link, "open_camera", a_camera)
    monkeypatch.setattr(vehicle_link, "_LOOK_S", 0.01)
    monkeypatch.setattr(vehicle_link, "_BACKOFF_S", 0.01)
    now, flies = [configured(component=1)], [False]
    vehicle = VehicleLink(lambda: now[0], clock=SystemClock(), in_use=lambda: flies[0])
    running = asyncio.create_task(vehicle.run(), name="vehicle")
    try:
        await eventually(lambda: "no camera 1" in vehicle.reason)
        now[0] = configured(component=100)
        await eventually(lambda: vehicle.devices is not None)
        flies[0] = True
        now[0] = configured(component=101)
        for _ in range(20):
            await asyncio.sleep(0.01)
            assert vehicle.devices is not None, "a mission has them"
        flies[0] = False
        await eventually(lambda: opened[-1] == 101 and vehicle.devices is not None)
        assert opened == [1, 100, 101]
        assert vehicle.reason == ""
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def test_what_a_reload_takes_over_is_documented() -> None:
    (row,) = [line for line in GROUND_STATION.splitlines() if line.startswith("| SIGHUP |")]
    assert {name.strip("[]") for name in re.findall(r"`(\[\w+\])`", row)} == set(_RELOADABLE)
