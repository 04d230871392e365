"""The page's server against a real broker: what browsers see, and what their commands do."""

# ruff: noqa: SIM117  (what is open inside of what is easier to see)
from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from panoexec.sim.ports import free_tcp_port
from panoexec.web import sockets
from tests.support.web import MISSION, base, browser, fake_vehicle, web_server
from tests.waiting import eventually
from tests.wire.broker import Broker, needs_mosquitto, running_broker
from tests.wire.broker_proxy import broker_proxy

pytestmark = needs_mosquitto
PLAN = json.loads((Path(__file__).parents[2] / "examples" / "plan.json").read_text(encoding="utf-8"))
JPEG = b"\xff\xd8" + b"x" * 500 + b"\xff\xd9"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with running_broker(tmp_path) as one:
        yield one


def an_event(seq: int, kind: str, **fields: Any) -> dict[str, Any]:
    head = {"type": kind, "id": f"{MISSION}/{seq}", "time": "2026-11-22T07:58:02.000Z", "mission_id": MISSION}
    return head | {"seq": seq, "time_utc_s": 1.0, "clock_s": 1.0, "state": "capturing"} | fields


def without_times(snapshot: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in snapshot.items() if name != "silent_s"}


async def test_a_late_page_and_one_that_was_there_show_the_same(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        async with browser(server, follow="drone") as early:
            assert early.of("hello")[0]["role"] == "operator"
            await vehicle.publish("plan", PLAN, retain=True)
            await vehicle.state(state="capturing", mission_id=MISSION, name="chapel", shots_total=13, shots="d1 c1 t11")
            where = {"shot": 0, "attempt": 1}
            started = {"round": 0, "pitch_deg": -66.7, "yaw_deg": 90.0, "patience_s": 10.0}
            await vehicle.publish("event", an_event(1, "shot_started", **where, **started))
            await vehicle.publish("event", an_event(2, "shot_accepted", **where, photos=[], by="tolerance"))
            await vehicle.publish("event", an_event(2, "shot_accepted", **where, photos=[], by="tolerance"))
            await vehicle.publish(f"thumbnail/{MISSION}/0", JPEG)
            await early.until("thumbnail")
            await early.until("shot", lambda one: one["shot"]["accepted"] == 1)
            assert len([one for one in early.of("event") if one["event"]["kind"] == "shot_accepted"]) == 1
            await early.say(type="follow", vehicle="drone")
            await eventually(lambda: len(early.of("vehicle")) == 2)
            async with browser(server, follow="drone") as late:
                snapshot = late.of("vehicle")[0]
                assert without_times(snapshot) == without_times(early.of("vehicle")[1])
            mission = snapshot["mission"]
            assert (mission["id"], mission["name"], mission["gap"]) == (MISSION, "chapel", False)
            assert snapshot["marks"] == "dc" + 11 * "t"
            assert mission["shots"][0]["accepted"] == 1
            assert len(mission["shots"]) == len(PLAN["shots"])
            async with aiohttp.ClientSession() as session:
                async with session.get(base(server) + mission["shots"][0]["url"]) as picture:
                    assert await picture.read() == JPEG


async def test_the_state_of_a_vehicle_behind_a_slow_link_is_told_whole(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        async with browser(server, follow="drone") as page:
            await vehicle.state(state="capturing", mission_id=MISSION, shots_total=13, shots_done=1, boot_id="b")
            whole = await page.until("state", lambda one: one["state"]["shots_done"] == 1)
            base_seq = whole["state"]["seq"]
            patch = {"shots_done": 2, "seq": base_seq + 1, "mission_id": None}
            for delta in ({"boot_id": "other", "base": base_seq}, {"boot_id": "b", "base": base_seq}):
                await vehicle.publish("state/delta", delta | {"patch": patch | {"reason": delta["boot_id"]}})
            told = await page.until("state", lambda one: one["state"]["shots_done"] == 2)
            assert told["state"] == whole["state"] | patch | {"reason": "b"}


async def test_the_plan_of_the_next_mission_is_not_laid_on_the_last_one(broker: Broker) -> None:
    """The topic does not say whose plan it is; it comes before the first event of its mission, or after it."""
    later = "20261122T085801.864Z"
    other = PLAN | {"shots": PLAN["shots"][:2]}
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        async with browser(server, follow="drone") as page:
            await vehicle.publish("plan", PLAN, retain=True)
            await vehicle.state(state="complete", mission_id=MISSION, shots_total=13, shots="d13")
            await page.until("mission", lambda one: one["mission"]["id"] == MISSION)
            await vehicle.publish("plan", other, retain=True)
            await vehicle.publish("plan", other, retain=True)
            await vehicle.state(state="capturing", mission_id=later, shots_total=2, shots="c1 t1")
            new = await page.until("mission", lambda one: one["mission"]["id"] == later)
            assert len(new["mission"]["shots"]) == 2
            assert all(
                len(one["mission"]["shots"]) != 2 for one in page.of("mission") if one["mission"]["id"] == MISSION
            )
            # the event first, the plan afterwards; before it came an old plan again
            last = "20261122T095801.864Z"
            await vehicle.publish("plan", other, retain=True)
            await vehicle.publish("event", an_event(1, "mission_started", shots_total=13) | {"mission_id": last})
            await vehicle.publish("plan", PLAN, retain=True)
            await page.until(
                "mission",
                lambda one: one["mission"]["id"] == last and len(one["mission"]["shots"]) == len(PLAN["shots"]),
            )


async def test_commands_reach_the_vehicle_once_and_both_operators_see_who_commanded(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        async with (
            browser(server, follow="drone", name="TABLET-1") as one,
            browser(server, follow="drone", name="TABLET-2") as two,
        ):
            answer = await two.command("pause-0001", "pause", reason="wind")
            assert answer["stage"] == "done"
            stages = [told["stage"] for told in two.of("answer")]
            assert stages == ["sent", "received", "done"]
            entry = (await one.until("log", lambda told: told["entry"]["stage"] == "done"))["entry"]
            assert (entry["who"], entry["command"], entry["fields"]) == ("TABLET-2", "pause", {"reason": "wind"})
            assert not one.of("answer")
            # what the journal keeps says who it was
            assert [fields["reason"] for _, fields in vehicle.requests] == ["by TABLET-2: wind"]

            # repeated, as after a lost connection: it does not act again
            again = await two.command("pause-0001", "pause", reason="wind")
            assert again["stage"] == "done"
            assert len(vehicle.requests) == 1
            await two.say(type="command", id="pause-0001", vehicle="drone", command="abort", fields={})
            conflict = await two.until("answer", lambda told: told["command"] == "abort")
            assert conflict["error"]["code"] == "conflict"
            assert len(vehicle.requests) == 1

            refusal = {"code": "refused", "message": "no mission", "field": None}
            vehicle.answer = lambda _command, _fields: {"status": "error", "error": refusal}
            refused = await one.command("skip-00001", "skip", shot=3)
            assert (refused["stage"], refused["error"]) == ("refused", refusal)
            async with browser(server, follow="drone") as late:
                log = late.of("vehicle")[0]["log"]
                assert [(told["who"], told["command"], told["stage"]) for told in log] == [
                    ("TABLET-2", "pause", "done"),
                    ("TABLET-1", "skip", "refused"),
                ]


async def test_planning_can_be_aborted(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        vehicle.answer = lambda command, _fields: None if command == "start" else {"data": {}}
        async with browser(server, follow="drone") as page:
            assert page.of("vehicle")[0]["may"]["abort"]
            await page.say(type="command", id="start-0001", vehicle="drone", command="start", fields={})
            planning = await page.until("state", lambda one: one["may"]["abort"] == "")
            assert planning["may"]["start"] == "a mission is being planned"
            assert (await page.command("abort-0001", "abort"))["stage"] == "done"
            transaction = next(fields["transaction"] for command, fields in vehicle.requests if command == "start")
            refusal = {"code": "refused", "message": "aborted", "field": None}
            answer = {"transaction": transaction, "status": "error", "error": refusal, "data": None}
            page.heard.clear()
            await vehicle.publish("response/start", answer)
            await page.until("state", lambda one: one["may"]["abort"] != "" and one["may"]["start"] == "")


async def test_commands_of_other_ground_stations_and_servers_are_in_the_log(broker: Broker) -> None:
    async with (
        fake_vehicle(broker.port) as vehicle,
        web_server(broker.port) as server,
        web_server(broker.port) as other,
    ):
        async with browser(server, follow="drone") as here, browser(other, follow="drone", name="OFFICE") as there:
            await there.command("finish-001", "finish")
            entry = (await here.until("log"))["entry"]
            assert (entry["who"], entry["command"], entry["stage"]) == ("OFFICE", "finish", "done")
            await vehicle.publish("response/abort", {"transaction": "x1", "status": "ok", "error": None, "data": {}})
            entry = (await here.until("log", lambda told: told["entry"]["command"] == "abort"))["entry"]
            assert entry["who"] == "another ground station"


async def test_a_command_that_cannot_arrive_says_so_at_once(broker: Broker) -> None:
    async with web_server(broker.port) as server, browser(server) as page:
        unknown = await page.command("pause-0001", "pause", vehicle="ghost")
        assert (unknown["stage"], unknown["error"]["code"]) == ("failed", "unknown_vehicle")
        async with fake_vehicle(broker.port) as vehicle:
            await page.until("summaries")
            await vehicle.publish("status", "offline", retain=True)
            await page.until("summaries", lambda one: one["vehicles"][0]["status"] == "offline")
            offline = await page.command("pause-0002", "pause")
            assert offline["error"]["code"] == "offline"
            assert not vehicle.requests
            await page.say(type="follow", vehicle="drone")
            snapshot = await page.until("vehicle")
            assert set(snapshot["may"].values()) == {"the vehicle is offline"}


async def test_the_link_to_the_broker_is_told_and_heals_without_losing_an_event(broker: Broker) -> None:
    async with web_server(broker.port) as server, browser(server, follow="drone", known=False) as page:
        async with fake_vehicle(broker.port) as vehicle:
            await vehicle.publish("event", an_event(1, "preflight_passed"))
            await page.until("event")
        broker.stop(kill=True)
        down = await page.until("link", lambda one: not one["up"])
        assert "no connection to the broker" in down["reason"]
        failed = await page.command("pause-0001", "pause")
        assert failed["error"]["code"] == "no_link"
        page.heard.clear()
        broker.start()
        async with fake_vehicle(broker.port) as vehicle:
            await page.until("link", lambda one: one["up"])
            await vehicle.state(state="paused", mission_id=MISSION, reason="wind")
            await page.until("state", lambda one: one["state"]["state"] == "paused")


async def test_events_wait_in_the_broker_while_the_connection_is_lost(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, broker_proxy(broker.port) as proxy:
        async with web_server(proxy.port) as server, browser(server, follow="drone") as page:
            await vehicle.publish("event", an_event(1, "preflight_passed"))
            await page.until("event")
            proxy.target = free_tcp_port()  # nobody listens there
            for task in list(proxy._tasks):
                task.cancel()
            await page.until("link", lambda one: not one["up"])
            for seq in range(2, 12):
                await vehicle.publish("event", an_event(seq, "warned", code="c", text=f"number {seq}"))
            proxy.target = broker.port
            await page.until("event", lambda one: one["event"]["seq"] == 11)
            assert [one["event"]["seq"] for one in page.of("event")] == list(range(1, 12))
            await page.say(type="follow", vehicle="drone")
            snapshot = await page.until("vehicle", lambda one: one["mission"] is not None)
            assert not snapshot["mission"]["gap"]


async def test_thumbnails_that_were_missed_are_asked_for_once(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        await vehicle.state(state="capturing", mission_id=MISSION, shots_total=4, shots="d1 r1 c1 t1")
        async with browser(server, follow="drone") as page:
            await eventually(lambda: vehicle.requests)
            command, fields = vehicle.requests[0]
            assert (command, fields["mission_id"], fields["shots"]) == ("thumbnails", MISSION, [0, 1])
            await vehicle.publish(f"thumbnail/{MISSION}/1", JPEG)
            assert (await page.until("thumbnail"))["shot"] == 1
            assert not page.of("log")
            for _ in range(3):
                await page.until("beat")
                page.heard.clear()
            assert len(vehicle.requests) == 1


async def test_what_the_broker_kept_does_not_count_as_heard(broker: Broker) -> None:
    async with fake_vehicle(broker.port):
        pass  # gone, with state and status retained
    async with web_server(broker.port) as server, browser(server, follow="drone") as page:
        await page.until("beat")
        assert {one["silent_s"] for one in (*page.of("vehicle"), *page.of("beat"))} == {None}
        async with fake_vehicle(broker.port):
            assert (await page.until("beat", lambda one: one["silent_s"] is not None))["silent_s"] < 5


async def test_a_fleet_is_listed_and_changes_are_told_together(broker: Broker) -> None:
    async with web_server(broker.port) as server, browser(server) as page:
        async with fake_vehicle(broker.port, "one") as one, fake_vehicle(broker.port, "two") as two:
            await page.until("summaries", lambda told: {v["id"] for v in told["vehicles"]} == {"one", "two"})
            before, began_s = len(page.of("summaries")), time.monotonic()
            for seq in range(40):
                await one.state(state="capturing", mission_id=MISSION, shots_total=40, shots_done=seq)
            await page.until("summaries", lambda told: told["vehicles"][0]["state"]["shots_done"] == 39)
            # one each half second: 40 changes are far more, however slow the machine is at them
            assert len(page.of("summaries")) - before <= 2 + (time.monotonic() - began_s) / sockets._LISTS_S
            assert not page.of("state"), "nobody follows a vehicle"
            del two


async def test_hostile_topics_and_payloads_are_ignored(broker: Broker) -> None:
    async with fake_vehicle(broker.port) as vehicle, web_server(broker.port) as server:
        async with browser(server, follow="drone") as page:
            for payload in (
                b"\xff\xfe",
                b"[" * 5000,
                b'{"state": NaN}',
                b"null",
                b"[]",
                b'{"shots": 5, "mission_id": {}}',
            ):
                for topic in ("state", "plan", "event", "response/pause"):
                    await vehicle.publish(topic, payload)
            await vehicle.publish(f"thumbnail/{MISSION}/0", b"GIF89a")
            await vehicle.publish("thumbnail/../../etc/passwd", JPEG)
            await vehicle.publish(f"thumbnail/{MISSION}/999999999", JPEG)
            name = "<script>alert(1)</script>"
            await vehicle.state(state="paused", mission_id=MISSION, name=name, reason="\x00\x1b[31m<b>")
            told = await page.until("mission", lambda one: one["mission"]["id"] == MISSION)
            assert told["mission"]["name"] == name, "text is text: the page never makes markup of it"
            assert not page.of("thumbnail")
