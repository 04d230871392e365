"""A complete mission on a vehicle under test: the composition behind `panoexec dry-run`.

The vehicle (the embedded simulation, ArduPilot's SITL, or one that is already running: `panoexec.dryrun.rigs`) speaks
MAVLink over UDP; the mission side is the same as for a real one. Both run at the same speed-up, so a mission takes the
same simulated time at any speed-up.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel
from panoexec.dryrun.autopilot import sitl_binary
from panoexec.dryrun.devices import devices_on, lock_on, settings_on
from panoexec.dryrun.rigs import ConnectedVehicle, EmbeddedVehicle, SitlVehicle, VehicleUnderTest
from panoexec.errors import LinkError, UsageError
from panoexec.mission.executor import Mission
from panoexec.mission.ideal_duration import ideal_step_durations_s
from panoexec.mission.log.events import AxisErrors, Event
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.pointing.poses import pose_of, read_pose
from panoexec.mission.protocols import PhotoFetcher
from panoexec.mission.settings import MissionSettings
from panoexec.planning.model import Certificate, Plan, Shot
from panoexec.report.mission_outputs import write_mission_outputs
from panoexec.sim import settings as sim_settings
from panoexec.sim.config import SimConfig
from panoexec.store.directory import discard_mission_directory, existing_mission_directory
from panoexec.store.landed_mission import LandedMission
from panoexec.store.photo_collector import PhotoCollector
from panoexec.store.rebuilding import NAME, restore_manifest
from panoexec.store.session import Devices, MissionSession, StoredMission, create_mission, open_mission

CARD = "camera"
"""Folder of a mission directory for the card of a simulated camera that hands over its photos."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRunOptions:
    """The mission to fly, and the vehicle.

    Attributes:
        plan: the mission's plan.
        settings: the mission's settings.
        simulation: the simulated vehicle; its port and output are chosen here.
        storage: the mission directory is created in its folder `missions`.
        reference: direction of yaw 0.
        name: what people call the mission.
        images: whether the camera writes JPEGs into the mission directory.
        sitl: use ArduPilot's SITL instead (the binary, see `panoexec.dryrun.autopilot.sitl_binary`).
        connect: use a vehicle that is already running instead, without arming or moving it (connection string); the
            simulated payload joins it if the simulation has an `attach_url`.
    """

    plan: Plan
    settings: MissionSettings
    simulation: SimConfig
    storage: Path
    reference: Literal["north", "heading"] = "north"
    name: str = ""
    images: bool = True
    sitl: Path | None = None
    connect: str | None = None

    @property
    def vehicle(self) -> VehicleUnderTest:
        """The vehicle for these options.

        Raises:
            UsageError: the simulation options are not available for this vehicle.
        """
        return vehicle_under_test(self.simulation, sitl=self.sitl, connect=self.connect)


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRunSummary:
    """Results of a dry-run.

    Attributes:
        mission_id, directory: id and directory of the mission.
        state, reason: final state.
        shots, accepted, attempts, retakes, missing: counts, and the indices of shots without a photo.
        rejected: number of rejected attempts for each code.
        worst: the largest errors of all accepted shots, with sign; None without an accepted shot.
        evidence: number of accepted shots at each evidence level (that of the weakest photo).
        photos: JPEGs in the mission directory.
        duration_s: simulated seconds from the first slew to the last verdict.
        limit_s: ideal duration for the same shots in the same order: slews at full rate and acceleration, settle time,
            camera latency from command to shutter, exposure, camera interval.
        trigger_delay_s: 99th percentile of the delay from settled to the trigger on the wire, simulated seconds.
        certificate: of the measured attitudes; None if the mission did not compute it.
        vehicle: description as in the manifest; `landed` if a landing was needed.
        turns: number of turns of the vehicle, where it pans.
        report: the HTML report.
        content: what the content of the photos proves: `bad` (shot, file, code), `geometry_only`,
            `unchecked`, `groups`, `bridges`; empty if nothing was examined.
    """

    mission_id: str
    directory: Path
    state: str
    reason: str
    shots: int
    accepted: int
    attempts: int
    retakes: int
    missing: tuple[int, ...]
    rejected: dict[str, int]
    worst: AxisErrors | None
    evidence: dict[str, int]
    photos: int
    duration_s: float
    limit_s: float
    trigger_delay_s: float
    certificate: Certificate | None = field(repr=False)
    vehicle: dict[str, Any] = field(default_factory=dict)
    turns: int = 0
    report: Path | None = None
    content: dict[str, Any] = field(default_factory=dict)

    @property
    def limit_ratio(self) -> float:
        """Duration divided by the ideal duration; NaN if one is unknown."""
        return self.duration_s / self.limit_s if self.limit_s > 0 else math.nan

    def to_json(self) -> dict[str, Any]:
        """As a JSON object, for `--json`."""
        out = asdict(replace(self, certificate=None))
        certificate = self.certificate
        out["directory"] = str(self.directory)
        out["report"] = None if self.report is None else str(self.report)
        out["missing"] = list(self.missing)
        out["certified"] = None if certificate is None else certificate.certified
        out["uncovered_fraction"] = None if certificate is None else certificate.uncovered_fraction
        del out["certificate"]
        out["limit_ratio"] = self.limit_ratio
        return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in out.items()}


