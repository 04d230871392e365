"""The topics of one vehicle (docs/contract.md), and where somebody may have an answer sent."""

from __future__ import annotations

from typing import Final

_LONGEST: Final = 512
_DEEPEST: Final = 32
"""Levels; mosquitto ends the connection at more than 200."""


class Topics:
    """The topics of one vehicle."""

    def __init__(self, prefix: str, vehicle: str) -> None:
        self.base = f"{prefix}/{vehicle}"
        self.status = f"{self.base}/status"
        self.state = f"{self.base}/state"
        self.plan = f"{self.base}/plan"
        self.event = f"{self.base}/event"
        self.requests = f"{self.base}/request/#"

    def request(self, command: str) -> str:
        """Where a command is asked for."""
        return f"{self.base}/request/{command}"

    def response(self, command: str) -> str:
        """Where it is answered."""
        return f"{self.base}/response/{command}"

    def may_answer_at(self, topic: str) -> bool:
        """Whether a requester may choose this topic for an answer: below ours, and none that means something else."""
        if not topic.startswith(f"{self.base}/") or any(char in topic for char in "+#") or not topic.isprintable():
            return False
        # a topic that a broker does not bear would cost us the connection, each time anew
        if len(topic.encode()) > _LONGEST or topic.count("/") >= _DEEPEST:
            return False
        first = topic.removeprefix(f"{self.base}/").partition("/")[0]
        return first not in {"status", "state", "plan", "event", "request", ""}


def is_topic_part(text: str) -> bool:
    """Whether it may stand between two slashes of a topic of ours."""
    return 0 < len(text) <= 64 and text.replace("_", "").replace("-", "").isalnum() and text.isascii()
