"""Tours on disk, `<storage>/tours/<tour_id>.json`: which panorama was flown at which waypoint, and what became of it.

Written before and after each stop, so that a process that is started again in the middle of a tour knows what is done.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from panoexec.errors import InputFileError, UsageError
from panoexec.files import write_atomically

FORMAT: Final = "panoexec.tour/1"
OPEN: Final = "open"
"""Outcome of a stop whose panorama is not over."""
_ID: Final = re.compile(r"tour-\d{8}T\d{6}\.\d{3}Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """An arrival at a waypoint with a panorama.

    Attributes:
        number: in the order of the tour, from 1.
        waypoint: number of the waypoint in the autopilot's mission.
        preset: what was to be flown.
        latitude_deg, longitude_deg: of the waypoint.
        mission_id: of the panorama; None if none was begun.
        outcome: `open`; then the state that the panorama ended in, or `skipped`.
        reason: why, for people; "" if nothing needs one.
        arrived: UTC, ISO 8601.
        left: the same; None while it is open.
        before_s: from the arrival until shooting began; None without.
        after_s: from the end of shooting until the autopilot went on; None without.
    """

    number: int
    waypoint: int
    preset: str
    latitude_deg: float
    longitude_deg: float
    mission_id: str | None = None
    outcome: str = OPEN
    reason: str = ""
    arrived: str = ""
    left: str | None = None
    before_s: float | None = None
    after_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Tour:
    """A tour.

    Attributes:
        tour_id: of the tour.
        vehicle: id of the vehicle.
        digest: of the autopilot's mission.
        waypoints: numbers of the waypoints with a panorama, in the order of the mission.
        ended: whether it is over.
        stops: in order.
    """

    tour_id: str
    vehicle: str
    digest: str
    waypoints: tuple[int, ...] = ()
    ended: bool = False
    stops: tuple[Stop, ...] = field(default=())

    @property
    def open_stop(self) -> Stop | None:
        """The stop whose panorama is not over."""
        return next((stop for stop in self.stops if stop.outcome == OPEN), None)

    def visits(self, waypoint: int) -> int:
        """How often a panorama was begun or skipped at a waypoint."""
        return sum(stop.waypoint == waypoint and stop.outcome != OPEN for stop in self.stops)

    def with_stop(self, stop: Stop) -> Tour:
        """The tour with a new stop, or with a stop changed."""
        others = [known for known in self.stops if known.number != stop.number]
        return replace(self, stops=(*sorted([*others, stop], key=lambda one: one.number),))


def tours_folder(storage: Path) -> Path:
    """Where tours are."""
    return storage / "tours"


def new_tour_id(storage: Path, *, now_utc_s: float) -> str:
    """`tour-` and the UTC time as the clock tells it, or the next free one."""
    moment = datetime.fromtimestamp(now_utc_s, UTC)
    while True:
        tour_id = f"tour-{moment:%Y%m%dT%H%M%S}.{moment.microsecond // 1000:03d}Z"
        if not (tours_folder(storage) / f"{tour_id}.json").exists():
            return tour_id
        moment += timedelta(milliseconds=1)


def write_tour(storage: Path, tour: Tour) -> None:
    """Write a tour; readers see the old or the new one.

    Raises:
        UsageError: the file cannot be written.
    """
    folder = tours_folder(storage)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be created: {error.strerror}") from error
    document = {"format": FORMAT, **asdict(tour)}
    write_atomically(folder / f"{tour.tour_id}.json", json.dumps(document, indent=1) + "\n")


def read_tour(path: Path) -> Tour:
    """Read a tour's file.

    Raises:
        InputFileError: it cannot be read, or is no tour; names what is wrong.
    """
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputFileError(str(path), [f"cannot be read: {error.strerror}"]) from error
    except (ValueError, RecursionError) as error:
        raise InputFileError(str(path), [f"is not JSON: {error}"]) from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputFileError(str(path), [f"is not a tour: its format must be {FORMAT}"])
    known = {one.name for one in fields(Stop)}
    try:
        stops = tuple(
            _checked_stop({name: value for name, value in stop.items() if name in known}) for stop in document["stops"]
        )
        return Tour(
            tour_id=_checked_id(document["tour_id"]),
            vehicle=str(document["vehicle"]),
            digest=str(document["digest"]),
            waypoints=tuple(int(number) for number in document["waypoints"]),
            ended=bool(document["ended"]),
            stops=stops,
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputFileError(str(path), [f"is not a whole tour: {type(error).__name__}: {error}"]) from error


def newest_tour(storage: Path) -> Tour | None:
    """The tour that was written last, by its name; None without one, or if it cannot be read."""
    paths = sorted(path for path in tours_folder(storage).glob("tour-*.json") if _ID.fullmatch(path.stem))
    for path in reversed(paths):
        try:
            return read_tour(path)
        except InputFileError:
            continue
    return None


def find_tour(text: str, storages: Sequence[Path]) -> Path | None:
    """The file of a tour that a person names by its path or its id; None if it is neither."""
    path = Path(text)
    if path.suffix == ".json" and path.is_file() and path.parent.name == "tours":
        return path
    if not _ID.fullmatch(path.name):
        return None
    places = [path.parent, *storages]
    found = (folder / f"{path.name}.json" for place in places for folder in (place, tours_folder(place)))
    return next((one for one in found if one.is_file()), None)


def _checked_id(value: object) -> str:
    if not isinstance(value, str) or not _ID.fullmatch(value):
        raise ValueError(f"tour_id is {value!r}")
    return value


def _checked_stop(data: dict[str, Any]) -> Stop:
    stop = Stop(**data)
    for name in ("number", "waypoint"):
        if not isinstance(getattr(stop, name), int):
            raise TypeError(f"{name} is no number")
    for name in ("latitude_deg", "longitude_deg"):
        if not isinstance(getattr(stop, name), int | float):
            raise TypeError(f"{name} is no number")
    mission = stop.mission_id
    if mission is not None and (not isinstance(mission, str) or "/" in mission or mission.startswith(".")):
        raise ValueError(f"mission_id is {mission!r}")
    return stop
