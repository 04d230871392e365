"""What the parts of a running mission share: devices, wishes, record."""

from __future__ import annotations

from dataclasses import dataclass

from panoexec.clock import Clock
from panoexec.devices import Camera, Gimbal, Vehicle
from panoexec.mission.eta import EtaEstimator
from panoexec.mission.log.record import MissionRecord, ShotStatus
from panoexec.mission.log.recorder import Recorder
from panoexec.mission.mission_requests import MissionRequests
from panoexec.mission.pointing.heading import HeadingController
from panoexec.mission.protocols import Verifier
from panoexec.mission.settings import MissionSettings
from panoexec.mission.shot_queue import ShotQueue
from panoexec.planning.model import Plan


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionContext:
    """One mission in the air: handed to each part by the executor."""

    plan: Plan
    settings: MissionSettings
    gimbal: Gimbal
    camera: Camera
    vehicle: Vehicle
    clock: Clock
    verifier: Verifier
    recorder: Recorder
    control: MissionRequests
    queue: ShotQueue
    pace: EtaEstimator
    turner: HeadingController | None = None

    @property
    def record(self) -> MissionRecord:
        """All that is known of the mission."""
        return self.recorder.record

    def shots_left(self) -> int:
        """Shots that are still to be taken or to be proven."""
        out = (ShotStatus.ACTIVE, ShotStatus.EXPOSED)
        return len(self.queue) + sum(1 for shot in self.record.shots.values() if shot.status in out)
