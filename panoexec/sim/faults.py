"""Fault injection: named faults, combinable, at given moments or at random from the seed.

`NAME[=PART[,PART…]]`, where a PART is

* `0.3` (below 1): a probability: per photo for faults of single photos, per minute for the others;
* `20` or `20+5`: from 20 s after the first photo command, for 5 s (`t20+5`: 20 s after the start of the simulation);
  faults of single photos accept only the form with a duration, and affect every photo in that time;
* `#3`: at the third photo command (may be repeated);
* `x1.5`: the size, in the unit given in `FAULTS`.
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from panoexec.errors import UsageError
from panoexec.sim.physics.world import seeded


class Kind(StrEnum):
    """When a fault can occur."""

    PHOTO = "photo"
    """At single photo commands."""
    SPAN = "span"
    """For a period of time."""
    ONCE = "once"
    """At a moment; the effect is permanent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Description of a fault.

    Attributes:
        kind: when it can occur.
        text: its effect.
        size: default size.
        unit: unit of the size; "" if the fault has no size.
        duration_s: default duration of a `SPAN` fault.
        probability: default probability of a `PHOTO` fault.
    """

    kind: Kind
    text: str
    size: float = 0.0
    unit: str = ""
    duration_s: float = 5.0
    probability: float = 0.2


FAULTS: dict[str, Fault] = {
    "link-loss": Fault(kind=Kind.SPAN, text="no messages pass between vehicle and ground, in either direction"),
    "reboot": Fault(
        kind=Kind.ONCE,
        text="the autopilot reboots: its motors stop; silent for the size, then disarmed, with everything reset",
        size=3.0,
        unit="s",
    ),
    "attitude-stop": Fault(kind=Kind.SPAN, text="no gimbal attitude is sent"),
    "attitude-frozen": Fault(kind=Kind.SPAN, text="the gimbal repeats its last attitude with fresh time stamps"),
    "attitude-late": Fault(
        kind=Kind.SPAN, text="the gimbal's attitudes are held up on their way by the size", size=3.0, unit="s"
    ),
    "attitude-nan": Fault(kind=Kind.SPAN, text="the gimbal's attitude is NaN"),
    "gimbal-stuck": Fault(kind=Kind.SPAN, text="the motors do not move, commands are accepted"),
    "gimbal-slow": Fault(
        kind=Kind.SPAN, text="rates and accelerations are reduced", size=0.25, unit="factor", duration_s=30.0
    ),
    "drift": Fault(
        kind=Kind.PHOTO,
        text="the pointing drifts off while the shutter opens and returns (never at two photos in a row)",
        size=2.0,
        unit="deg",
        probability=0.3,
    ),
    "control-stolen": Fault(kind=Kind.ONCE, text="another station (255/190) takes gimbal control and points it ahead"),
    "mode-change": Fault(kind=Kind.ONCE, text="the pilot changes the flight mode to STABILIZE"),
    "photo-lost": Fault(kind=Kind.PHOTO, text="the photo command is lost: no acknowledgement, no photo"),
    "photo-refused": Fault(kind=Kind.PHOTO, text="the camera denies the photo command"),
    "capture-lost": Fault(
        kind=Kind.PHOTO, text="the photo is taken, its message is lost (a MAVLink camera resends it on request)"
    ),
    "capture-twice": Fault(kind=Kind.PHOTO, text="the photo is reported twice"),
    "storage-full": Fault(kind=Kind.SPAN, text="the storage is full", duration_s=math.inf),
    "gps-lost": Fault(
        kind=Kind.SPAN,
        text="the GPS has no fix; after 8 s the estimator gives its position up and the autopilot's failsafe lands",
    ),
    "rtl": Fault(kind=Kind.ONCE, text="a failsafe of the autopilot changes the flight mode to RTL"),
    "battery-low": Fault(kind=Kind.ONCE, text="the battery falls to the size", size=0.12, unit="fraction"),
    "gust": Fault(kind=Kind.SPAN, text="wind rises by the size", size=14.0, unit="m/s", duration_s=8.0),
    "photo-black": Fault(kind=Kind.PHOTO, text="the picture is black", probability=0.1),
    "photo-dark": Fault(kind=Kind.PHOTO, text="the picture is underexposed", size=3.0, unit="stops", probability=0.1),
    "photo-blur": Fault(
        kind=Kind.PHOTO, text="the picture is smeared along a line", size=6.0, unit="px", probability=0.1
    ),
    "photo-defocus": Fault(kind=Kind.PHOTO, text="the picture is out of focus", size=6.0, unit="px", probability=0.1),
    "photo-truncated": Fault(kind=Kind.PHOTO, text="the file ends early", probability=0.1),
    "photo-damaged": Fault(kind=Kind.PHOTO, text="sectors of the file are zero or other data", probability=0.1),
    "photo-swapped": Fault(
        kind=Kind.PHOTO,
        text="the file has the picture of a later photo, and that one's this",
        size=1.0,
        unit="photo",
        probability=0.1,
    ),
    "photo-stale": Fault(kind=Kind.PHOTO, text="the file is the previous photo's again", probability=0.1),
    "attitude-lie": Fault(
        kind=Kind.PHOTO,
        text="the camera looks elsewhere than the gimbal reports, about any axis",
        size=1.0,
        unit="deg",
        probability=0.1,
    ),
    "clock-jump": Fault(kind=Kind.ONCE, text="the vehicle's UTC jumps by the size", size=3600.0, unit="s"),
}

CONTENT_FAULTS = frozenset(
    {
        *("photo-black", "photo-dark", "photo-blur", "photo-defocus", "photo-truncated", "photo-damaged"),
        *("photo-swapped", "photo-stale", "attitude-lie"),
    }
)
"""Faults that only the content of the photos tells of."""

AUTOPILOT_FAULTS = frozenset({"link-loss", "reboot", "control-stolen", "mode-change", "gps-lost", "rtl", "battery-low"})
"""Faults of the embedded autopilot, not available with a real one."""

_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
_TIME = re.compile(rf"(t?)({_NUMBER})(?:\+({_NUMBER}))?")
_SIZE = re.compile(rf"x(-?{_NUMBER})")
_PHOTO = re.compile(r"#([1-9]\d*)")
_DEFAULT_START_S = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultSpec:
    """A parsed `NAME=VALUE`.

    Attributes:
        name: key of `FAULTS`.
        size: see `Fault.size`.
        probability: per photo or per minute; 0 = not random.
        photos: numbers of photo commands, from 1.
        spans: (start_s, end_s) after the first photo command.
        absolute_spans: (start_s, end_s) after the start of the simulation.
    """

    name: str
    size: float
    probability: float = 0.0
    photos: tuple[int, ...] = ()
    spans: tuple[tuple[float, float], ...] = ()
    absolute_spans: tuple[tuple[float, float], ...] = ()


def parse_fault(text: str) -> FaultSpec:
    """Parse `NAME[=VALUE]`.

    Raises:
        UsageError: unknown name or invalid value; the message lists the accepted forms.
    """
    name, _, value = text.partition("=")
    fault = FAULTS.get(name)
    if fault is None:
        raise UsageError(f"--fault {text}: unknown fault {name!r}; known are {', '.join(sorted(FAULTS))}")
    draft = _Draft(fault)
    for part in filter(None, value.split(",")):
        if not draft.take(part):
            raise _unreadable(text, part, fault)
    return draft.spec(name)


class _Draft:
    """A `FaultSpec` under construction."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self._size = fault.size
        self._probability = 0.0
        self._photos: list[int] = []
        self._spans: list[tuple[float, float]] = []
        self._absolute_spans: list[tuple[float, float]] = []

    def take(self, part: str) -> bool:
        """Parse one part; False if it is invalid."""
        if match := _SIZE.fullmatch(part):
            self._size = float(match[1])
            return bool(self._fault.unit)
        if match := _PHOTO.fullmatch(part):
            self._photos.append(int(match[1]))
            return self._fault.kind is Kind.PHOTO
        match = _TIME.fullmatch(part)
        return match is not None and self._take_number(bool(match[1]), float(match[2]), match[3])

    def _take_number(self, absolute: bool, number: float, duration: str | None) -> bool:
        if duration is None and not absolute and 0 < number < 1:
            self._probability = number
            return True
        if duration is None and self._fault.kind is Kind.PHOTO:
            # a number of 1 or more can only be a size
            self._size = number
            return bool(self._fault.unit) and not absolute
        spans = self._absolute_spans if absolute else self._spans
        spans.append((number, number + (self._fault.duration_s if duration is None else float(duration))))
        return True

    def spec(self, name: str) -> FaultSpec:
        """The parsed fault, with default times if none were given."""
        probability, spans = self._probability, self._spans
        if not (probability or self._photos or spans or self._absolute_spans):
            if self._fault.kind is Kind.PHOTO:
                probability = self._fault.probability
            else:
                spans = [(_DEFAULT_START_S, _DEFAULT_START_S + self._fault.duration_s)]
        return FaultSpec(
            name=name,
            size=self._size,
            probability=probability,
            photos=tuple(self._photos),
            spans=tuple(spans),
            absolute_spans=tuple(self._absolute_spans),
        )


