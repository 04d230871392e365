"""Client ids of the daemon: one for each vehicle, and another one when somebody else uses it."""

from __future__ import annotations

import uuid

from panoexec.mqtt.topics import Topics


def client_id(topics: Topics) -> str:
    """The client id of a vehicle's daemon; different for different base topics.

    A level of the prefix and a vehicle id have no colon, so that `a/b` + `c` and `a` + `b-c` differ.
    """
    return f"panoexec-{topics.base.replace('/', ':')}"


def another_client_id(topics: Topics) -> str:
    """A client id of the same vehicle that nobody can guess."""
    return f"{client_id(topics)}:{uuid.uuid4().hex[:12]}"
