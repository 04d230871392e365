"""The AsyncAPI 3.0 document, generated from the payload models by `python -m panoexec.mqtt.spec.asyncapi`.

Writes `asyncapi.yaml` to the given path or to standard output. A test compares the file in the repository to it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from panoexec import __version__
from panoexec.files import write_atomically
from panoexec.mission.log.events import EVENT_TYPES, Event
from panoexec.mqtt.messages import Response, State, StateDelta
from panoexec.mqtt.requests import MAX_PAYLOAD, REQUESTS
from panoexec.mqtt.spec.schemas import answer_schemas, part_schemas, plan_schema, schema_of

_SCHEMAS: Final = "#/components/schemas/"
_MESSAGES: Final = "#/components/messages/"


def document() -> dict[str, Any]:
    """The complete document."""
    schemas: dict[str, Any] = {}
    requests = {command: _model(model, schemas) for command, model in REQUESTS.items()}
    for model in (Response, State, StateDelta):
        _model(model, schemas)
    events = {name: _event(cls) for name, cls in sorted(EVENT_TYPES.items())}
    schemas |= {_camel(name): schema for name, schema in events.items()}
    schemas["Event"] = {"oneOf": [{"$ref": _SCHEMAS + _camel(name)} for name in events]}
    schemas["Status"] = {"type": "string", "enum": ["online", "offline"]}
    schemas |= part_schemas()
    schemas["Plan"] = plan_schema()
    for command, data in answer_schemas().items():
        schemas[_answer(command)] = _answered(schemas["Response"], command, data)
    del schemas["Response"]
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "panoexec",
            "version": __version__,
            "description": "A vehicle that takes panoramas, controlled and monitored over MQTT 3.1.1 or 5.",
        },
        "defaultContentType": "application/json",
        "channels": _channels(requests),
        "operations": _operations(),
        "components": {"messages": _messages(requests), "schemas": dict(sorted(schemas.items()))},
    }


def text() -> str:
    """The document as YAML."""
    head = (
        "# Generated from the payload models by `python -m panoexec.mqtt.spec.asyncapi asyncapi.yaml`: do not edit.\n"
    )
    return head + "\n".join(_yaml(document())) + "\n"


def _channels(requests: dict[str, str]) -> dict[str, Any]:
    channels: dict[str, Any] = {}
    for name, what in (("status", "Status"), ("state", "State"), ("plan", "Plan"), ("event", "Event")):
        channels[name] = _channel(name, {what: {"$ref": _MESSAGES + what}})
    channels["state_delta"] = _channel("state/delta", {"StateDelta": {"$ref": _MESSAGES + "StateDelta"}})
    channels["thumbnail"] = _channel("thumbnail/{mission_id}/{shot}", {"Thumbnail": {"$ref": _MESSAGES + "Thumbnail"}})
    channels["thumbnail"]["parameters"] |= {
        "mission_id": {"description": "id of the mission"},
        "shot": {"description": "index of the shot"},
    }
    for command, model in requests.items():
        channels[f"request_{command}"] = _channel(f"request/{command}", {model: {"$ref": _MESSAGES + model}})
        channels[f"response_{command}"] = _channel(
            f"response/{command}", {_answer(command): {"$ref": _MESSAGES + _answer(command)}}
        )
    return channels


def _channel(topic: str, messages: dict[str, Any]) -> dict[str, Any]:
    return {
        "address": f"{{prefix}}/{{vehicle}}/{topic}",
        "parameters": {
            "prefix": {"description": "[mqtt] prefix", "default": "panoexec"},
            "vehicle": {"description": "[vehicle] id"},
        },
        "messages": messages,
    }


def _operations() -> dict[str, Any]:
    operations: dict[str, Any] = {}
    for name in ("status", "state", "state_delta", "plan", "event"):
        retained = name not in ("event", "state_delta")
        operations[f"publish_{name}"] = {
            "action": "send",
            "channel": {"$ref": f"#/channels/{name}"},
            "bindings": {"mqtt": {"qos": 1, "retain": retained, "bindingVersion": "0.2.0"}},
        }
    operations["publish_thumbnail"] = {
        "action": "send",
        "channel": {"$ref": "#/channels/thumbnail"},
        "bindings": {"mqtt": {"qos": 0, "retain": False, "bindingVersion": "0.2.0"}},
    }
    for command, model in REQUESTS.items():
        operations[command] = {
            "action": "receive",
            "summary": _first_line(model),
            "channel": {"$ref": f"#/channels/request_{command}"},
            "bindings": {"mqtt": {"qos": 1, "retain": False, "bindingVersion": "0.2.0"}},
            "reply": {"channel": {"$ref": f"#/channels/response_{command}"}},
        }
    return operations


def _messages(requests: dict[str, str]) -> dict[str, Any]:
    messages: dict[str, Any] = {}
    for name in ("Status", "State", "StateDelta", "Plan", "Event", *map(_answer, requests)):
        messages[name] = {"name": name, "payload": {"$ref": _SCHEMAS + name}}
    messages["Status"]["contentType"] = "text/plain"
    messages["Thumbnail"] = {
        "name": "Thumbnail",
        "description": "A JPEG of at most 20000 bytes.",
        "contentType": "image/jpeg",
        "payload": {"type": "string", "contentMediaType": "image/jpeg"},
    }
    for model in requests.values():
        messages[model] = {
            "name": model,
            "description": f"At most {MAX_PAYLOAD} bytes.",
            "payload": {"$ref": _SCHEMAS + model},
        }
    return messages


def _model(model: type[BaseModel], schemas: dict[str, Any]) -> str:
    """Add the schemas of a model and of its parts; returns its name."""
    schema = model.model_json_schema(ref_template=_SCHEMAS + "{model}")
    for name, part in schema.pop("$defs", {}).items():
        schemas[name] = _plain(part)
    schema["description"] = _first_line(model)
    schemas[model.__name__] = _plain(schema)
    return model.__name__


def _plain(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema without titles, and with only the first line of its description."""
    out = {key: value for key, value in schema.items() if key != "title"}
    if "description" in out:
        out["description"] = str(out["description"]).partition("\n")[0]
    if "properties" in out:
        out["properties"] = {
            name: {key: value for key, value in part.items() if key != "title"}
            for name, part in out["properties"].items()
        }
    return out


