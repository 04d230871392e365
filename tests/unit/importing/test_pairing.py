"""A pairing that is called certain is right, whatever the card looks like."""

from __future__ import annotations

import math
import os
import random
from pathlib import Path

from panoexec.importing.card import CardPhoto
from panoexec.importing.pairing import Expected, Pairing, pair

CARDS = int(os.environ.get("PANOEXEC_CARDS", "60"))


def _a_card(rng: random.Random) -> tuple[list[Expected], list[CardPhoto], dict[int, Path]]:
    """Attempts, photos, and the photo of each attempt that has one on the card."""
    count = rng.randint(3, 45)
    even = rng.random() < 0.3
    low, high = (3.0, 3.0 + rng.choice([0.0, 0.1, 0.4])) if even else (rng.uniform(1.1, 3.0), rng.uniform(3.0, 9.0))
    now, expected, photos = 1.7e9, [], []
    offset_s, drift = rng.uniform(-20_000, 20_000), rng.uniform(-2e-5, 2e-5)
    resolution_s = rng.choice([1.0, 1.0, 0.01])
    mine: dict[int, Path] = {}
    lost, strange = rng.choice([0.0, 0.02, 0.15]), rng.choice([0.0, 0.02, 0.15])
    moments: list[tuple[float, int]] = []
    for number in range(count):
        now += rng.uniform(low, high)
        accepted = rng.random() > 0.1
        expected.append(
            Expected(mission="", shot=number, attempt=1, photo=1, time_s=now + rng.gauss(0, 0.03), accepted=accepted)
        )
        if rng.random() < lost:
            continue  # a stranger in the moment of a lost photo would be that photo, as far as times can tell
        moments.append((now + 0.2 + rng.uniform(-0.15, 0.15), number))
        if rng.random() < strange:
            moments.append((now + rng.uniform(0.3, 2.0), -1))
    if rng.random() < 0.5:
        moments += [(now + high * n, -1) for n in range(1, rng.randint(2, 4))]
    for place, (moment, number) in enumerate(sorted(moments)):
        stamp = moment + offset_s + drift * (moment - 1.7e9)
        shown = math.floor(stamp / resolution_s) * resolution_s
        path = Path(f"DSC{place:05d}.JPG")
        photos.append(CardPhoto(path=path, raw=None, taken_s=shown + resolution_s / 2, half_s=resolution_s / 2))
        if number >= 0:
            mine[number] = path
    return expected, photos, mine


def _is_right(found: Pairing, mine: dict[int, Path]) -> bool:
    return {item.shot: photo.path for item, photo in found.of_mission} == mine


def test_what_is_certain_is_right() -> None:
    rng, certain, wrong, seen = random.Random(31), 0, [], 0
    for number in range(CARDS):
        expected, photos, mine = _a_card(rng)
        found = pair(expected, photos)
        seen += 1
        if found is not None and found.is_certain:
            certain += 1
            if not _is_right(found, mine):
                wrong.append(number)
    assert seen == CARDS
    assert wrong == [], f"{len(wrong)} of {certain} certain pairings of {CARDS} cards are wrong"
    assert certain >= 0.3 * CARDS, "it is of use, too"
