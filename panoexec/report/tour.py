"""The page of a tour: a map of its stations, what became of each, and hops from panorama to panorama.

The missions are looked for beside the tour's file, in `<storage>/missions`; what is not there is shown without.
"""

from __future__ import annotations

import base64
import html
import json
import math
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from panoexec import __version__
from panoexec.errors import InputFileError, PanoexecError
from panoexec.files import write_atomically
from panoexec.report.page import asset, embedded_json, policy_for, shared_asset, shared_script, viewer_styles
from panoexec.report.panorama import Panorama, best_picture
from panoexec.report.source import read_source
from panoexec.store.directory import MissionDirectory
from panoexec.store.tours import Stop, Tour, read_tour

_SCRIPTS: Final = ("pannellum/libpannellum.js", "pannellum/pannellum.js", "tour.js")


@dataclass(frozen=True, slots=True, kw_only=True)
class TourReport:
    """A page that was written.

    Attributes:
        path: the page.
        stops: how many stops the tour has.
        complete: how many of them have a complete panorama.
        panoramas: how many panoramas the page shows.
        missed: waypoints with a station at which no stop was made.
        notes: what could not be read.
    """

    path: Path
    stops: int
    complete: int
    panoramas: int
    missed: tuple[int, ...]
    notes: tuple[str, ...]


def write_tour_report(path: Path) -> TourReport:
    """Write the page beside a tour's file, as `<tour_id>.html`; blocks.

    Args:
        path: `<storage>/tours/<tour_id>.json`.

    Raises:
        InputFileError: the file cannot be read, or is no tour.
        UsageError: the page cannot be written.
    """
    tour = read_tour(path)
    missions = path.parent.parent / "missions"
    notes: list[str] = []
    stops: list[dict[str, Any]] = []
    pictures: dict[int, Panorama] = {}
    for stop in tour.stops:
        entry, picture = _stop(stop, missions, notes)
        stops.append(entry)
        if picture is not None:
            pictures[stop.number] = picture
    page = path.with_suffix(".html")
    write_atomically(page, _page(tour, stops, pictures))
    return TourReport(
        path=page,
        stops=len(stops),
        complete=sum(stop.outcome == "complete" for stop in tour.stops),
        panoramas=len(pictures),
        missed=tuple(sorted(set(tour.waypoints) - {stop.waypoint for stop in tour.stops})),
        notes=tuple(notes),
    )


def _stop(stop: Stop, missions: Path, notes: list[str]) -> tuple[dict[str, Any], Panorama | None]:
    """What the page shows of a stop, and its panorama."""
    entry: dict[str, Any] = {
        "number": stop.number,
        "waypoint": stop.waypoint,
        "preset": stop.preset,
        "outcome": stop.outcome,
        "reason": stop.reason,
        "arrived": stop.arrived,
        "at": [stop.latitude_deg, stop.longitude_deg],
        "mission": stop.mission_id,
        "name": "",
        "shots": None,
        "certified": None,
        "north": 0.0,
        "report": None,
        "panorama": False,
        "why": "no panorama was begun",
    }
    if stop.mission_id is None:
        return entry, None
    directory = MissionDirectory(missions / stop.mission_id)
    try:
        source = read_source(directory)
        manifest = source.manifest
        picture, why = best_picture(source)
        entry |= {
            "name": str(manifest.get("name") or ""),
            "shots": [len(source.photos), len(manifest["shots"])],
            "certified": _certified(manifest),
            "north": float(manifest["reference"]["yaw_north_deg"] or 0.0),
        }
    except (PanoexecError, KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError) as error:
        notes.append(f"stop {stop.number}: {error}")
        return entry | {"why": "its mission cannot be read"}, None
    if directory.report.is_file():
        entry["report"] = f"../missions/{stop.mission_id}/report.html"
    return entry | {"panorama": picture is not None, "why": "" if picture is not None else why}, picture


def _certified(manifest: Mapping[str, Any]) -> bool | None:
    certificate = manifest.get("certificate")
    return bool(certificate["certified"]) if isinstance(certificate, Mapping) else None


def _page(tour: Tour, stops: list[dict[str, Any]], pictures: Mapping[int, Panorama]) -> str:
    scripts = [shared_script("elements.js"), *(asset(name) for name in _SCRIPTS)]
    made = datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="seconds")
    data = {
        "tour": {"id": tour.tour_id, "vehicle": tour.vehicle, "ended": tour.ended, "waypoints": list(tour.waypoints)},
        "stops": [entry | {"at": _metres(entry["at"], stops)} for entry in stops],
        "made": {"version": __version__, "time": made},
    }
    blocks = [
        f'<script type="text/plain" id="panorama-{number}">{base64.b64encode(picture.jpeg).decode()}</script>'
        for number, picture in pictures.items()
    ]
    done = sum(entry["outcome"] == "complete" for entry in stops)
    parts = {
        "policy": html.escape(policy_for(scripts), quote=True),
        "title": html.escape(f"{tour.tour_id} · panoexec"),
        "noscript": html.escape(f"{done} of {len(stops)} stops of {tour.tour_id} have a complete panorama."),
        "style": f"<style>{shared_asset('theme.css')}{asset('report.css')}{viewer_styles()}</style>",
        "data": f'<script type="application/json" id="data">{embedded_json(json.loads(json.dumps(data)))}</script>',
        "pictures": "\n".join(blocks),
        "scripts": "\n".join(f"<script>{script}</script>" for script in scripts),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], asset("tour.html"))


def _metres(at: list[float], stops: list[dict[str, Any]]) -> list[float]:
    """North and east of the first stop, on a flat earth, metres; positions on the map and bearings follow from them."""
    latitude, longitude = stops[0]["at"]
    per_deg = math.pi / 180 * 6_371_000.0
    north = (at[0] - latitude) * per_deg
    east = (at[1] - longitude) * per_deg * math.cos(math.radians(latitude))
    if not (math.isfinite(north) and math.isfinite(east)):
        raise InputFileError("tour", ["a stop has no finite position"])
    return [round(north, 2), round(east, 2)]
