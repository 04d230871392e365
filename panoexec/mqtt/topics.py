"""The topics of one vehicle (docs/contract.md), and the rule for response topics."""

from __future__ import annotations

from typing import Final

COMMANDS: Final = (
    *("plan", "start", "pause", "resume", "abort", "finish", "skip", "repeat"),
    *("get", "doctor", "missions", "presets", "thumbnails", "set_profile"),
)
"""The commands; `panoexec.mqtt.requests.REQUESTS` has the model of each."""

_LONGEST: Final = 512
_DEEPEST: Final = 32
"""Maximum number of levels; mosquitto closes the connection at more than 200."""


class Topics:
    """The topics of one vehicle."""

    def __init__(self, prefix: str, vehicle: str) -> None:
        self.base = f"{prefix}/{vehicle}"
        self.status = f"{self.base}/status"
        self.state = f"{self.base}/state"
        self.state_delta = f"{self.state}/delta"
        self.plan = f"{self.base}/plan"
        self.event = f"{self.base}/event"
        self.requests = f"{self.base}/request/#"

    def request(self, command: str) -> str:
        """The request topic of a command."""
        return f"{self.base}/request/{command}"

    def response(self, command: str) -> str:
        """The response topic of a command."""
        return f"{self.base}/response/{command}"

    def thumbnail(self, mission_id: str, shot: int | str) -> str:
        """The topic of the thumbnail of a shot."""
        return f"{self.base}/thumbnail/{mission_id}/{shot}"

    def may_answer_at(self, topic: str) -> bool:
        """Whether a response may be sent to this topic: below the base topic and not used for anything else."""
        if not topic.startswith(f"{self.base}/") or any(char in topic for char in "+#") or not topic.isprintable():
            return False
        # a broker closes the connection at a topic that it rejects, and would do so again after each reconnection
        if len(topic.encode()) > _LONGEST or topic.count("/") >= _DEEPEST:
            return False
        first = topic.removeprefix(f"{self.base}/").partition("/")[0]
        return first not in {"status", "state", "plan", "event", "request", "thumbnail", ""}


def is_topic_part(text: str) -> bool:
    """Whether the text is a valid topic level."""
    return 0 < len(text) <= 64 and text.replace("_", "").replace("-", "").isalnum() and text.isascii()