def _event(cls: type[Event]) -> dict[str, Any]:
    """The schema of what `Event.to_json` writes."""
    head = {
        "type": {"const": cls.type},
        "id": {"type": "string", "description": "mission_id/seq; identical for repeated messages"},
        "time": {"type": "string", "format": "date-time"},
    }
    schema = schema_of(cls)
    return {
        "type": "object",
        "description": _first_line(cls),
        "properties": head | schema["properties"],
        "required": [*head, *schema["required"]],
    }


def _first_line(cls: type) -> str:
    return (cls.__doc__ or "").strip().partition("\n")[0]


def _answer(command: str) -> str:
    return _words(command) + "Response"


def _answered(response: dict[str, Any], command: str, data: dict[str, Any]) -> dict[str, Any]:
    """The response schema of a command: `data` if it was executed, `error` if not."""
    properties = response["properties"] | {"data": {"anyOf": [data, {"type": "null"}]}}
    return response | {"description": f"The response to `{command}`.", "properties": properties}


def _camel(name: str) -> str:
    return _words(name) + "Event"


def _words(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def _yaml(value: Any, indent: int = 0) -> list[str]:
    """Block style; every scalar is written as JSON, which is valid YAML."""
    pad = "  " * indent
    lines = []
    items = value.items() if isinstance(value, dict) else ((None, item) for item in value)
    for key, item in items:
        head = f"{pad}- " if key is None else f"{pad}{_key(key)}:"
        if isinstance(item, dict | list | tuple) and item:
            inner = _yaml(item, indent + 1)
            if key is None:
                lines += [head + inner[0].lstrip(), *inner[1:]]
            else:
                lines += [head, *inner]
        else:
            lines.append(f"{head.rstrip()} {json.dumps(item, ensure_ascii=False)}")
    return lines


def _key(key: str) -> str:
    return key if key.replace("_", "").isalnum() and not key[0].isdigit() else json.dumps(key)


def main(arguments: list[str]) -> None:
    """Write the document."""
    if arguments:
        write_atomically(Path(arguments[0]), text())
    else:
        sys.stdout.write(text())


if __name__ == "__main__":
    main(sys.argv[1:])