def _unreadable(text: str, part: str, fault: Fault) -> UsageError:
    accepted = ["a probability below 1 like 0.3"]
    if fault.kind is Kind.PHOTO:
        accepted.append("photo numbers like #3")
    accepted.append("seconds START+DURATION like 20+5")
    if fault.unit:
        accepted.append(f"a size in {fault.unit} like x{fault.size:g}")
    return UsageError(f"--fault {text}: invalid part {part!r}; expected {', or '.join(accepted)}")


class Faults:
    """The faults of one run, queried by the simulation with simulated time.

    Random spans are drawn minute by minute, each fault with its own generator, so they do not depend on the queries.
    """

    def __init__(self, specs: Sequence[FaultSpec], *, seed: int) -> None:
        self._specs: dict[str, FaultSpec] = {spec.name: spec for spec in specs}
        self._rng = {spec.name: seeded(seed, f"fault/{spec.name}") for spec in specs}
        self._random_spans: dict[str, list[tuple[float, float]]] = {spec.name: [] for spec in specs}
        self._minutes_drawn: dict[str, int] = dict.fromkeys(self._specs, 0)
        self._fired: dict[str, int] = dict.fromkeys(self._specs, 0)
        self._first_photo_s = math.inf
        self._photo_hits: dict[str, bool] = dict.fromkeys(self._specs, False)
        self.photos = 0

    def __contains__(self, name: str) -> bool:
        return name in self._specs

    def size(self, name: str) -> float:
        """The size of a requested fault."""
        return self._specs[name].size

    def generator(self, name: str) -> random.Random:
        """The fault's own generator."""
        return self._rng[name]

    def photo_commanded(self, now_s: float) -> None:
        """Count a photo command and decide which photo faults apply to it."""
        self.photos += 1
        self._first_photo_s = min(self._first_photo_s, now_s)
        for name, spec in self._specs.items():
            if FAULTS[name].kind is Kind.PHOTO:
                drawn = self._rng[name].random() < spec.probability
                random_hit = drawn and not (name == "drift" and self._photo_hits[name])
                hit = self.photos in spec.photos or random_hit or self._in_span(spec, now_s)
                self._photo_hits[name] = hit

    def photo(self, name: str) -> bool:
        """Whether the fault applies to the last counted photo command."""
        return self._photo_hits.get(name, False)

    def active(self, name: str, now_s: float) -> bool:
        """Whether a `SPAN` fault is active."""
        if name not in self._specs:
            return False
        return self._in_span(self._specs[name], now_s) or any(
            start <= now_s < end for start, end in self._random(name, now_s)
        )

    def fires(self, name: str, now_s: float) -> bool:
        """Whether a `ONCE` fault occurs now; true once for each of its moments."""
        if name not in self._specs:
            return False
        spec, zero = self._specs[name], self._first_photo_s
        starts = [start for start, _ in spec.absolute_spans] + [zero + start for start, _ in spec.spans]
        starts += [start for start, _ in self._random(name, now_s)]
        if sum(start <= now_s for start in starts) > self._fired[name]:
            self._fired[name] += 1
            return True
        return False

    def _in_span(self, spec: FaultSpec, now_s: float) -> bool:
        zero = self._first_photo_s
        return any(start <= now_s < end for start, end in spec.absolute_spans) or any(
            zero + start <= now_s < zero + end for start, end in spec.spans
        )

    def _random(self, name: str, now_s: float) -> list[tuple[float, float]]:
        """The spans drawn at random up to now, minute by minute after the first photo command."""
        spec, zero = self._specs[name], self._first_photo_s
        drawn = self._random_spans[name]
        if spec.probability and now_s >= zero:
            rng, minute = self._rng[name], int((now_s - zero) / 60)
            while self._minutes_drawn[name] <= minute:
                start = zero + 60 * (self._minutes_drawn[name] + rng.random())
                if rng.random() < spec.probability:
                    drawn.append((start, start + FAULTS[name].duration_s))
                self._minutes_drawn[name] += 1
        return drawn
