"""What the components of a running mission share: plan, settings, devices, requests and record."""

from __future__ import annotations

from dataclasses import dataclass

from panoexec.clock import Clock
from panoexec.devices import Camera, Gimbal, Vehicle
from panoexec.mission.eta import EtaEstimator
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.recorder import Recorder
from panoexec.mission.log.shot_record import ShotStatus
from panoexec.mission.mission_requests import MissionRequests
from panoexec.mission.pointing.heading import HeadingController
from panoexec.mission.protocols import Verifier
from panoexec.mission.settings import MissionSettings
from panoexec.mission.shot_queue import ShotQueue
from panoexec.planning.model import Plan


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionContext:
    """One running mission; the executor passes it to each component."""

    plan: Plan
    settings: MissionSettings
    gimbal: Gimbal
    camera: Camera
    vehicle: Vehicle
    clock: Clock
    verifier: Verifier
    recorder: Recorder
    requests: MissionRequests
    queue: ShotQueue
    eta: EtaEstimator
    heading_controller: HeadingController | None = None

    @property
    def record(self) -> MissionRecord:
        """The mission's record."""
        return self.recorder.record

    def shots_left(self) -> int:
        """Number of shots that are queued, being taken or awaiting evidence."""
        in_progress = (ShotStatus.ACTIVE, ShotStatus.EXPOSED)
        return len(self.queue) + sum(1 for shot in self.record.shots.values() if shot.status in in_progress)
