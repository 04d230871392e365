"""What goes wrong: named faults, combinable, at given moments or at random from the seed.

`NAME[=PART[,PART…]]`, where a PART is

* `0.3` (below 1): a probability: per photo for faults of single photos, per minute for the others;
* `20` or `20+5`: from 20 s after the first photo command on, for 5 s (`t20+5`: 20 s after the start of the simulation);
  faults of single photos take the form with a duration only, and strike every photo in that time;
* `#3`: at the third photo command (several may be given);
* `x1.5`: the size, in the unit that the table in `FAULTS` names.
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
    """When a fault can strike."""

    PHOTO = "photo"
    """At single photo commands."""
    SPAN = "span"
    """For a time."""
    ONCE = "once"
    """At a moment; what follows is not taken back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One thing that can go wrong.

    Attributes:
        kind: when it strikes.
        text: what it does.
        size: default size.
        unit: what the size means; "" if it has none.
        duration_s: default duration of a `SPAN`.
        probability: default of a `PHOTO` fault.
    """

    kind: Kind
    text: str
    size: float = 0.0
    unit: str = ""
    duration_s: float = 5.0
    probability: float = 0.2


FAULTS: dict[str, Fault] = {
    "link-loss": Fault(kind=Kind.SPAN, text="nothing passes between vehicle and ground, either way"),
    "reboot": Fault(
        kind=Kind.ONCE,
        text="the autopilot restarts: silent for the size, then boot time 0, intervals and control forgotten",
        size=3.0,
        unit="s",
    ),
    "attitude-stop": Fault(kind=Kind.SPAN, text="no gimbal attitude is sent"),
    "attitude-frozen": Fault(kind=Kind.SPAN, text="the gimbal repeats its last attitude with fresh time stamps"),
    "attitude-nan": Fault(kind=Kind.SPAN, text="the gimbal's attitude is NaN"),
    "gimbal-stuck": Fault(kind=Kind.SPAN, text="the motors do not move, commands are accepted"),
    "gimbal-slow": Fault(
        kind=Kind.SPAN, text="rates and accelerations are reduced", size=0.25, unit="factor", duration_s=30.0
    ),
    "drift": Fault(
        kind=Kind.PHOTO,
        text="the pointing runs away while the shutter opens and comes back (never at two photos in a row)",
        size=2.0,
        unit="deg",
        probability=0.3,
    ),
    "control-stolen": Fault(kind=Kind.ONCE, text="another station (255/190) takes the gimbal and points it ahead"),
    "mode-change": Fault(kind=Kind.ONCE, text="the pilot changes the flight mode to STABILIZE"),
    "photo-lost": Fault(kind=Kind.PHOTO, text="the photo command is lost on its way: no answer, no photo"),
    "photo-refused": Fault(kind=Kind.PHOTO, text="the camera refuses the photo command"),
    "capture-lost": Fault(
        kind=Kind.PHOTO, text="the photo is taken, its message is lost (a MAVLink camera repeats it when asked)"
    ),
    "capture-twice": Fault(kind=Kind.PHOTO, text="the photo is reported twice"),
    "storage-full": Fault(kind=Kind.SPAN, text="no room for another photo", duration_s=math.inf),
    "battery-low": Fault(kind=Kind.ONCE, text="the battery falls to the size", size=0.12, unit="fraction"),
    "gust": Fault(kind=Kind.SPAN, text="wind rises by the size", size=14.0, unit="m/s", duration_s=8.0),
    "clock-jump": Fault(kind=Kind.ONCE, text="the vehicle's UTC jumps by the size", size=3600.0, unit="s"),
}

AUTOPILOT_FAULTS = frozenset({"link-loss", "reboot", "control-stolen", "mode-change", "battery-low"})
"""Faults of the embedded autopilot, which a payload joined to a real one cannot have."""

_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
_TIME = re.compile(rf"(t?)({_NUMBER})(?:\+({_NUMBER}))?")
_SIZE = re.compile(rf"x(-?{_NUMBER})")
_PHOTO = re.compile(r"#([1-9]\d*)")
_DEFAULT_START_S = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultSpec:
    """One `NAME=VALUE` as parsed.

    Attributes:
        name: key of `FAULTS`.
        size: see `Fault.size`.
        probability: per photo or per minute; 0 = not random.
        photos: numbers of photo commands, from 1.
        spans: (start_s, end_s) after the first photo command.
        absolute_spans: likewise after the start of the simulation.
    """

    name: str
    size: float
    probability: float = 0.0
    photos: tuple[int, ...] = ()
    spans: tuple[tuple[float, float], ...] = ()
    absolute_spans: tuple[tuple[float, float], ...] = ()


def parse_fault(text: str) -> FaultSpec:
    """Read `NAME[=VALUE]`.

    Raises:
        UsageError: unknown name or unreadable value; the message lists what would be accepted.
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
    """A `FaultSpec` while it is read part by part."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self._size = fault.size
        self._probability = 0.0
        self._photos: list[int] = []
        self._spans: list[tuple[float, float]] = []
        self._absolute_spans: list[tuple[float, float]] = []

    def take(self, part: str) -> bool:
        """Read one part; False if it means nothing."""
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
            # a number from 1 on can only be meant as the size
            self._size = number
            return bool(self._fault.unit) and not absolute
        spans = self._absolute_spans if absolute else self._spans
        spans.append((number, number + (self._fault.duration_s if duration is None else float(duration))))
        return True

    def spec(self, name: str) -> FaultSpec:
        """What was read, with the defaults where nothing says when."""
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
    return UsageError(f"--fault {text}: cannot read {part!r}; accepted are {', '.join(accepted)}")


class Faults:
    """The faults of one run: asked by the simulation at every turn, with simulated time.

    Random spans are drawn minute by minute, from generators of their own, so they do not depend on who asks how often.
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
        """The size of a fault that was asked for."""
        return self._specs[name].size

    def generator(self, name: str) -> random.Random:
        """The fault's own generator."""
        return self._rng[name]

    def photo_commanded(self, now_s: float) -> None:
        """Count a photo command and decide which photo faults strike it."""
        self.photos += 1
        self._first_photo_s = min(self._first_photo_s, now_s)
        for name, spec in self._specs.items():
            if FAULTS[name].kind is Kind.PHOTO:
                drawn = self._rng[name].random() < spec.probability
                random_hit = drawn and not (name == "drift" and self._photo_hits[name])
                hit = self.photos in spec.photos or random_hit or self._in_span(spec, now_s)
                self._photo_hits[name] = hit

    def photo(self, name: str) -> bool:
        """Whether the fault strikes the photo command counted last."""
        return self._photo_hits.get(name, False)

    def active(self, name: str, now_s: float) -> bool:
        """Whether a `SPAN` fault is at work now."""
        if name not in self._specs:
            return False
        return self._in_span(self._specs[name], now_s) or any(
            start <= now_s < end for start, end in self._random(name, now_s)
        )

    def fires(self, name: str, now_s: float) -> bool:
        """Whether a `ONCE` fault strikes now; true once for each of its moments."""
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
