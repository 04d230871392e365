"""What the pilot is told: one short line on the ground station for each turn of a mission, in a pilot's words.

STATUSTEXT (253) has 50 characters a line and is read at a glance, some ground stations speak it. So the figures and
full reasons are left to the journal, and nothing is said of single shots.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from panoexec.devices import Severity, Vehicle
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState

MOST_SAYINGS: Final = 20
"""What waits beyond that, on a link that is gone, is dropped, oldest first."""
FAREWELL_S: Final = 3.0
"""How long the end of a mission waits for the last words."""

PAUSES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "link": "link was lost, waiting",
        "attitude": "gimbal reports nothing, waiting",
        "gimbal_control": "gimbal taken by another station",
        "pilot": "pilot has control, gimbal is free",
        "turning": "flight mode cannot turn us",
        "landed": "not in the air, gimbal is free",
        "battery": "battery low: land, swap, resume",
        "position": "drifted off, waiting to be back",
        "storage": "camera storage is full",
        "command": "by command",
    }
)
"""What each guard's code is to a pilot."""
_WARNINGS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "reboot": "autopilot rebooted",
        "open_loop": "no gimbal feedback, poses unproven",
        "position": "moved since the first shots: parallax",
        "battery_estimate": "more shots than this battery lasts for",
    }
)


@dataclass(frozen=True, slots=True)
class PilotMessage:
    """One line for the pilot."""

    text: str
    severity: Severity


def pilot_message_for(event: ev.Event, record: MissionRecord) -> PilotMessage | None:  # noqa: C901, PLR0911, PLR0912  (one case a kind)
    """What the pilot is told of an event; None for nothing."""
    done = f"{record.shots_done}/{record.shots_total}"
    match event:
        case ev.MissionStarted(resumed=True):
            return PilotMessage(f"goes on at {done}, checking", Severity.INFO)
        case ev.MissionStarted():
            return PilotMessage(f"{event.shots_total} shots, checking", Severity.INFO)
        case ev.PreflightPassed():
            return PilotMessage("shooting, hold position", Severity.NOTICE)
        case ev.PreflightFailed():
            return PilotMessage(f"not started: {'; '.join(event.problems)}", Severity.ERROR)
        case ev.MissionPaused(code="interrupted"):
            return PilotMessage(f"stopped at {done}, can be resumed", Severity.WARNING)
        case ev.MissionPaused():
            why = " + ".join(PAUSES.get(code, code) for code in event.code.split("+"))
            return PilotMessage(f"paused: {why}", Severity.NOTICE if event.code == "command" else Severity.WARNING)
        case ev.MissionResumed():
            return PilotMessage(f"goes on at {done}", Severity.NOTICE)
        case ev.PatchPlanned():
            return PilotMessage(f"{len(event.shots)} more shots to close holes", Severity.INFO)
        case ev.Warned():
            return PilotMessage(_WARNINGS.get(event.code, event.text), Severity.WARNING)
        case ev.MissionFinished(state=MissionState.COMPLETE):
            return PilotMessage(f"complete, {done}, gimbal is free", Severity.NOTICE)
        case ev.MissionFinished(state=MissionState.ABORTED):
            return PilotMessage(f"aborted at {done}, gimbal is free", Severity.WARNING)
        case ev.MissionFinished(state=MissionState.INCOMPLETE):
            return PilotMessage(f"ended, {len(event.missing)} of {record.shots_total} missing", Severity.WARNING)
        case ev.MissionFinished():
            return PilotMessage(f"failed at {done}: {event.reason}", Severity.ERROR)
    return None


class PilotMessenger:
    """A sink of a mission's events that speaks to the pilot; `run` does so beside the mission."""

    def __init__(self, *, vehicle: Vehicle, record: MissionRecord) -> None:
        self._vehicle = vehicle
        self._record = record
        self._waiting: deque[PilotMessage] = deque(maxlen=MOST_SAYINGS)
        self._came = asyncio.Event()
        self._speaking = asyncio.Lock()

    def publish(self, event: ev.Event) -> None:
        """See `EventSink.publish`."""
        saying = pilot_message_for(event, self._record)
        if saying is not None:
            self.tell(saying)

    def tell(self, saying: PilotMessage) -> None:
        """Say something when there is time."""
        self._waiting.append(saying)
        self._came.set()

    async def run(self) -> None:
        """Speak; runs until cancelled."""
        while True:
            await self._came.wait()
            self._came.clear()
            await self._speak()

    async def farewell(self) -> None:
        """Say what is left, if that takes no longer than a few seconds."""
        try:
            async with asyncio.timeout(FAREWELL_S):
                await self._speak()
        except TimeoutError:
            self._waiting.clear()

    async def _speak(self) -> None:
        async with self._speaking:
            while self._waiting:
                saying = self._waiting[0]
                await self._vehicle.say(f"Pano: {saying.text}", saying.severity)
                if self._waiting and self._waiting[0] is saying:  # else it was pushed out meanwhile
                    self._waiting.popleft()
