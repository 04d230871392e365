"""Commands that a mission accepted and has not carried out yet."""

from __future__ import annotations

from dataclasses import dataclass, field

from panoexec.mission.log import events as ev


@dataclass(slots=True)
class PendingCommands:
    """Commands that were accepted but not carried out yet; kept so that they survive a crash.

    Attributes:
        end: the command that ends the mission, `abort` or `finish`; "" for none.
        reason: the reason given with it.
        pause: the mission is to pause until `resume`.
        skips: shots to skip whose attempt has no verdict yet.
        repeats: shots to take again.
    """

    end: str = ""
    reason: str = ""
    pause: bool = False
    skips: set[int] = field(default_factory=set)
    repeats: set[int] = field(default_factory=set)

    def apply(self, event: ev.Event) -> None:
        """Add the command of an event, or remove commands that the event completes."""
        match event:
            case ev.CommandReceived():
                self._take(event)
            case ev.MissionStarted():
                self.pause = False  # a start or resume ends the pause
            case ev.ShotSkipped():
                self.skips.discard(event.shot)
                self.repeats.discard(event.shot)
            case ev.ShotAccepted():
                self.skips.discard(event.shot)
            case ev.ShotStarted():  # from here on the shot's status is decisive
                self.repeats.discard(event.shot)

    def _take(self, event: ev.CommandReceived) -> None:
        """Add a command; an abort overrides a finish."""
        match event.command:
            case "abort" | "finish" if self.end != "abort":
                self.end, self.reason = event.command, event.reason
            case "pause" | "resume":
                self.pause = event.command == "pause"
            case "skip" if event.shot is not None:
                self.skips.add(event.shot)
            case "repeat" if event.shot is not None:
                self.skips.discard(event.shot)
                self.repeats.add(event.shot)
