"""The import of a card into a mission: read, paired, judged, then stored."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

from panoexec.errors import PanoexecError, UsageError
from panoexec.importing.card import Card, CardPhoto, read_card
from panoexec.importing.content import contradictions
from panoexec.importing.expected import expected_photos
from panoexec.importing.pairing import MARGIN, Expected, Pairing, pair
from panoexec.mission.log.record import MissionRecord
from panoexec.planning.model import Plan
from panoexec.store.directory import MissionDirectory, mission_directories
from panoexec.store.journal import JournalFileError
from panoexec.store.landed_mission import LandedMission

How: TypeAlias = Literal["copy", "link", "move"]


class Confirm(Protocol):
    """Compares the content of paired photos where they overlap."""

    def __call__(
        self, pairs: Sequence[tuple[Expected, CardPhoto]], *, record: MissionRecord, plan: Plan
    ) -> tuple[Sequence[str], str]:
        """What contradicts the pairing, a line each; and what is known of the content, in words."""
        ...


class ContradictedCardError(UsageError):
    """The photos cannot be paired beyond doubt; nothing was changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CardImport:
    """What is known of a card and a mission, before anything is changed.

    Attributes:
        directory: of the mission.
        card: what is on it.
        pairing: the photos of the mission; only certain ones are made.
        missing: accepted photos that are neither on the card nor stored.
        strangers: photos that belong to no attempt of this mission.
        content: what is known of the photos' content, in words.
    """

    directory: MissionDirectory
    card: Card
    pairing: Pairing
    missing: tuple[Expected, ...]
    strangers: tuple[CardPhoto, ...]
    content: str = ""

    @property
    def rejected(self) -> int:
        """Paired photos whose attempts were rejected."""
        return sum(1 for expected, _ in self.pairing.of_mission if not expected.accepted)


def plan_import(directory: MissionDirectory, folder: Path, *, confirm: Confirm = contradictions) -> CardImport:
    """Pair the photos of a card with the attempts of a mission; blocks, and changes nothing.

    Args:
        directory: of the mission; other missions beside it may be on the card, too.
        folder: the card.
        confirm: compares the content of the paired photos.

    Raises:
        ContradictedCardError: two pairings are as good, none fits, or the content contradicts it.
        UsageError: the mission or the card cannot be read.
    """
    landed = LandedMission.read(directory)
    landed.close()
    own = expected_photos(landed.record)
    if not own:
        raise UsageError(f"{directory.path}: the mission has taken no photo")
    card = read_card(folder)
    found = pair(sorted([*own, *_others(directory)], key=lambda one: one.time_s), card.photos)
    if found is None:
        why = f"; {card.problems[0][0].name} {card.problems[0][1]}" if card.problems else ""
        raise ContradictedCardError(f"{folder}: no photo fits an attempt of {directory.mission_id}{why}")
    if not found.is_certain:
        raise ContradictedCardError(f"{folder}: {_doubt(found)}; nothing was imported")
    problems, content = confirm(found.of_mission, record=landed.record, plan=landed.plan)
    if problems:
        raise ContradictedCardError(f"{folder}: {'; '.join(problems)}; nothing was imported")
    paired = {(item.shot, item.attempt, item.photo) for item, _ in found.of_mission}
    stored = {(event.shot, event.attempt, event.photo) for event in landed.stored()}
    mine = {photo.path for _, photo in found.of_mission}
    return CardImport(
        directory=directory,
        card=card,
        pairing=found,
        missing=tuple(one for one in own if one.accepted and (one.shot, one.attempt, one.photo) not in paired | stored),
        strangers=tuple(photo for photo in card.photos if photo.path not in mine),
        content=content,
    )


def carry_out(plan: CardImport, *, how: How, told: Callable[[str], None] = lambda _: None) -> int:
    """Store the paired photos; each is whole, hashed and in the journal before its file on the card is removed.

    An import that is interrupted can be repeated: what is stored stays.

    Args:
        plan: of `plan_import`.
        how: copies, hard links where the file system has them, or moves.
        told: receives what could not be stored, a line each.

    Returns:
        How many photos are stored now.

    Raises:
        PanoexecError: the journal is in use or cannot be written.
    """
    return asyncio.run(_store(plan, how, told))


async def _store(plan: CardImport, how: How, told: Callable[[str], None]) -> int:
    landed, count = await asyncio.to_thread(LandedMission.read, plan.directory), 0
    with closing(landed):
        for item, photo in plan.pairing.of_mission:
            try:
                stored = await landed.photos.store(
                    photo.path,
                    raw=photo.raw,
                    shot=item.shot,
                    attempt=item.attempt,
                    photo=item.photo,
                    name=photo.path.name,
                    source="import",
                    how="link" if how == "link" else "copy",
                )
            except JournalFileError:
                raise
            except PanoexecError as error:
                told(str(error))
                continue
            await landed.flush()
            count += 1
            if how == "move":
                _remove(photo.path, plan.directory.path / stored.file)
                if photo.raw is not None and stored.raw:
                    _remove(photo.raw, plan.directory.path / stored.raw)
    return count


def _remove(path: Path, stored: Path) -> None:
    """Remove a file from the card, unless it is the stored one itself: the photos were copied into the mission."""
    with contextlib.suppress(OSError):  # a card that is write-protected: the photo is safe in both places
        if not path.samefile(stored):
            path.unlink()


def _others(directory: MissionDirectory) -> list[Expected]:
    """The photos of the missions beside it."""
    found: list[Expected] = []
    for other in mission_directories(directory.path.parent.parent):
        if other.path.resolve() == directory.path.resolve():
            continue
        with contextlib.suppress(PanoexecError):  # one that flies, or is damaged: it has no say
            landed = LandedMission.read(other)
            landed.close()
            found += expected_photos(landed.record, mission=other.mission_id)
    return found


def _doubt(found: Pairing) -> str:
    text = "two pairings are nearly as good"
    if found.rival is not None:
        item, photo = found.rival
        instead = "has no photo in the other one" if photo is None else f"may also be {photo.path.name}"
        text += f" (shot {item.shot}, attempt {item.attempt} {instead})"
    return f"{text}: the next one costs {found.margin:.1f} more, {MARGIN:g} are required"
