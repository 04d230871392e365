"""The live view and the summary of a dry-run."""

from __future__ import annotations

import math
import sys
from types import TracebackType
from typing import TYPE_CHECKING, Self

from panoexec.cli.output import console, counted, has_colours, minutes, note, print_facts
from panoexec.cli.sphere_map import MARKS, Mark, SphereMap, size_for
from panoexec.dryrun.run import DryRunSummary
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_marks import mark_of
from panoexec.mission.pointing.poses import read_pose
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.planning.model import Plan, Shot

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live
    from rich.progress import Progress, TaskID
    from rich.text import Text

REFRESH_HZ = 4.0
ROOM_LINES = 5
"""Minimum number of terminal lines besides the map: progress bar and some event lines."""


class MissionView:
    """A map of the sphere with a progress bar on a terminal, one line per verdict otherwise; always on stderr.

    A context manager: the live view is displayed inside it.

    Args:
        live: whether to draw the live view on a terminal; event lines are printed in either case.
        out: console to draw on; None: stderr, if it is a terminal.
    """

    def __init__(self, *, live: bool = True, out: Console | None = None) -> None:
        self._mission: Mission | None = None
        self._plan: Plan | None = None
        self._wanted = live and (out is not None or sys.stderr.isatty())
        self._out = out
        self._live: Live | None = None
        self._progress: Progress | None = None
        self._bar: TaskID | None = None
        self._map: SphereMap | None = None
        self._shots: list[Shot] = []
        self._marks: dict[int, Mark] = {}
        self._drawn: tuple[dict[int, Mark], Text] | None = None

    def __enter__(self) -> Self:
        if self._wanted:
            from rich.live import Live  # noqa: PLC0415

            self._out = self._out or console(stderr=True)
            self._progress = _progress(self._facts)
            self._bar = self._progress.add_task("shots", total=len(self._plan.shots) if self._plan else None)
            self._live = Live(console=self._out, get_renderable=self.picture, refresh_per_second=REFRESH_HZ)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def expect(self, plan: Plan) -> None:
        """Show a plan before the mission starts."""
        self._plan, self._shots = plan, list(plan.shots)

    def on_mission(self, mission: Mission) -> None:
        """Keep the mission to read its live state."""
        self._mission, self._plan = mission, mission.plan
        self._look(mission)

    def picture(self) -> RenderableType:
        """The current frame: the map, if there is room for it, above the bar. Called from rich's refresh thread."""
        from rich.console import Group  # noqa: PLC0415

        assert self._progress is not None
        assert self._out is not None
        size = size_for(self._out.size.width, self._out.size.height, beside=ROOM_LINES)
        if self._plan is None or size is None:
            return self._progress.get_renderable()
        if self._map is None or self._map.size != size:
            self._map, self._drawn = self._sphere(size), None
        if self._drawn is None or self._drawn[0] is not self._marks:
            marks, north = self._marks, self._mission is not None and self._mission.record.reference == "north"
            self._drawn = marks, self._map.text(self._shots, marks, colours=has_colours(self._out), north=north)
        return Group(self._drawn[1], self._progress.get_renderable())

    def _sphere(self, size: tuple[int, int]) -> SphereMap:
        assert self._plan is not None
        camera = self._plan.camera
        return SphereMap(camera.half_width, camera.half_height, width=size[0], height=size[1])

    def _look(self, mission: Mission) -> None:
        """Copy the marks from the mission's record, which changes only on the event loop."""
        record = mission.record
        marks = marks_of(record)
        if marks != self._marks:
            self._shots, self._marks = [shot.shot for _, shot in sorted(record.shots.items())], marks

    def on_event(self, event: ev.Event) -> None:  # noqa: C901, PLR0912  (one case per event type)
        """Show an event."""
        match event:
            case ev.ShotRejected():
                self._line(f"shot {event.shot}, attempt {event.attempt}: rejected: {event.reason}")
            case ev.ShotAccepted() if self._progress is None:
                self._line(f"shot {event.shot}, attempt {event.attempt}: accepted")
            case ev.ShotDeferred():
                self._line(f"shot {event.shot}: deferred until after the other shots: {event.reason}")
            case ev.ShotRevoked():
                self._line(f"shot {event.shot}, attempt {event.attempt}: no longer accepted: {event.reason}")
            case ev.ShotMissed():
                self._line(f"shot {event.shot}: given up: {event.reason}")
            case ev.MissionPaused():
                self._line(f"paused: {event.reason}")
            case ev.MissionResumed():
                self._line(f"resumed after {event.paused_s:.1f} s")
            case ev.PreflightFailed():
                self._line("preflight: " + "; ".join(event.problems))
            case ev.Warned():
                self._line(f"warning: {event.text}")
            case ev.PatchPlanned():
                self._line(f"{len(event.shots)} patch shots for {event.holes} holes")
            case ev.BridgePlanned():
                self._line(f"{len(event.shots)} bridge shots between photos that share too little")
            case _:
                pass
        if self._progress is not None and self._bar is not None and self._mission is not None:
            record = self._mission.record
            self._look(self._mission)
            self._progress.update(self._bar, completed=record.shots_done, total=record.shots_total)

    def note(self, text: str) -> None:
        """Show a message of the simulation."""
        self._line(f"simulation: {text}")

    def _line(self, text: str) -> None:
        if self._progress is None:
            note(text)
        else:
            assert self._live is not None
            self._live.console.print(text, markup=False, highlight=False)

    def _facts(self) -> str:
        """Retakes, current pointing error, remaining time."""
        mission = self._mission
        if mission is None:
            return "connecting"
        left = mission.eta_s
        parts = [
            counted(mission.record.retakes, "retake"),
            f"error {_degrees(_error_deg(mission))}",
            f"{minutes(left)} left" if math.isfinite(left) else "",
        ]
        return " · ".join(part for part in parts if part)


