"""The state and the plan of the vehicle, retained on MQTT, and the status line for systemd."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Final

from panoexec.daemon.missions import Missions
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.inputs.plan_file import plan_to_data
from panoexec.mission.live_pose import LivePose
from panoexec.mission.log.shot_marks import ShotMarks
from panoexec.mission.log.states import MissionState
from panoexec.mqtt.link import MqttLink
from panoexec.mqtt.messages import ErrorDegFields, PoseFields, State, TourFields, dump, dump_json
from panoexec.planning.model import Plan

FLYING: Final = frozenset({MissionState.PREFLIGHT, MissionState.CAPTURING, MissionState.PAUSED, MissionState.FINISHING})

TWIN: Final = "another daemon publishes as this vehicle: give each a vehicle id of its own, or stop one"

_PERIOD_S: Final = 1.0
_IDLE_PERIOD_S: Final = 15.0
_PULSE_S: Final = 5.0


class StatePublisher:
    """Publishes in `run`, which is one task of the daemon; the other methods publish at once.

    Attributes:
        pulse_s: time.monotonic when the task last proved that it is not stalled.
    """

    def __init__(
        self,
        *,
        boot_id: str,
        missions: Missions,
        vehicle: VehicleLink,
        marks: ShotMarks,
        storage_trouble: Callable[[], str],
        mqtt: MqttLink | None,
        notifier: SystemdNotifier,
        changed: asyncio.Event,
        tour: Callable[[], TourFields | None] = lambda: None,
    ) -> None:
        """Describe it.

        Args:
            boot_id: of this process.
            missions: with the mission that flies or is offered.
            vehicle: with its links.
            marks: the state of each shot.
            storage_trouble: why no mission could be stored, "" if one could.
            mqtt: where to publish; None without a broker.
            notifier: gets the status line.
            changed: set by everything that changes the state.
            tour: returns what is known of stations of the autopilot's mission.
        """
        self.pulse_s = time.monotonic()
        self._boot_id = boot_id
        self._missions = missions
        self._vehicle = vehicle
        self._marks = marks
        self._storage_trouble = storage_trouble
        self._mqtt = mqtt
        self._notifier = notifier
        self._changed = changed
        self._tour = tour
        self._seq = 0
        self._published_plan: Plan | None = None
        self._published_for = ""

    async def run(self) -> None:
        """Publish the state on change, each second while a mission flies, and every 15 s otherwise."""
        status = ""
        while True:
            self.pulse_s = time.monotonic()
            self._changed.clear()
            self.publish_state()
            line = self.status_line()
            if line != status:
                status = line
                self._notifier.status(line)
            deadline = time.monotonic() + (_PERIOD_S if self._missions.busy else _IDLE_PERIOD_S)
            while not self._changed.is_set() and (left := deadline - time.monotonic()) > 0:
                self.pulse_s = time.monotonic()
                try:
                    async with asyncio.timeout(min(left, _PULSE_S)):
                        await self._changed.wait()
                except TimeoutError:
                    continue

    def publish_state(self) -> State:
        """Publish the state as of now, retained, and return it."""
        state = self._state()
        if self._mqtt is not None:
            self._mqtt.publish(self._mqtt.topics.state, dump(state), retain=True)
        return state

    def publish_plan(self, *, again: bool = False) -> None:
        """Publish the current plan, retained; an empty payload without one, so that none from before a restart stays.

        Args:
            again: even if this plan was published for this mission already.
        """
        plan, record = self._missions.plan, self._missions.record
        mission_id = "" if record is None else record.mission_id
        # a mission may have the very plan of the one before; who folds what is published needs it all the same
        known = plan is self._published_plan and mission_id == self._published_for
        if self._mqtt is None or (known and plan is not None and not again):
            return
        self._published_plan, self._published_for = plan, mission_id
        payload = b"" if plan is None else dump_json(plan_to_data(plan))
        self._mqtt.publish(self._mqtt.topics.plan, payload, retain=True)

    def publish_all(self) -> State:
        """Publish plan and state again, and the status if the broker keeps none, and return the state."""
        if self._mqtt is not None:
            self._mqtt.announce()
        self.publish_plan(again=True)
        return self.publish_state()

    def status_line(self) -> str:
        """What `systemctl status` shows."""
        record = self._missions.record
        if record is None or not self._missions.busy:
            return f"idle; {self._not_ready_reason or 'vehicle ready'}"
        return f"{record.state.value}: shot {record.shots_done}/{record.shots_total} of {record.mission_id}"

    @property
    def _not_ready_reason(self) -> str:
        """Why no mission could begin; "" if one could."""
        twin = TWIN if self._mqtt is not None and self._mqtt.twin else ""
        return "; ".join(part for part in (self._vehicle.lacking, self._storage_trouble(), twin) if part)

    def _state(self) -> State:
        self._seq += 1
        record, mission, offer = self._missions.record, self._missions.mission, self._missions.offer
        offered = offer is not None and mission is None
        battery = self._vehicle.status.battery_frac
        eta = mission.eta_s if mission is not None and record is not None and record.state in FLYING else math.nan
        need = mission.battery_need_frac if mission is not None and math.isfinite(eta) else math.nan
        state = MissionState.IDLE
        reason = "; ".join(part for part in (self._not_ready_reason, self._missions.damage) if part)
        if record is not None and not (offered and record.state in FLYING):
            state, reason = record.state, record.reason
        elif offered:
            reason = "the mission was interrupted and can be resumed"
            reason += f": {self._missions.trouble}" if self._missions.trouble else ""
        return State(
            state=state,
            mission_id=None if record is None else record.mission_id,
            name="" if record is None else self._missions.name,
            reference=None if record is None else record.reference,
            shots_total=0 if record is None else record.shots_total,
            shots_done=0 if record is None else record.shots_done,
            attempts=0 if record is None else record.attempts,
            retakes=0 if record is None else record.retakes,
            shots=self._marks.text(record),
            content={} if record is None else record.content_counts(),
            current=record.current if record is not None and mission is not None else None,
            eta_s=round(eta, 1) if math.isfinite(eta) else None,
            reason=reason,
            resumable=offer.stored_id if offered and offer is not None else None,
            link=self._vehicle.links(),
            pose=None if mission is None else _pose(mission.pose),
            battery_frac=battery if math.isfinite(battery) else None,
            battery_need_frac=round(need, 4) if math.isfinite(need) else None,
            tour=self._tour(),
            boot_id=self._boot_id,
            seq=self._seq,
            time=datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        )


def _pose(pose: LivePose | None) -> PoseFields | None:
    if pose is None:
        return None
    error = None
    if pose.error_deg is not None:
        pitch, roll, yaw = (round(one, 3) for one in pose.error_deg)
        error = ErrorDegFields(pitch=pitch, roll=roll, yaw=yaw)
    pitch, roll, yaw = (round(one, 2) for one in (pose.pitch_deg, pose.roll_deg, pose.yaw_deg))
    return PoseFields(pitch_deg=pitch, roll_deg=roll, yaw_deg=yaw, error_deg=error)
