"""What Home Assistant is told: the topics and templates of the vehicle as they really are."""

from __future__ import annotations

import json
import re

from panoexec.mqtt.discovery import discovery_messages
from panoexec.mqtt.messages import State
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.requests import AbortRequest
from panoexec.mqtt.topics import Topics

TOPICS = Topics("site/panoexec", "drone-1")


def test_every_entity_is_of_one_device_and_is_unavailable_when_the_vehicle_is_offline() -> None:
    messages = discovery_messages(TOPICS, "drone-1")
    documents = [json.loads(payload) for _, payload in messages]
    assert [topic for topic, _ in messages] == [
        "homeassistant/sensor/drone-1/panoexec_state/config",
        "homeassistant/sensor/drone-1/panoexec_progress/config",
        "homeassistant/sensor/drone-1/panoexec_battery/config",
        "homeassistant/button/drone-1/panoexec_abort/config",
    ]
    assert len({document["unique_id"] for document in documents}) == 4
    assert {json.dumps(document["device"]) for document in documents} == {json.dumps(documents[0]["device"])}
    assert {document["availability_topic"] for document in documents} == {"site/panoexec/drone-1/status"}
    other = [json.loads(payload) for _, payload in discovery_messages(Topics("panoexec", "drone-1"), "drone-1")]
    assert not {one["unique_id"] for one in other} & {one["unique_id"] for one in documents}


def test_templates_name_fields_that_a_state_has() -> None:
    for _, payload in discovery_messages(TOPICS, "drone-1"):
        for field in re.findall(r"value_json\.(\w+)", payload.decode()):
            assert field in State.model_fields


def test_the_button_sends_a_request_that_is_understood_each_time_with_a_new_transaction() -> None:
    button = json.loads(discovery_messages(TOPICS, "drone-1")[-1][1])
    assert button["command_topic"] == TOPICS.request("abort")
    sent = [button["command_template"].replace("{{ now().timestamp() }}", stamp) for stamp in ("1.5", "2.5")]
    requests = [parse_request("abort", one.encode()) for one in sent]
    assert all(isinstance(one, AbortRequest) for one in requests)
    assert requests[0].transaction != requests[1].transaction