def marks_of(record: MissionRecord) -> dict[int, Mark]:
    """The marks of all shots of a mission, by index."""
    return {index: MARKS[mark_of(shot, current=index == record.current)] for index, shot in record.shots.items()}


def show_summary(summary: DryRunSummary) -> None:
    """Print the summary of a dry-run."""
    certificate, worst = summary.certificate, summary.worst
    facts = [
        ("mission", f"{summary.state}: {summary.reason}"),
        ("shots", f"{summary.accepted} of {summary.shots} accepted, {summary.attempts} attempts"),
        ("retakes", f"{summary.retakes}{_reasons(summary.rejected)}"),
    ]
    if worst is not None:
        facts.append(
            (
                "worst accepted error",
                f"pitch {worst.pitch_deg:+.3f}°, roll {worst.roll_deg:+.3f}°, yaw {worst.yaw_deg:+.3f}° (measured)",
            )
        )
    if summary.turns:
        facts.append(("vehicle turns", str(summary.turns)))
    facts.append(("evidence", ", ".join(f"{n} × {level}" for level, n in summary.evidence.items()) or "none"))
    if certificate is not None:
        proof = "complete as flown" if certificate.uncovered_fraction == 0 else "has holes"
        verdict = "certified" if certificate.certified else "not certified: " + "; ".join(certificate.failures)
        facts.append(("panorama", f"{proof}; {verdict}"))
    if math.isfinite(summary.limit_ratio):  # not finite if the mission ended before the first shot
        limit = f"physical limit {summary.limit_s:.1f} s, ratio {summary.limit_ratio:.2f}"
        facts.append(("time", f"{summary.duration_s:.1f} s; {limit}"))
    facts += [
        ("photos", f"{summary.photos} JPEGs"),
        ("directory", str(summary.directory)),
    ]
    if summary.report is not None:
        facts.append(("report", str(summary.report)))
    print_facts(facts)


def _progress(live: object) -> Progress:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    class Beside(ProgressColumn):
        """Text that is evaluated at every refresh."""

        def render(self, task: Task) -> Text:
            """The current text next to the bar."""
            del task
            return Text(live() if callable(live) else "")

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Beside(),
    )


def _error_deg(mission: Mission) -> float:
    """Angle between the current and the commanded boresight, degrees; NaN if unknown."""
    shooter, current = mission.shooter, mission.record.current
    if shooter is None or current is None:
        return math.nan
    shooter.gimbal.feed.ingest()
    sample = shooter.gimbal.feed.latest
    if sample is None:
        return math.nan
    reading = read_pose(sample, shooter.gimbal.feed.vehicle_attitude_at(sample), shooter.reference_yaw_north_deg)
    if reading.rotation is None:
        return math.nan
    shot = mission.record.shots[current].shot
    return float(pose_error(shot.pitch_deg, shot.yaw_deg, reading.rotation).boresight_deg)


def _degrees(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}°"


def _reasons(rejected: dict[str, int]) -> str:
    return f" ({', '.join(f'{n} × {code}' for code, n in sorted(rejected.items()))})" if rejected else ""