async def run_dry_run(
    options: DryRunOptions,
    *,
    on_event: Callable[[Event], None] = lambda _: None,
    on_mission: Callable[[Mission], None] = lambda _: None,
    note: Callable[[str], None] = lambda _: None,
) -> DryRunSummary:
    """Fly a new mission on a new simulated vehicle.

    Cancelling stops the mission at once and all started processes; the mission can be resumed. A mission that had not
    begun, because starting, discovery or take-off failed, leaves no files.

    Args:
        options: mission and vehicle.
        on_event: receives every event of the mission once it is durable.
        on_mission: receives the mission just before it begins: for operator commands and live state.
        note: receives progress messages, line by line.

    Raises:
        PanoexecError: something could not be started; no process is left running.
    """
    vehicle = options.vehicle
    extra = {
        "simulation": sim_settings.to_json(options.simulation),
        "images": options.images,
        "reference": options.reference,
        NAME: options.name,
        "sitl": None if options.sitl is None else str(options.sitl),
        "connect": options.connect,
    }
    stored = await create_mission(
        options.storage, plan=options.plan, settings=options.settings, now_utc_s=SystemClock().time(), extra=extra
    )
    begun = False

    def begins(mission: Mission) -> None:
        nonlocal begun
        begun = True
        on_mission(mission)

    try:
        return await _fly(
            stored, vehicle, options.simulation, options.images, options.reference, on_event, begins, note
        )
    finally:
        if not begun:
            await asyncio.to_thread(discard_mission_directory, stored.directory)


async def resume_dry_run(
    directory: Path,
    *,
    simulation: Callable[[SimConfig], SimConfig] = lambda config: config,
    on_event: Callable[[Event], None] = lambda _: None,
    on_mission: Callable[[Mission], None] = lambda _: None,
    note: Callable[[str], None] = lambda _: None,
) -> DryRunSummary:
    """Resume an interrupted dry-run on a new simulated vehicle; arguments as for `run_dry_run`.

    Args:
        directory: the mission directory.
        simulation: changes the configuration of the original simulated vehicle.
        on_event: as for `run_dry_run`.
        on_mission: as for `run_dry_run`.
        note: as for `run_dry_run`.

    Raises:
        PanoexecError: the mission is over, is not a dry-run, or something could not be started.
    """
    stored = await open_mission(existing_mission_directory(directory))
    try:
        config = sim_settings.from_json(stored.extra["simulation"])
    except KeyError:
        await stored.journal.close()
        raise LinkError(f"{directory}: not a dry-run; its mission was flown on a real vehicle") from None
    images = bool(stored.extra.get("images", True))
    sitl, connect = stored.extra.get("sitl"), stored.extra.get("connect")
    try:
        config = simulation(config)
        vehicle = vehicle_under_test(config, sitl=sitl_binary(sitl) if sitl else None, connect=connect)
    except BaseException:
        await stored.journal.close()
        raise
    # only relevant if the process died before its first event was on disk
    reference: Literal["north", "heading"] = "heading" if stored.extra.get("reference") == "heading" else "north"
    return await _fly(stored, vehicle, config, images, reference, on_event, on_mission, note)


