"""Who sent a request, as its transaction says: `<kind>/<name>/<id>`, for the log and for people, never for permission.

| kind | who |
|---|---|
| `panoexec-cli` | user and computer of a command line |
| `panoexec-web` | login of the operator's page |
| `mavlink` | ids of a MAVLink ground station, or the switches of the transmitter |

Transactions of other programs are free text and name nobody.
"""

from __future__ import annotations

import getpass
import socket
import uuid
from collections.abc import Mapping
from typing import Final

CLI: Final = "panoexec-cli"
WEB: Final = "panoexec-web"
MAVLINK: Final = "mavlink"
_MOST: Final = 60
"""Characters of a name; a transaction may have 128."""


def transaction_of(kind: str, name: str, own: str = "") -> str:
    """A transaction that names its sender.

    Args:
        kind: one of the above.
        name: of the sender; shortened, and without what cannot be printed.
        own: what makes it unique, without a slash; random if not given.
    """
    return f"{kind}/{_clean(name)}/{own or uuid.uuid4().hex}"


def sender_of(transaction: object) -> str:
    """The name in a transaction, "" if there is none."""
    kind, _, rest = str(transaction).partition("/")
    name, slash, own = rest.rpartition("/")
    return _clean(name) if kind in (CLI, WEB, MAVLINK) and slash and own else ""


def received(event: Mapping[str, object]) -> str:
    """An event `command_received` in words: `pause received from anna@laptop: rain`.

    Args:
        event: as published; anything may be in it.
    """
    command, by, reason, shot = (event.get(name) for name in ("command", "by", "reason", "shot"))
    text = _clean(command if isinstance(command, str) else "") or "command"
    text += f" of shot {shot} received" if isinstance(shot, int) else " received"
    name = _clean(by) if isinstance(by, str) else ""
    why = reason if isinstance(reason, str) else ""
    if name:
        text += f" from {name}"
        # the operator's page says who in the reason, too, and MAVLink stations have no other
        why = why.removeprefix(f"by {name}").removeprefix(": ").removeprefix(name)
    return f"{text}: {why}" if why else text


def this_user() -> str:
    """The user of this process and the computer, `anna@laptop`."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # no name for this user id
        user = "somebody"
    return f"{user}@{socket.gethostname()}"


def _clean(name: str) -> str:
    return "".join(char for char in name if char.isprintable())[:_MOST].strip()
