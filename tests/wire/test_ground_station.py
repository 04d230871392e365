"""Requests to a vehicle that the broker does not know (yet)."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import aiomqtt
import pytest

from panoexec.errors import LinkError
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.ground_station import GroundStation
from tests.wire.broker import needs_mosquitto, running_broker


@needs_mosquitto
async def test_a_request_reaches_a_vehicle_that_comes_after_it(tmp_path: Path) -> None:
    silent = asyncio.Event()
    with running_broker(tmp_path) as broker:
        async with GroundStation(MqttSection(host="127.0.0.1", port=broker.port)) as station:
            asking = asyncio.create_task(
                station.request("kite", "get", {"transaction": "t"}, timeout_s=60, on_silence=silent.set)
            )
            async with asyncio.timeout(60):
                await silent.wait()
            async with aiomqtt.Client("127.0.0.1", broker.port) as kite:
                await kite.subscribe("panoexec/kite/request/#", qos=1)
                await kite.publish("panoexec/kite/status", "online", qos=1, retain=True)
                async with asyncio.timeout(60):
                    message = await anext(kite.messages)
                assert isinstance(message.payload, bytes)
                assert json.loads(message.payload) == {"transaction": "t"}
                answer = {"transaction": "t", "status": "ok"}
                await kite.publish("panoexec/kite/response/get", json.dumps(answer), qos=1)
                assert await asking == answer


@needs_mosquitto
async def test_a_request_reaches_a_vehicle_that_comes_while_others_are_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.ground_station._OTHERS_S", 20.0)
    with running_broker(tmp_path) as broker:
        section = MqttSection(host="127.0.0.1", port=broker.port)
        async with GroundStation(section) as station, aiomqtt.Client("127.0.0.1", broker.port) as kite:
            await kite.subscribe("panoexec/kite/request/#", qos=1)
            asking = asyncio.create_task(station.request("kite", "get", {"transaction": "t"}, timeout_s=60))
            async with asyncio.timeout(60):
                await anext(kite.messages)  # as if it had been lost
                await kite.publish("panoexec/kite/status", "online", qos=1, retain=True)
                message = await anext(kite.messages)
            assert isinstance(message.payload, bytes)
            assert json.loads(message.payload) == {"transaction": "t"}
            await kite.publish("panoexec/kite/response/get", json.dumps({"transaction": "t", "status": "ok"}), qos=1)
            assert (await asking)["status"] == "ok"


@needs_mosquitto
async def test_a_vehicle_that_is_hidden_may_have_received_what_was_sent(tmp_path: Path) -> None:
    with running_broker(tmp_path) as broker:
        section = MqttSection(host="127.0.0.1", port=broker.port)
        async with GroundStation(section) as station, aiomqtt.Client("127.0.0.1", broker.port) as kite:
            await kite.publish("panoexec/owl/status", "online", qos=1, retain=True)
            # as if an access list kept its status from the station
            await kite.subscribe("panoexec/kite/request/#", qos=1)
            told = r"no vehicle kite .*: there are owl\. The request was sent: .* received it"
            with pytest.raises(LinkError, match=told):
                await station.request("kite", "abort", {"transaction": "t"}, timeout_s=60)
            async with asyncio.timeout(60):
                message = await anext(kite.messages)
            assert str(message.topic) == "panoexec/kite/request/abort"
