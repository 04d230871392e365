"""Other panoexec on the vehicle, and a mission that is read while another station reads it."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from panoexec.adapters.autopilot_mission import AutopilotMission
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.errors import DeviceError

pytestmark = pytest.mark.asyncio


class Link:
    """The link as far as the mission needs it; `told` are the items of the autopilot, by their numbers."""

    def __init__(self) -> None:
        self.own_ids, self.has_id_conflict, self.autopilot = (1, 191), False, "ardupilot"
        self.components: dict[int, tuple[int, float]] = {}
        self.told = [0, 1, 2]
        self.requests, self.system_id = self, 1
        self._handlers: dict[str, Callable[[MavMessage], None]] = {}

    def on(self, name: str, handler: Callable[[MavMessage], None]) -> Callable[[], None]:
        self._handlers[name] = handler
        return lambda: None

    def when_back(self, _callback: Callable[[], None]) -> Callable[[], None]:
        return lambda: None

    def plugin(self, _kind: type) -> Any:
        return SimpleNamespace(download_mission=None)

    async def mavsdk_call(self, _what: str, _call: Any) -> list[Any]:
        zeros = dict.fromkeys(("command", "frame", "param1", "param2", "param3", "param4", "x", "y", "z"), 0)
        return [SimpleNamespace(seq=seq, **zeros) for seq in self.told]

    async def send(self, _what: str, name: str, fields: dict[str, Any]) -> None:
        """PX4 tells that a marker is done at once, and the new current item at its next turn."""
        assert (name, fields["seq"]) == ("MISSION_SET_CURRENT", 2)
        self._handlers["MISSION_ITEM_REACHED"](MavMessage("MISSION_ITEM_REACHED", 1, {"seq": 2}, 0.0, system_id=1))

    def hear(self, component: int, text: str) -> None:
        self.components[component] = (18, time.monotonic())
        self._handlers["STATUSTEXT"](MavMessage("STATUSTEXT", component, {"text": text}, 0.0, system_id=1))


@pytest.fixture
def link() -> Link:
    return Link()


async def test_the_lowest_component_flies_the_stations_while_it_is_heard(link: Link) -> None:
    async with AutopilotMission(cast("Any", link)) as mission:
        link.hear(192, "Pano: 2 stations in this mission")
        assert mission.claimed == ""
        assert mission.is_to_introduce
        mission.is_to_introduce = False
        link.hear(192, "Pano: 3 stations in this mission")
        assert not mission.is_to_introduce
        link.hear(190, "Pano: 2 stations in this mission")
        assert mission.claimed == "the panoexec of component 190 does it"
        link.components[190] = (18, time.monotonic() - 6.0)
        assert mission.claimed == ""


@pytest.mark.parametrize(
    ("component", "text"),
    [(190, "Pano: complete, 3/3, gimbal released"), (191, "Pano: 2 stations in this mission"), (1, "Pano: 2 stations")],
)
async def test_who_flies_no_stations_claims_none(link: Link, component: int, text: str) -> None:
    async with AutopilotMission(cast("Any", link)) as mission:
        link.hear(component, text)
        assert mission.claimed == ""
        assert not mission.is_to_introduce


async def test_with_the_same_ids_nobody_does_it(link: Link) -> None:
    link.has_id_conflict = True
    assert AutopilotMission(cast("Any", link)).claimed == "another panoexec has this vehicle's MAVLink ids"


@pytest.mark.parametrize("told", [[0, 1, 1, 2], [0, 2], [1, 2]])
async def test_items_that_another_station_asked_for_are_no_mission(link: Link, told: list[int]) -> None:
    mission = AutopilotMission(cast("Any", link))
    assert await mission.read()
    digest, link.told = mission.digest, told
    with pytest.raises(DeviceError, match="another station reads it at the same time"):
        await mission.read()
    assert mission.stale
    assert mission.digest == digest


async def test_px4_goes_on_when_it_tells_that_the_marker_is_done(link: Link) -> None:
    link.autopilot = "px4"
    async with AutopilotMission(cast("Any", link)) as mission:
        mission.reached = 4
        await mission.make_current(2)
        assert mission.reached == 2
        assert mission.current is None
