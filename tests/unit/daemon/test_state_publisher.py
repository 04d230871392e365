"""What the daemon publishes of its missions."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from panoexec.daemon.state_publisher import StatePublisher
from panoexec.mqtt.topics import Topics
from tests.unit.fakes.world import a_plan


class Published:
    """An MQTT link that keeps what is published."""

    twin = False

    def __init__(self) -> None:
        self.topics = Topics(prefix="panoexec", vehicle="drone")
        self.sent: list[tuple[str, bytes]] = []

    def publish(self, topic: str, payload: bytes, **_more: Any) -> None:
        self.sent.append((topic, payload))


def test_a_mission_with_the_plan_of_the_one_before_publishes_it_too() -> None:
    mqtt = Published()
    missions = SimpleNamespace(plan=None, record=None)
    unused: Any = None
    publisher = StatePublisher(
        boot_id="b",
        missions=cast("Any", missions),
        vehicle=unused,
        marks=unused,
        storage_trouble=lambda: "",
        mqtt=cast("Any", mqtt),
        notifier=unused,
        changed=unused,
    )
    publisher.publish_plan()
    missions.plan, missions.record = a_plan(4), SimpleNamespace(mission_id="20261130T100000.000Z")
    publisher.publish_plan()
    publisher.publish_plan()
    assert len(mqtt.sent) == 2
    missions.record = SimpleNamespace(mission_id="20261130T110000.000Z")
    publisher.publish_plan()
    publisher.publish_plan()
    assert len(mqtt.sent) == 3
    assert mqtt.sent[1] == mqtt.sent[2]
    assert mqtt.sent[2][0] == "panoexec/drone/plan"
