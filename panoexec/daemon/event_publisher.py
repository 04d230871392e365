"""The events of the mission, on their way to the log and to MQTT."""

from __future__ import annotations

from collections.abc import Callable

import structlog

from panoexec.mission.log.events import Event
from panoexec.mission.log.shot_marks import ShotMarks
from panoexec.mqtt.link import MqttLink
from panoexec.mqtt.messages import dump_json

_log = structlog.get_logger(__name__)


class EventPublisher:
    """Implements `EventSink`.

    Attributes:
        marks: the state of each shot, as of the last event.
    """

    def __init__(
        self, *, mqtt: MqttLink | None, changed: Callable[[], None], beside: Callable[[Event], None] = lambda _: None
    ) -> None:
        """Describe it.

        Args:
            mqtt: where events are published; None without a broker.
            changed: called after each event.
            beside: also gets each event.
        """
        self.marks = ShotMarks()
        self._mqtt = mqtt
        self._changed = changed
        self._beside = beside

    def publish(self, event: Event) -> None:
        """See `EventSink.publish`."""
        self.marks.note(event)
        where = {name: value for name in ("shot", "attempt") if (value := getattr(event, name, None)) is not None}
        _log.info(event.type, seq=event.seq, mission_id=event.mission_id, state=event.state.value, **where)
        if self._mqtt is not None:
            self._mqtt.publish(self._mqtt.topics.event, dump_json(event.to_json()))
        self._beside(event)
        self._changed()
