"""What Home Assistant needs to find a vehicle by itself (MQTT discovery): status, progress, battery, and abort.

Each message is retained at `homeassistant/<component>/<vehicle>/<object>/config`
(https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery).
"""

from __future__ import annotations

from typing import Any, Final

from panoexec import __version__
from panoexec.mqtt.messages import dump_json
from panoexec.mqtt.topics import Topics

ROOT: Final = "homeassistant"

_TRANSACTION: Final = "homeassistant/{{ now().timestamp() }}"
"""A new one for each press: the same transaction would act once only."""


def discovery_messages(topics: Topics, vehicle: str) -> list[tuple[str, bytes]]:
    """The messages to be retained.

    Args:
        topics: of the vehicle.
        vehicle: its id.

    Returns:
        Topic and payload of each.
    """
    unique = topics.base.replace("/", "_")
    common: dict[str, Any] = {
        "availability_topic": topics.status,
        "payload_available": "online",
        "payload_not_available": "offline",
        "qos": 1,
        "device": {
            "identifiers": [unique],
            "name": f"panoexec {vehicle}",
            "manufacturer": "panoexec",
            "model": "panorama by multirotor",
            "sw_version": __version__,
        },
        "origin": {"name": "panoexec", "sw_version": __version__},
    }
    done = "(100 * value_json.shots_done / value_json.shots_total) | round(0) if value_json.shots_total else 0"
    entities: dict[tuple[str, str], dict[str, Any]] = {
        ("sensor", "state"): {
            "name": "Mission",
            "icon": "mdi:panorama-sphere",
            "state_topic": topics.state,
            "value_template": "{{ value_json.state }}",
            "json_attributes_topic": topics.state,
            "json_attributes_template": (
                "{{ {'name': value_json.name, 'reason': value_json.reason, 'mission_id': value_json.mission_id,"
                " 'shots_done': value_json.shots_done, 'shots_total': value_json.shots_total,"
                " 'retakes': value_json.retakes, 'eta_s': value_json.eta_s} | tojson }}"
            ),
        },
        ("sensor", "progress"): {
            "name": "Progress",
            "icon": "mdi:progress-check",
            "state_topic": topics.state,
            "value_template": f"{{{{ {done} }}}}",
            "unit_of_measurement": "%",
        },
        ("sensor", "battery"): {
            "name": "Battery",
            "device_class": "battery",
            "state_class": "measurement",
            "state_topic": topics.state,
            "value_template": (
                "{{ (100 * value_json.battery_frac) | round(0) if value_json.battery_frac is not none else None }}"
            ),
            "unit_of_measurement": "%",
        },
        ("button", "abort"): {
            "name": "Abort the mission",
            "icon": "mdi:stop-circle",
            "command_topic": topics.request("abort"),
            "command_template": f'{{"transaction": "{_TRANSACTION}", "reason": "by Home Assistant"}}',
            "retain": False,
        },
    }
    return [
        (
            f"{ROOT}/{component}/{vehicle}/panoexec_{name}/config",
            dump_json(fields | {"unique_id": f"{unique}_{name}"} | common),
        )
        for (component, name), fields in entities.items()
    ]
