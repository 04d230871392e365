"""What a person may ask of a running mission; safe at every instant, because it only changes wishes."""

from __future__ import annotations

from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import ShotStatus
from panoexec.mission.log.states import ENDED, MissionState
from panoexec.mission.mission_requests import CommandRefusedError, Stop


class OperatorCommands:
    """The commands of a mission. Each is obeyed at the next safe point: at once while slewing, else after the photo.

    Every method raises `CommandRefusedError` when the mission cannot do it now, and then changes nothing.
    """

    def __init__(self, flight: MissionContext) -> None:
        self._flight = flight

    def pause(self, reason: str = "") -> None:
        """Hold after the current photo until `resume`."""
        self._live("pause")
        if "command" in self._flight.control.holds:
            raise CommandRefusedError("cannot pause: the mission is paused already")
        if self._flight.record.state is MissionState.FINISHING:
            raise CommandRefusedError("cannot pause: shooting is over, the mission is finishing")
        self._log("pause", reason=reason)
        self._flight.control.ask_pause(reason)

    def resume(self) -> None:
        """Go on after a pause."""
        self._live("resume")
        if not self._flight.control.holds:
            raise CommandRefusedError("cannot resume: the mission is not paused")
        self._flight.control.resume()
        self._log("resume")

    def skip(self, shot: int | None = None) -> int:
        """Leave a shot out; the current one if none is named. Returns its index."""
        self._live("skip")
        flight = self._flight
        index = flight.record.current if shot is None else shot
        record = flight.record.shots.get(-1 if index is None else index)
        if record is None or index is None:
            raise CommandRefusedError(self._no_such("skip", shot))
        if record.accepted is not None or record.status is ShotStatus.SKIPPED:
            raise CommandRefusedError(f"cannot skip shot {index}: it is {record.status} already")
        self._log("skip", shot=index)
        if record.open_attempt is not None:
            flight.control.ask_skip(index, current=record.status is ShotStatus.ACTIVE)
        else:
            flight.queue.drop(index)
            attempt = len(record.attempts)
            flight.recorder.emit(ev.ShotSkipped(shot=index, attempt=attempt, reason="skipped by command"))
        return index

    def repeat(self, shot: int | None = None) -> int:
        """Take a shot again, the last accepted one if none is named; the earlier photo counts until a new one does."""
        self._live("repeat")
        flight = self._flight
        if flight.control.must_leave:
            raise CommandRefusedError("cannot repeat: shooting is over")
        index = flight.record.last_accepted if shot is None else shot
        record = flight.record.shots.get(-1 if index is None else index)
        if record is None or index is None:
            raise CommandRefusedError(self._no_such("repeat", shot))
        if record.open_attempt is not None or index in flight.queue:
            raise CommandRefusedError(f"cannot repeat shot {index}: it is to be taken anyway")
        self._log("repeat", shot=index)
        flight.control.skips.discard(index)
        flight.queue.add(index)
        flight.control.changed.set()
        return index

    def finish(self, reason: str = "") -> None:
        """End shooting and accept the gaps."""
        self._live("finish")
        if self._flight.control.must_leave or self._flight.record.state is MissionState.FINISHING:
            raise CommandRefusedError("cannot finish: the mission is finishing already")
        self._log("finish", reason=reason)
        self._flight.control.ask_finish(reason or "finished by command, the gaps are accepted")

    def abort(self, reason: str = "") -> None:
        """End the mission."""
        self._live("abort")
        self._log("abort", reason=reason)
        self._flight.control.ask_stop(Stop("abort", reason or "aborted by command"))

    def interrupt(self, reason: str = "") -> None:
        """End the process after the current photo; the mission can be resumed."""
        self._live("interrupt")
        self._log("interrupt", reason=reason)
        self._flight.control.ask_stop(Stop("interrupt", reason or "panoexec was stopped; the mission can be resumed"))

    def _live(self, command: str) -> None:
        record = self._flight.record
        if record.state in ENDED or record.state is MissionState.IDLE:
            raise CommandRefusedError(f"cannot {command}: the mission is {record.state}")
        if self._flight.control.over and self._flight.control.stop is None:
            raise CommandRefusedError(f"cannot {command}: the mission is over, the gimbal is being released")
        if self._flight.control.stop is not None:
            raise CommandRefusedError(f"cannot {command}: the mission is ending ({self._flight.control.stop.reason})")

    def _log(self, command: str, *, shot: int | None = None, reason: str = "") -> None:
        self._flight.recorder.emit(ev.CommandReceived(command=command, shot=shot, reason=reason))

    def _no_such(self, command: str, shot: int | None) -> str:
        if shot is None:
            return f"cannot {command}: no shot to {command} yet"
        known = sorted(self._flight.record.shots)
        return f"cannot {command} shot {shot}: shots are {known[0]} to {known[-1]}"
