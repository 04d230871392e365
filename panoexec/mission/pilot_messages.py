"""Messages to the pilot: one STATUSTEXT line per phase of a mission.

STATUSTEXT (253) has 50 characters per line, is read at a glance, and some ground stations speak it. So figures and full
reasons stay in the journal, and there are no messages about single shots.
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

MAX_QUEUED: Final = 20
"""Most messages that wait for the link; when it is exceeded, the oldest is dropped."""
FLUSH_TIMEOUT_S: Final = 3.0
"""How long the end of a mission waits for queued messages."""

PAUSE_TEXTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "link": "link lost, waiting",
        "attitude": "no gimbal attitude, waiting",
        "gimbal_control": "another station has the gimbal",
        "foreign": "another station points the gimbal",
        "gimbal_unknown": "gimbal control unknown, asking",
        "gimbal_lost": "gimbal control lost, acquiring",
        "pilot": "pilot has control, gimbal released",
        "turning": "cannot turn in this flight mode",
        "turn_refused": "vehicle refuses each turn",
        "landed": "not in the air, gimbal released",
        "battery": "battery low: land, swap, resume",
        "fix": "GPS position lost, waiting",
        "position": "drifted, return to start position",
        "parallax": "drifted, return to start position",
        "storage": "camera storage is full",
        "camera": "camera refuses each photo",
        "photos": "no proof of any photo",
        "gimbal": "gimbal refuses each pose",
        "offset": "gimbal off its target each time",
        "reports": "gimbal reports too old",
        "heading": "heading not held, too much wind",
        "command": "by command",
    }
)
"""Text for each guard code."""
_WARNING_TEXTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "reboot": "autopilot rebooted",
        "stranger": "a second gimbal attitude is ignored",
        "open_loop": "no gimbal feedback, poses unverified",
        "position": "moved since the first shots: parallax",
        "battery_unknown": "battery charge no longer told",
        "battery_estimate": "battery too small for all shots",
        "parallax": "drift: expect parallax at seams",
        "untied": "some photos stay untied",
    }
)


@dataclass(frozen=True, slots=True)
class PilotMessage:
    """One line for the pilot."""

    text: str
    severity: Severity


def pilot_message_for(event: ev.Event, record: MissionRecord) -> PilotMessage | None:  # noqa: C901, PLR0911, PLR0912  (one case a kind)
    """The message for an event; None if it has none."""
    done = f"{record.shots_done}/{record.shots_total}"
    match event:
        case ev.MissionStarted(resumed=True):
            return PilotMessage(f"resumed at {done}, preflight checks", Severity.INFO)
        case ev.MissionStarted():
            return PilotMessage(f"{event.shots_total} shots, preflight checks", Severity.INFO)
        case ev.PreflightPassed():
            return PilotMessage("shooting, hold position", Severity.NOTICE)
        case ev.PreflightFailed():
            return PilotMessage(f"not started: {'; '.join(event.problems)}", Severity.ERROR)
        case ev.MissionPaused(code="interrupted"):
            return PilotMessage(f"stopped at {done}, can be resumed", Severity.WARNING)
        case ev.MissionPaused():
            why = " + ".join(PAUSE_TEXTS.get(code, code) for code in event.code.split("+"))
            return PilotMessage(f"paused: {why}", Severity.NOTICE if event.code == "command" else Severity.WARNING)
        case ev.MissionResumed():
            return PilotMessage(f"continues at {done}", Severity.NOTICE)
        case ev.PatchPlanned():
            return PilotMessage(f"{len(event.shots)} more shots to close holes", Severity.INFO)
        case ev.BridgePlanned():
            return PilotMessage(f"{len(event.shots)} more shots to tie photos", Severity.INFO)
        case ev.Warned():
            return PilotMessage(_WARNING_TEXTS.get(event.code, event.text), Severity.WARNING)
        case ev.GimbalContradicted():
            return PilotMessage(f"gimbal's north is {event.north_off_deg:+.0f} deg off", Severity.WARNING)
        case ev.MissionFinished(state=MissionState.COMPLETE):
            return PilotMessage(f"complete, {done}, {_proof(record)}", Severity.NOTICE)
        case ev.MissionFinished(state=MissionState.ABORTED):
            return PilotMessage(f"aborted at {done}, gimbal released", Severity.WARNING)
        case ev.MissionFinished(state=MissionState.INCOMPLETE):
            return PilotMessage(f"ended, {_lacking(event, record)}", Severity.WARNING)
        case ev.MissionFinished():
            return PilotMessage(f"failed at {done}: {event.reason}", Severity.ERROR)
    return None


def _proof(record: MissionRecord) -> str:
    """What is proved by less than geometry and content together; that the gimbal is free if nothing is."""
    content = record.content
    if content is None:
        return "gimbal released"
    if content.unchecked:
        return f"content of {len(content.unchecked)} unchecked"
    if content.geometry_only:
        return f"{len(content.geometry_only)} by geometry only"
    return f"tied in {content.groups} groups" if content.groups > 1 else "geometry and content good"


def _lacking(event: ev.MissionFinished, record: MissionRecord) -> str:
    """Which part is incomplete: shots, geometry, content."""
    bad = len(record.bad_photos())
    parts = [f"{len(event.missing)} of {record.shots_total} missing"] if event.missing else []
    if not event.missing and not bad:
        parts.append("geometry has a hole")
    if bad:
        parts.append(f"content of {bad} bad")
    return ", ".join(parts)


class PilotMessenger:
    """An event sink that sends messages to the pilot; `run` sends them, concurrently with the mission."""

    def __init__(self, *, vehicle: Vehicle, record: MissionRecord) -> None:
        self._vehicle = vehicle
        self._record = record
        self._waiting: deque[PilotMessage] = deque(maxlen=MAX_QUEUED)
        self._wake = asyncio.Event()
        self._sending = asyncio.Lock()
        self._saying: asyncio.Task[None] | None = None

    def publish(self, event: ev.Event) -> None:
        """See `EventSink.publish`."""
        message = pilot_message_for(event, self._record)
        if message is not None:
            self.send(message)

    def send(self, message: PilotMessage) -> None:
        """Queue a message."""
        self._waiting.append(message)
        self._wake.set()

    async def run(self) -> None:
        """Send queued messages; runs until cancelled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            await self._send_queued()

    async def flush(self) -> None:
        """Send what is queued, for at most `FLUSH_TIMEOUT_S`."""
        try:
            async with asyncio.timeout(FLUSH_TIMEOUT_S):
                await self._send_queued()
        except TimeoutError:
            self._waiting.clear()
            if self._saying is not None:
                self._saying.cancel()
                self._saying = None

    async def _send_queued(self) -> None:
        async with self._sending:
            while self._saying is not None or self._waiting:
                if self._saying is None:
                    message = self._waiting.popleft()
                    said = self._vehicle.say(f"Pano: {message.text}", message.severity)
                    self._saying = asyncio.create_task(said, name="message to the pilot")
                # a message that is on its way when `run` is cancelled arrives all the same: `flush` awaits it
                await asyncio.shield(self._saying)
                self._saying = None
