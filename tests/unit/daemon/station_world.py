"""An autopilot with a mission, a daemon that flies panoramas, and a pilot, in virtual time, around `Stations`."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from panoexec.adapters.autopilot_mission import Current, MissionItem
from panoexec.daemon.stations.watcher import Stations
from panoexec.devices import VehicleStatus
from panoexec.errors import DeviceError
from panoexec.inputs.config import Config
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mqtt.incoming import Incoming
from panoexec.store.tours import Tour, newest_tour

LEG_S = 6.0
METRE_E7 = 90
_CONFIG = {
    "presets": {"roof": {"elevation_deg": [-30, 0]}, "yard": {"elevation_deg": [-60, 0]}},
    "stations": {"enabled": True},
}


def waypoint(seq: int, north_m: float, *, hold_s: float = 0.0) -> MissionItem:
    x = 474_000_000 + round(north_m * METRE_E7)
    return MissionItem(seq=seq, command=16, frame=3, params=(hold_s, 0.0, 0.0, 0.0), x=x, y=85_000_000, z=20.0)


def marker(seq: int, preset: int, *, shoot: int = 0) -> MissionItem:
    return MissionItem(seq=seq, command=203, frame=2, params=(0.0,) * 4, x=shoot, y=preset, z=0.0)


def jump(seq: int, to: int, times: int) -> MissionItem:
    return MissionItem(seq=seq, command=177, frame=2, params=(float(to), float(times), 0.0, 0.0), x=0, y=0, z=0.0)


def two_stations(*, hold_s: float = 40.0, presets: tuple[int, int] = (1, 2)) -> list[MissionItem]:
    """Stations at waypoints 1 and 3, and the way on to 5."""
    return [
        waypoint(0, 0),
        waypoint(1, 20, hold_s=hold_s),
        marker(2, presets[0]),
        waypoint(3, 40, hold_s=hold_s),
        marker(4, presets[1]),
        waypoint(5, 60),
    ]


@dataclass(kw_only=True)
class World:
    """All of it; time passes while the watcher sleeps.

    Attributes:
        items: of the autopilot's mission.
        extends: whether a hold time begins anew (ArduPilot).
        panorama_s: how long shooting takes.
        script: what happens at which second.
        log: what the autopilot and the daemon were told, with the second.
    """

    folder: Path
    items: Sequence[MissionItem]
    extends: bool = True
    panorama_s: float = 25.0
    config: dict[str, Any] = field(default_factory=dict)
    script: list[tuple[float, Callable[[World], None]]] = field(default_factory=list)
    log: list[tuple[float, str]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    now_s: float = 100.0
    seq: int = 1
    mode: str = "MISSION"
    battery_frac: float = 0.9
    position_ok: bool = True
    armed: bool = True
    claimed: str = ""
    is_to_introduce: bool = False
    reached: int | None = None
    plan_s: float = 25.0
    plan_error: Exception | None = None
    refuses: str = ""
    refuses_current: bool = False
    deaf: bool = False

    def __post_init__(self) -> None:
        self.mission_items = tuple(self.items)
        self.stale = True
        self.digest = ""
        self.extends_hold = self.extends
        self.missions = SimpleNamespace(
            mission=None, record=None, busy=False, offer=None, under_way=lambda: asyncio.sleep(0)
        )
        self.devices = SimpleNamespace(vehicle=SimpleNamespace(turn_modes=("OFFBOARD",)))
        self._leg_s = 0.0
        self._held_s = math.nan
        self._shot_s = 0.0
        self._paused = ""
        self._jumps = 0
        self._end_s = math.inf
        self.made = 0
        self._config = Config.model_validate(
            _CONFIG | self.config | {"storage": {"path": str(self.folder)}, "guards": {"hover_min": 20.0}}
        )
        self.watcher: Stations = self.process()

    def process(self) -> Stations:
        """The watcher of a new process."""
        return Stations(
            config=lambda: self._config,
            vehicle=cast("Any", self),
            missions=cast("Any", self.missions),
            take=self._take,
            plan_of=self._plan_of,
            clock=cast("Any", self),
            changed=lambda: None,
            boot_id=f"boot{self.made}",
        )

    async def run(self, seconds: float) -> World:
        """Let the watcher run for so long; it is killed then."""
        self._end_s = self.now_s + seconds
        self._over_at = asyncio.Event()
        task = asyncio.create_task(self.watcher.run())
        ended = asyncio.create_task(self._over_at.wait())
        await asyncio.wait({task, ended}, return_when=asyncio.FIRST_COMPLETED)
        task.cancel()
        ended.cancel()
        (result,) = await asyncio.gather(task, return_exceptions=True)
        assert isinstance(result, asyncio.CancelledError), result
        return self

    @property
    def tour(self) -> Tour:
        tour = newest_tour(self.folder)
        assert tour is not None
        return tour

    @property
    def outcomes(self) -> list[tuple[int, str]]:
        return [(stop.waypoint, stop.outcome) for stop in self.tour.stops]

    def told(self, start: str) -> list[float]:
        """When something was told."""
        return [when for when, what in self.log if what.startswith(start)]

    # --- the clock

    def monotonic(self) -> float:
        return self.now_s

    def time(self) -> float:
        return 1_800_000_000.0 + self.now_s

    async def sleep(self, seconds: float) -> None:
        if self.now_s >= self._end_s:
            self._over_at.set()
            await asyncio.Event().wait()  # nothing happens in this process any more
        self._step(seconds)
        for _ in range(3):
            await asyncio.sleep(0)

    # --- the vehicle and its link

    @property
    def autopilot_mission(self) -> World:
        return self

    @property
    def current(self) -> Current:
        return Current(seq=self.seq, total=len(self.items), state=3, mission_id=0, heard_s=self.now_s)

    @property
    def status(self) -> VehicleStatus:
        at = self.items[self.seq]
        north_e7 = at.x - (0 if self._leg_s >= LEG_S else 10 * METRE_E7)
        return VehicleStatus(
            connected=True,
            armed=self.armed,
            in_air=True,
            mode=self.mode,
            latitude_deg=north_e7 / 1e7,
            longitude_deg=8.5,
            relative_altitude_m=20.0,
            battery_frac=self.battery_frac,
            position_ok=self.position_ok,
        )

    async def say(self, text: str) -> None:
        self.said.append(text.removeprefix("Pano: "))

    async def read(self) -> bool:
        if self.deaf:
            raise DeviceError("reading the mission: not answered")
        digest = str(hash(tuple(self.items)))
        self.stale = False
        changed, self.digest = digest != self.digest, digest
        self.mission_items = tuple(self.items)
        return changed

    async def make_current(self, seq: int) -> None:
        self.log.append((self.now_s, f"current {seq}"))
        if self.refuses_current:
            raise DeviceError("refused")
        if seq == self.seq:
            self._held_s = math.nan if not self.extends else self.now_s
        else:
            self._fly_on(seq)

    async def change_mode(self, name: str) -> None:
        self.log.append((self.now_s, f"mode {name}"))
        self.set_mode(name)

    def set_mode(self, name: str) -> None:
        if name == "MISSION" and self.mode != "MISSION":
            self._held_s = self.now_s if self._leg_s >= LEG_S else math.nan
        self.mode = name

    def upload(self, items: Sequence[MissionItem]) -> None:
        self.items = items
        self.stale = True

    def jump_to(self, seq: int) -> None:
        self._fly_on(seq)

    def _fly_on(self, seq: int) -> None:
        while seq < len(self.items) and self.items[seq].command != 16:
            item = self.items[seq]
            if item.command == 177 and self._jumps < item.params[1]:
                self._jumps += 1
                seq = int(item.params[0])
            else:
                seq += 1
        if seq < len(self.items):
            self.seq, self._leg_s, self._held_s, self.stale = seq, 0.0, math.nan, True

    def _step(self, dt: float) -> None:
        self.now_s += dt
        while self.script and self.script[0][0] <= self.now_s - 100.0:
            self.script.pop(0)[1](self)
        if self.mode == "MISSION":
            self._leg_s += dt
            if self._leg_s >= LEG_S:
                if math.isnan(self._held_s):
                    self._held_s = self.now_s
                if self.now_s - self._held_s >= self.items[self.seq].params[0]:
                    self._fly_on(self.seq + 1)
        self._shoot(dt)

    # --- the daemon's missions

    async def _plan_of(self, preset: str) -> Any:
        if self.plan_error is not None:
            raise self.plan_error
        return SimpleNamespace(estimate=SimpleNamespace(duration_s=self.plan_s), preset=preset)

    def _take(self, incoming: Incoming) -> None:
        fields = json.loads(incoming.payload)
        self.log.append((self.now_s, incoming.command))
        missions, error = self.missions, None
        if self.refuses and incoming.command != "finish":
            error = {"code": "busy", "message": self.refuses}
        elif incoming.command == "start":
            assert incoming.stop is not None
            self.modes, self.stop = incoming.stop.modes, incoming.stop.to_json()
            self.made += 1
            missions.record = SimpleNamespace(
                mission_id=f"mission-{self.made}", state=MissionState.CAPTURING, reason="", preset=fields["preset"]
            )
            missions.mission, self._shot_s, self._paused = object(), 0.0, ""
            self.watcher.heard(ev.MissionStarted(shots_total=3))
        elif incoming.command == "resume":
            assert missions.offer is not None
            missions.record.state, missions.mission, missions.offer = MissionState.CAPTURING, object(), None
        elif incoming.command == "finish" and missions.mission is not None:
            self._over(MissionState.INCOMPLETE, fields["reason"])
        assert incoming.reply is not None
        data = {"mission_id": missions.record.mission_id} if error is None and missions.record else {}
        status = "ok" if error is None else "error"
        incoming.reply(json.dumps({"status": status, "error": error, "data": data}).encode())

    def pause(self, code: str) -> None:
        self._paused = code
        self.watcher.heard(ev.MissionPaused(code=code, reason=code))

    def _shoot(self, dt: float) -> None:
        if self.missions.mission is None:
            return
        if self.mode not in self.modes and not self._paused:
            self.pause("pilot")
        if not self._paused:
            self._shot_s += dt
            self.watcher.heard(ev.ShotStarted(shot=0, attempt=1, round=0, pitch_deg=0, yaw_deg=0, patience_s=1))
            if self._shot_s >= self.panorama_s:
                self._over(MissionState.COMPLETE, "every shot was accepted")

    def _over(self, state: MissionState, reason: str) -> None:
        self.watcher.heard(ev.MissionFinishing())
        self.missions.record.state, self.missions.record.reason = state, reason
        self.missions.mission = None

    def kill(self) -> None:
        """The process dies: the next one offers the mission that was under way."""
        if self.missions.mission is not None:
            self.missions.mission = None
            self.missions.offer = SimpleNamespace(stored_id=self.missions.record.mission_id, stop=self.stop)
        self.watcher = self.process()
        self.digest, self.stale = "", True