def vehicle_under_test(simulation: SimConfig, *, sitl: Path | None, connect: str | None) -> VehicleUnderTest:
    """The vehicle of a dry-run: see `DryRunOptions`.

    Raises:
        UsageError: the simulation options are not available for this vehicle.
    """
    if sitl is not None:
        return SitlVehicle(binary=sitl, simulation=simulation)
    if connect is not None:
        return ConnectedVehicle(connection=connect, simulation=simulation)
    return EmbeddedVehicle(simulation=simulation)


class _Callback:
    """An event sink that calls a function."""

    def __init__(self, call: Callable[[Event], None]) -> None:
        self.publish = call


async def _fly(  # noqa: PLR0917  (private; what the two public ones share)
    stored: StoredMission,
    vehicle: VehicleUnderTest,
    simulation: SimConfig,
    images: bool,
    reference: Literal["north", "heading"],
    on_event: Callable[[Event], None],
    on_mission: Callable[[Mission], None],
    note: Callable[[str], None],
) -> DryRunSummary:
    clock = vehicle.clock()
    tethered = simulation.camera_link == "gphoto2"
    if tethered and not images:
        raise UsageError("--no-images: a camera with --camera-link gphoto2 hands over its photos, so it needs some")
    output = None
    if images:
        output = stored.directory.path / CARD if tethered else stored.directory.images
    try:
        lock = lock_on(simulation, images=images)
        async with devices_on(vehicle, images=output, clock=clock, note=note, lock=lock) as (devices, rig):
            opened = MissionSession.opened(
                stored,
                devices=devices,
                clock=clock,
                sink=_Callback(on_event),
                vehicle=rig.about,
                reference=reference,
                settings=settings_on(rig, devices, stored.settings, note),
                fetchers=[devices.camera] if isinstance(devices.camera, PhotoFetcher) else [],
            )
            async with opened as session:
                on_mission(session.mission)
                before, began_utc_s = _pose_now(devices, 0.0), clock.time()
                record = await session.run()
                # metering the exposure points the gimbal before the first shot, at one of the shots
                before = None if lock.exposure == "first" else before
                start = None if before is None else (before[0], before[1] - record.reference_yaw_north_deg)
                duration_s, certificate = session.mission.shooting_s, session.mission.certificate
                turns, turning = session.mission.turns, session.mission.turning
            if isinstance(devices.camera, PhotoFetcher):
                await _bring_the_rest(stored, devices.camera)
    except BaseException:
        await stored.journal.close()
        # write the outputs of an interrupted mission, but report the original error
        with suppress(UsageError):
            await asyncio.to_thread(write_mission_outputs, stored.directory)
        raise
    await stored.journal.close()
    try:
        await asyncio.to_thread(write_mission_outputs, stored.directory)
    except UsageError as error:  # the mission itself is complete and on disk
        note(f"some outputs of the mission could not be written: {error}")
    shots = _shots_flown(record, since_utc_s=began_utc_s)
    camera = simulation.camera
    flown = replace(stored.settings, gimbal=replace(stored.settings.gimbal, turning=turning))
    steps_s = ideal_step_durations_s(shots, flown, start=start, exposure_s=camera.exposure_s, lag_s=camera.latency_s)
    limit_s = sum(steps_s)
    summary = summarise(stored, record, duration_s=duration_s, limit_s=limit_s, certificate=certificate)
    return replace(summary, vehicle=rig.about, turns=turns, report=stored.directory.report)


