"""The messages between server and browser: JSON objects in text frames of one WebSocket (`/socket`).

Each has a `type`. Angles, times and names are those of docs/contract.md. A key that a side does not know is ignored.

Server to browser:

========== ===========================================================================================================
`hello`     first message: `protocol`, `version` of panoexec, `user` (login name, or ""), `name` (of this browser in
            the log), `role` (`operator` or `viewer`), `login` (whether there is one to log out of), `missions`
            (whether this server has a storage), `stitch` ("" or why nothing can be stitched here), `cameras` (as
            `panoexec cameras --json` lists them, may come later in a message `cameras`), `time`
`cameras`   `cameras`: list of profiles
`link`      `up`, `since` (ISO 8601), `reason`: the connection between this server and the broker
`vehicles`  `vehicles`: all vehicles of the broker (after `hello`, again after each connection to the broker)
`summaries` `vehicles`: those that changed, at most twice a second
`vehicle`   answer to `follow`: everything about one vehicle: `vehicle` (its id), `status`, `state`, `may`, `mission`
            (see below, or null), `log` (list of entries), `silent_s`. Replaces what the page had
`status`    `vehicle`, `status`: `online`, `offline`, or "" while unknown
`state`     `vehicle`, `state` (the payload of the topic `state`), `may`, `marks`
`mission`   `vehicle`, `mission`: replaces the mission as a whole (a plan, a new mission, added shots)
`shot`      `vehicle`, `mission_id`, `shot`: replaces one shot
`content`   `vehicle`, `mission_id`, `content`
`event`     `vehicle`, `mission_id`, `event`: one line of what happened
`thumbnail` `vehicle`, `mission_id`, `shot`, `url`
`log`       `vehicle`, `entry`: replaces the entry of the same `id`, or is new: who commanded what
`answer`    to the browser that asked: `id`, `stage`, `command`, `vehicle`, `error`, `data`
`stitch`    `mission_id`, `stage` (`running`, `done`, `failed`), `text` (last line of progress), `who`
`library`   the list of missions has changed: read `/api/missions` again
`beat`      once a second: `time`, `silent_s` (seconds since the followed vehicle was heard, or null). A page that has
            heard nothing for 3 s has lost the server
`problem`   `text`: the browser's last message was refused
========== ===========================================================================================================

A *summary* of a vehicle: `id`, `status`, `state` (payload of the topic, or null), `silent_s` (seconds since it was
heard, null if only what the broker kept is known).

`may`: for each command "" if it can be sent now, else the reason why not, in words.

`marks`: `state.shots` unfolded, one letter a shot in the order of the indices (d, r, c, a, m, t:
docs/ground-station.md).

A *mission*: `id` (null while only a plan is known), `name`, `camera` (`name`, `half_width` and `half_height` as
tangents, `hfov_deg`, `vfov_deg`, `image_px`), `tolerance_deg` (`pitch`, `roll`, `yaw`), `band` (`elevation`, `azimuth`,
`masks` as in a report), `certificate` and `estimate` of the plan, `notes`, `shots`, `content`, `events` (newest last,
the last `EVENT_LINES`), `gap` (whether this server was connected too late, or too seldom, to have heard all events).
Without a plan `camera`, `tolerance_deg` and `band` are null, and shots have a `target` of null until they are begun.

A *shot* has the form of the report's: `i`, `row` (-1 unknown), `patch`, `target` `[pitch, yaw]`, `q` (of the target,
`[w, x, y, z]`), `accepted` (number of the attempt that counts, or null), `reason`, `url` (of its thumbnail, or null)
and `attempts`, each with `n`, `verdict` (`open`, `accepted`, `rejected`, `interrupted`), `by`, `code`, `reason`,
`error` (`[pitch, roll, yaw]` or null), `q` and `pose` (`[pitch, roll, yaw]`) as measured or null, `evidence`,
`samples`, `file`, `time`, and `content` (null, or `verdict`, `reason`, `sharpness`, `ties` of `shot`, `points`,
`angle_deg`).

`content` of a mission: null, or `edges` and `bridges` (lists of pairs of shots), `groups`, `geometry_only`, `bad`,
`unchecked` (lists of shots).

An *event*: `seq`, `time`, `kind` (its type), `level` (`info`, `good`, `warning`, `bad`), `text`, `shot`, `attempt`,
`code` (of a pause: the guard that holds; "" for none).

An *entry* of the log: `id`, `time`, `who`, `vehicle`, `command`, `fields` (without a plan), `stage`, `error`. `stage`
is `sent` (on its way to the broker), `received` (the broker has it), `done`, `refused` (the vehicle said why not),
`failed` (not sent, or no answer). `error` is null or has `code`, `message` and `field`.

Browser to server:

========== ===========================================================================================================
`follow`    `vehicle`: an id, or null for the list of all. Answered by `vehicle`, or `vehicles`
`name`      `name`: how the log calls this browser where nobody logs in (at most 40 characters)
`command`   `id` (chosen by the browser, 8 to 64 of A-Z a-z 0-9 - _, never used for another one), `vehicle`, `command`,
            `fields`: a request of docs/ground-station.md (`plan` and `start` among them). The same `id` again never
            acts twice, and is answered with its present stage
`stitch`    `mission_id`: stitch a mission of this server's storage
========== ===========================================================================================================

HTTP: `/` and `/v/ID` (the page), `/assets/NAME`, `/socket`, `/login` (page, and POST of `name` and `password` as a
form), `/logout` (POST), `/thumbnails/VEHICLE/MISSION/SHOT` (JPEG), `/api/missions` (JSON), `/missions/ID/report`,
`/missions/ID/images/NAME`, `/missions/ID/download` (zip, resumable by Range), `/missions/ID/panorama` (the stitched
file), `/missions/ID/preview` (JPEG for the list), DELETE `/missions/ID` with the header `X-Confirm: ID`.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from panoexec.errors import UsageError

PROTOCOL: Final = 1
EVENT_LINES: Final = 300
MAX_FRAME: Final = 80 * 1024
"""Largest message of a browser, bytes: a request of 64 KiB and what is around it."""

COMMANDS: Final = (
    *("plan", "start", "pause", "resume", "abort", "finish", "skip", "repeat"),
    *("get", "doctor", "missions", "presets", "thumbnails", "set_profile"),
)
VIEWER_COMMANDS: Final = frozenset({"get", "missions", "plan", "presets", "thumbnails"})
"""What does not act on the vehicle; all others need the role `operator`."""

Stage: TypeAlias = Literal["sent", "received", "done", "refused", "failed"]

_COMMAND_ID = re.compile(r"[A-Za-z0-9_-]{8,64}")
_VEHICLE = re.compile(r"[A-Za-z0-9_-]{1,64}")
_MISSION = re.compile(r"\d{8}T\d{6}\.\d{3}Z")
_DEEPEST: Final = 24


class RefusedMessageError(UsageError):
    """A message of a browser that makes no sense."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Follow:
    """`follow`."""

    vehicle: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Name:
    """`name`."""

    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """`command`."""

    id: str
    vehicle: str
    command: str
    fields: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stitch:
    """`stitch`."""

    mission_id: str


