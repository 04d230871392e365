"""Requests that nobody should send: seeded, endless, none of them one that may act."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.requests import MAX_PAYLOAD, REQUESTS, RefusedRequestError

WHOLE: dict[str, Any] = {
    "camera": "dji-x5s-15mm",
    "overlap": 0.2,
    "elevation_deg": [-40, 0],
    "azimuth_deg": [0, 90],
    "tolerance_deg": {"pitch": 0.1, "roll": 0.1, "yaw": 0.7},
    "reference": "north",
}
BELONGS = ("abort", "pause", "resume", "skip", "repeat", "finish")
"""Commands that are refused while no mission flies, however well they are written."""

JUNK: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1.5, "", "x", "\x00", "\ud800", "ü" * 50, [], {}, [[]], {"a": {"b": 1}}, "north\n"),
    *(10**30, -(10**30), 1e308, 5e-324, 2**63, 2**64, "9" * 300, "../../etc/passwd", "/dev/zero", "a" * 2000),
    *([1], [1, 2, 3], [30, -90], [None, 1], ["-90", "30"], [-90, 1e308], {"pitch": -1}, {"yaw": "1"}, {"": ""}),
)
COMMANDS = (*REQUESTS, "", "fly", "start/now", "START", "étoile", "a" * 200, "request", "get ", "status")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stranger:
    """One request to be published.

    Attributes:
        kind: how it was made.
        command: the end of its topic.
        payload: its bytes.
        retain: with the retain flag.
        response_topic: asked for, "" for none.
    """

    kind: str
    command: str
    payload: bytes
    retain: bool = False
    response_topic: str = ""


def strangers(seed: int) -> Iterator[Stranger]:
    """Requests for ever; each must be answered with an error and do nothing."""
    draw = random.Random(seed)
    makers: dict[str, Callable[[random.Random, int], bytes]] = {
        "random bytes": lambda d, _: d.randbytes(d.choice((0, 1, 2, 30, 300, 3000))),
        "mutated": _mutated,
        "wrong types": _wrong_types,
        "huge numbers": _huge_numbers,
        "deep nesting": _deep,
        "bad text": _bad_text,
        "keys twice": _keys_twice,
        "other documents": lambda d, _: json.dumps(d.choice(JUNK)).encode(),
        "too large": _too_large,
        "out of place": _out_of_place,
    }
    weights = (20, 25, 20, 10, 5, 8, 4, 6, 1, 5)
    last: Stranger | None = None
    number = 0
    while True:
        number += 1
        kind = draw.choices(tuple(makers), weights)[0]
        one = Stranger(
            kind=kind,
            command=draw.choice(COMMANDS) if draw.random() < 0.15 else draw.choice(tuple(REQUESTS)),
            payload=makers[kind](draw, number),
            response_topic=draw.choice(("", "panoexec/drone/response/me", "panoexec/drone/state", "panoexec/other/x")),
        )
        if draw.random() < 0.05:
            one = Stranger(kind="retained", command=one.command, payload=_good(number), retain=True)
        if last is not None and draw.random() < 0.05:
            one = Stranger(kind="again", command=last.command, payload=last.payload)
        if not _may_act(one):
            last = one
            yield one


def _may_act(one: Stranger) -> bool:
    if one.retain and not one.payload:
        return True  # that clears a topic and is no request
    try:
        parse_request(one.command, one.payload, retained=one.retain)
    except RefusedRequestError:
        return False
    return one.command not in BELONGS


def _good(number: int) -> bytes:
    return json.dumps({"transaction": number} | WHOLE).encode()


def _mutated(draw: random.Random, number: int) -> bytes:
    data = bytearray(_good(number))
    for _ in range(draw.randint(1, 6)):
        at = draw.randrange(len(data))
        what = draw.random()
        if what < 0.3:
            del data[at]
        elif what < 0.6:
            data.insert(at, draw.randrange(256))
        elif what < 0.8:
            data[at] = draw.randrange(256)
        elif what < 0.9:
            data[at:at] = data[at : at + 20]
        else:
            del data[at:]
        if not data:
            break
    return bytes(data)


def _wrong_types(draw: random.Random, number: int) -> bytes:
    document: dict[str, Any] = {"transaction": number} | WHOLE
    for _ in range(draw.randint(1, 3)):
        key = draw.choice((*document, "plan", "shot", "reason", "method", "order", "guarantee", "nothing", ""))
        document[key] = draw.choice(JUNK)
    return json.dumps(document).encode()


def _huge_numbers(draw: random.Random, number: int) -> bytes:
    digits = str(draw.randrange(1, 10**9)) * draw.choice((3, 50, 600, 6000))
    huge = draw.choice((digits, "-" + digits, "1e999", "-1e999", "1e" + digits[:10], "0." + digits, "NaN", "Infinity"))
    key = draw.choice(("transaction", "overlap", "shot", "elevation_deg"))
    return f'{{"transaction": {number}, "{key}": {huge}}}'.encode()


def _deep(draw: random.Random, number: int) -> bytes:
    depth = draw.choice((10, 500, 5_000, 30_000))
    opened, closed = draw.choice((("[", "]"), ('{"a":', "}")))
    inner = opened * min(depth, (MAX_PAYLOAD - 100) // (len(opened) + 1))
    inner += "1" + closed * (inner.count(opened[0])) if draw.random() < 0.7 else ""
    return f'{{"transaction": {number}, "{draw.choice(("plan", "camera", "x"))}": {inner}}}'.encode()


def _bad_text(draw: random.Random, number: int) -> bytes:
    data = bytearray(_good(number))
    bad = draw.choice((b"\xff", b"\xc3", b"\xed\xa0\x80", b"\xf8\x88\x80\x80\x80", b"\x00"))
    at = draw.randrange(len(data))
    data[at:at] = bad
    return bytes(data)


def _too_large(draw: random.Random, number: int) -> bytes:
    return json.dumps({"transaction": number, "reason": "x" * (MAX_PAYLOAD + draw.randrange(2000))}).encode()


def _out_of_place(draw: random.Random, number: int) -> bytes:
    """Right for some command, but no mission flies."""
    more = draw.choice(({}, {"reason": "because"}, {"shot": draw.randrange(100)}))
    return json.dumps({"transaction": f"out of place {number}"} | more).encode()


def _keys_twice(draw: random.Random, number: int) -> bytes:
    key = draw.choice(tuple(WHOLE))
    value = json.dumps(WHOLE[key])
    return f'{{"transaction": {number}, "{key}": {value}, "{key}": {value}}}'.encode()
