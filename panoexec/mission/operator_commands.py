"""Commands to a running mission; safe at any time, because they only change requests."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial

from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import ShotStatus
from panoexec.mission.log.states import ENDED, MissionState
from panoexec.mission.mission_requests import CommandRefusedError, Stop


class OperatorCommands:
    """The commands of a mission. Each takes effect at the next safe point: at once while slewing, else after the photo.

    Every method raises `CommandRefusedError`, and changes nothing, when the mission's state does not allow it. The
    commands that stop a mission (`pause`, `finish`, `abort`, `interrupt`) are accepted before it runs, too: they are
    kept and take effect before anything moves. `by` says who sent the command, for the log.
    """

    def __init__(self, context: MissionContext) -> None:
        self._context = context
        self._runs = False
        self._kept: list[Callable[[], None]] = []

    @property
    def ending(self) -> bool:
        """Whether the mission ends and cannot be kept from it: by `abort`, `finish`, `interrupt` or by itself."""
        requests = self._context.requests
        return requests.must_end_shooting or requests.over

    def begin(self) -> None:
        """The mission runs: execute the commands that arrived before, as far as its state allows."""
        self._runs = True
        for command in self._kept:
            with contextlib.suppress(CommandRefusedError):
                command()
        self._kept.clear()

    def pause(self, reason: str = "", *, by: str = "") -> None:
        """Pause after the current photo until `resume`."""
        if not self._runs:
            self._kept.append(partial(self.pause, reason, by=by))
            return
        self._check_running("pause")
        if "command" in self._context.requests.holds:
            raise CommandRefusedError("cannot pause: the mission is paused already")
        if self._context.record.state is MissionState.FINISHING:
            raise CommandRefusedError("cannot pause: shooting is over, the mission is finishing")
        self._log("pause", reason=reason, by=by)
        self._context.requests.request_pause(reason)

    def resume(self, *, by: str = "") -> None:
        """Continue after a pause."""
        self._check_running("resume")
        if not self._context.requests.holds:
            raise CommandRefusedError("cannot resume: the mission is not paused")
        self._context.requests.resume()
        self._log("resume", by=by)

    def skip(self, shot: int | None = None, *, by: str = "") -> int:
        """Skip a shot, by default the current one. Returns its index."""
        self._check_running("skip")
        context = self._context
        index = context.record.current if shot is None else shot
        record = context.record.shots.get(-1 if index is None else index)
        if record is None or index is None:
            raise CommandRefusedError(self._unknown_shot("skip", shot))
        if record.accepted is not None or record.status is ShotStatus.SKIPPED:
            raise CommandRefusedError(f"cannot skip shot {index}: it is {record.status} already")
        self._log("skip", shot=index, by=by)
        if record.open_attempt is not None:
            context.requests.request_skip(index, current=record.status is ShotStatus.ACTIVE)
        else:
            context.queue.drop(index)
            attempt = len(record.attempts)
            context.recorder.emit(ev.ShotSkipped(shot=index, attempt=attempt, reason="skipped by command"))
        return index

    def repeat(self, shot: int | None = None, *, by: str = "") -> int:
        """Take a shot again, by default the last accepted one. The earlier photo counts until a new one is accepted."""
        self._check_running("repeat")
        context = self._context
        if context.requests.must_end_shooting:
            raise CommandRefusedError("cannot repeat: shooting is over")
        index = context.record.last_accepted if shot is None else shot
        record = context.record.shots.get(-1 if index is None else index)
        if record is None or index is None:
            raise CommandRefusedError(self._unknown_shot("repeat", shot))
        if record.open_attempt is not None or index in context.queue:
            raise CommandRefusedError(f"cannot repeat shot {index}: it is still in the queue")
        self._log("repeat", shot=index, by=by)
        context.requests.skips.discard(index)
        context.queue.add(index)
        context.requests.changed.set()
        return index

    def finish(self, reason: str = "", *, by: str = "") -> None:
        """End shooting and accept the gaps."""
        if not self._runs:
            self._kept.append(partial(self.finish, reason, by=by))
            return
        self._check_running("finish")
        if self._context.requests.must_end_shooting or self._context.record.state is MissionState.FINISHING:
            raise CommandRefusedError("cannot finish: the mission is finishing already")
        self._log("finish", reason=reason, by=by)
        self._context.requests.request_finish(reason or "finished by command, the gaps are accepted")

    def abort(self, reason: str = "", *, by: str = "") -> None:
        """End the mission."""
        if not self._runs:
            self._kept.append(partial(self.abort, reason, by=by))
            return
        self._check_running("abort")
        self._log("abort", reason=reason, by=by)
        self._context.requests.request_stop(Stop("abort", reason or "aborted by command"))

    def interrupt(self, reason: str = "") -> None:
        """End the process after the current photo; the mission can be resumed."""
        if not self._runs:
            self._kept.append(partial(self.interrupt, reason))
            return
        self._check_running("interrupt")
        self._log("interrupt", reason=reason)
        self._context.requests.request_stop(
            Stop("interrupt", reason or "panoexec was stopped; the mission can be resumed")
        )

    def _check_running(self, command: str) -> None:
        record = self._context.record
        if record.state in ENDED or record.state is MissionState.IDLE:
            raise CommandRefusedError(f"cannot {command}: the mission is {record.state}")
        if self._context.requests.over and self._context.requests.stop is None:
            raise CommandRefusedError(f"cannot {command}: the mission is over, the gimbal is being released")
        if self._context.requests.stop is not None:
            raise CommandRefusedError(f"cannot {command}: the mission is ending ({self._context.requests.stop.reason})")

    def _log(self, command: str, *, shot: int | None = None, reason: str = "", by: str = "") -> None:
        self._context.recorder.emit(ev.CommandReceived(command=command, shot=shot, reason=reason, by=by))

    def _unknown_shot(self, command: str, shot: int | None) -> str:
        if shot is None:
            return f"cannot {command}: no shot to {command} yet"
        known = sorted(self._context.record.shots)
        return f"cannot {command} shot {shot}: shots are {known[0]} to {known[-1]}"