FromBrowser: TypeAlias = Follow | Name | Command | Stitch


def is_vehicle(text: object) -> bool:
    """Whether the text can be the id of a vehicle."""
    return isinstance(text, str) and _VEHICLE.fullmatch(text) is not None


def is_mission(text: object) -> bool:
    """Whether the text has the form of a mission id."""
    return isinstance(text, str) and _MISSION.fullmatch(text) is not None


def clean_name(text: str) -> str:
    """A name for the log: printable, one line, at most 40 characters."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())[:40]


def from_browser(text: str) -> FromBrowser:
    """Read a message of a browser.

    Raises:
        RefusedMessageError: it makes no sense; the text says why.
    """
    try:
        message = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise RefusedMessageError("not a JSON object") from error
    if not isinstance(message, dict):
        raise RefusedMessageError("not a JSON object")
    kind = message.get("type")
    if kind == "follow":
        vehicle = message.get("vehicle")
        if vehicle is not None and not is_vehicle(vehicle):
            raise RefusedMessageError("vehicle: must be the id of a vehicle, or null")
        return Follow(vehicle=vehicle)
    if kind == "name":
        name = message.get("name")
        if not isinstance(name, str):
            raise RefusedMessageError("name: must be a text")
        return Name(name=clean_name(name))
    if kind == "command":
        return _command(message)
    if kind == "stitch":
        if not is_mission(message.get("mission_id")):
            raise RefusedMessageError("mission_id: must be the id of a mission")
        return Stitch(mission_id=message["mission_id"])
    raise RefusedMessageError("type: must be follow, name, command or stitch")


def _command(message: dict[str, Any]) -> Command:
    one, vehicle, command, fields = (message.get(key) for key in ("id", "vehicle", "command", "fields"))
    if not isinstance(one, str) or not _COMMAND_ID.fullmatch(one):
        raise RefusedMessageError("id: must be 8 to 64 of A-Z a-z 0-9 - _")
    if not isinstance(vehicle, str) or not is_vehicle(vehicle):
        raise RefusedMessageError("vehicle: must be the id of a vehicle")
    if command not in COMMANDS:
        raise RefusedMessageError(f"command: must be one of {', '.join(COMMANDS)}")
    if fields is None:
        fields = {}
    if not isinstance(fields, dict) or "transaction" in fields:
        raise RefusedMessageError("fields: must be an object without a transaction")
    if _depth(fields) > _DEEPEST:
        raise RefusedMessageError("fields: nested too deeply")
    return Command(id=one, vehicle=vehicle, command=str(command), fields=fields)


def _depth(value: object) -> int:
    depth, level = 0, [value]
    while level and depth <= _DEEPEST:
        depth += 1
        inner = [one for one in level if isinstance(one, dict | list)]
        level = [item for one in inner for item in (one.values() if isinstance(one, dict) else one)]
    return depth


def _no_constant(name: str) -> object:
    raise ValueError(f"{name} is not JSON")


def encode(kind: str, **fields: Any) -> str:
    """A message to a browser, in ASCII: half of a surrogate pair, which JSON may have, is no UTF-8."""
    return json.dumps({"type": kind, **fields}, separators=(",", ":"))