async def _bring_the_rest(stored: StoredMission, camera: PhotoFetcher) -> None:
    """Bring the photos that were still in the camera when the mission ended."""
    landed = await asyncio.to_thread(LandedMission.read, stored.directory)
    flown = landed.record.seq
    try:
        collector = PhotoCollector(stored.directory.path, record=landed.record, store=landed.photos, fetchers=[camera])

        async def keep() -> None:
            await landed.flush()

        await collector.run_until_done(keep)
        if landed.record.seq > flown:
            await asyncio.to_thread(restore_manifest, stored.directory)
    finally:
        landed.close()


def _shots_flown(record: MissionRecord, *, since_utc_s: float) -> tuple[Shot, ...]:
    """The shots attempted since a moment, each once, in the order of their first attempt; includes patch shots."""
    first = {
        attempt.started_utc_s: shot.shot
        for shot in record.shots.values()
        for attempt in [a for a in shot.attempts if a.started_utc_s >= since_utc_s][:1]
    }
    return tuple(shot for _, shot in sorted(first.items()))


def _pose_now(devices: Devices, reference_yaw_north_deg: float) -> tuple[float, float] | None:
    """Pitch and yaw of the gimbal in the plan's frame; None if unknown."""
    feed = devices.gimbal.feed
    feed.ingest()
    sample = feed.latest
    if sample is None or math.isnan(reference_yaw_north_deg):
        return None
    reading = read_pose(sample, feed.vehicle_attitude_at(sample), reference_yaw_north_deg)
    if reading.rotation is None:
        return None
    pose = pose_of(reading.rotation)
    return pose.pitch_deg, pose.yaw_deg


def summarise(
    stored: StoredMission,
    record: MissionRecord,
    *,
    duration_s: float,
    limit_s: float,
    certificate: Certificate | None,
) -> DryRunSummary:
    """The summary of a mission that has ended."""
    attempts = [attempt for shot in record.shots.values() for attempt in shot.attempts]
    accepted = [shot.accepted for shot in record.shots.values() if shot.accepted is not None]
    errors = [attempt.exposed.errors for attempt in accepted if attempt.exposed and attempt.exposed.errors]
    delays = sorted(attempt.exposed.trigger_delay_s for attempt in attempts if attempt.exposed)
    levels = Counter((attempt.evidence or EvidenceLevel.COMMANDED).name.lower() for attempt in accepted)
    return DryRunSummary(
        mission_id=record.mission_id,
        directory=stored.directory.path,
        state=record.state.value,
        reason=record.reason,
        shots=record.shots_total,
        accepted=record.shots_done,
        attempts=record.attempts,
        retakes=record.retakes,
        missing=record.missing(),
        rejected=dict(Counter(attempt.code for attempt in attempts if attempt.verdict is Verdict.REJECTED)),
        worst=worst_of(errors),
        evidence=dict(levels),
        photos=len(list(stored.directory.images.glob("*.jpg"))) if stored.directory.images.is_dir() else 0,
        duration_s=duration_s,
        limit_s=limit_s,
        trigger_delay_s=delays[math.ceil(0.99 * len(delays)) - 1] if delays else math.nan,
        certificate=certificate,
        content=_content_of(record),
    )


def _content_of(record: MissionRecord) -> dict[str, Any]:
    content = record.content
    if content is None:
        return {}
    bad = []
    for shot, code in record.bad_photos().items():
        accepted = record.shots[shot].accepted
        file = accepted.photos[0].file if accepted is not None and accepted.photos else ""
        bad.append({"shot": shot, "file": Path(file).name, "code": code})
    return {
        "bad": bad,
        "geometry_only": list(content.geometry_only),
        "unchecked": list(content.unchecked),
        "groups": content.groups,
        "bridges": len(content.bridges) // 2,
    }


def worst_of(errors: list[AxisErrors]) -> AxisErrors | None:
    """The largest error of each axis by magnitude, with sign; None for an empty list."""
    if not errors:
        return None
    names = asdict(errors[0])
    return AxisErrors(**{name: max((getattr(e, name) for e in errors), key=abs) for name in names})
