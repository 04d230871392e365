"""Keys of `watch`: a question, its answer, and a terminal that is left as it was."""

from __future__ import annotations

import asyncio
import os
import pty
import termios
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from panoexec.cli.watch import report_place
from panoexec.cli.watch_keys import HELP, KEYS, Keys, TerminalKeys, can_read_keys
from tests.waiting import eventually


class Desk:
    """Keys whose requests are kept, and a clock that stands."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.sent: list[str] = []
        self.drawn = 0
        self.keys = Keys("drone", send=self._send, changed=self._draw, now=lambda: self.now_s)

    async def _send(self, verb: str) -> str:
        self.sent.append(verb)
        await asyncio.sleep(0)
        return f"drone: {verb} done"

    def _draw(self) -> None:
        self.drawn += 1


async def settled() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


@pytest.mark.parametrize(("key", "verb"), [*KEYS.items(), ("A", "abort")])
async def test_a_key_asks_and_y_sends(key: str, verb: str) -> None:
    desk = Desk()
    assert desk.keys.note == HELP
    desk.keys.press(key)
    assert desk.keys.note == f"{verb} drone? y yes, any other key no"
    assert desk.sent == []
    desk.keys.press("y")
    assert "waiting for the answer" in desk.keys.note
    await settled()
    assert desk.sent == [verb]
    assert desk.keys.note == f"drone: {verb} done"
    desk.keys.press("y")
    await settled()
    assert desk.sent == [verb], "a second y is meant for nothing"
    assert desk.keys.note == HELP
    assert desk.drawn == 4


@pytest.mark.parametrize("other", ["n", "\r", "", "a", "p", "\x1b"])
async def test_every_other_key_withdraws_the_question(other: str) -> None:
    desk = Desk()
    desk.keys.press("a")
    desk.keys.press(other)
    assert desk.keys.note == "abort was not sent"
    desk.keys.press("y")
    await settled()
    assert desk.sent == []


async def test_a_late_y_is_not_meant_for_the_question() -> None:
    desk = Desk()
    desk.keys.press("a")
    desk.now_s += 10.1
    assert desk.keys.note == HELP
    desk.keys.press("y")
    await settled()
    assert desk.sent == []


async def test_what_waits_for_an_answer_ends_with_the_view() -> None:
    ended: list[str] = []

    async def never(verb: str) -> str:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append(verb)
        return verb

    keys = Keys("drone", send=never, changed=lambda: None, now=lambda: 0.0)
    keys.press("p")
    keys.press("y")
    await settled()
    assert ended == []
    await keys.close()
    assert ended == ["pause"]


async def typed(press: Callable[[str], None], act: Callable[[int], Awaitable[None]]) -> None:
    """A terminal whose other end `act` gets."""
    there, here = pty.openpty()
    try:
        with os.fdopen(here, "r") as stream:
            before = termios.tcgetattr(stream.fileno())
            with TerminalKeys(stream, press):
                await act(there)
            assert termios.tcgetattr(stream.fileno()) == before
    finally:
        os.close(there)


async def test_single_keys_are_read_and_the_terminal_is_put_back() -> None:
    pressed: list[str] = []

    async def act(there: int) -> None:
        os.write(there, b"p")
        await eventually(lambda: pressed == ["p"])
        # an arrow key, and a paste that would ask and confirm at once
        os.write(there, b"\x1b[A")
        await eventually(lambda: pressed == ["p", ""])
        os.write(there, b"ay")
        await eventually(lambda: pressed == ["p", "", ""])

    await typed(pressed.append, act)


def test_no_keys_are_read_from_pipes_and_terminals_of_others(tmp_path: Path) -> None:
    with (tmp_path / "file").open("w") as file:
        assert not can_read_keys(file)
    assert not can_read_keys(file), "closed"
    there, here = pty.openpty()
    with os.fdopen(here, "r") as stream:
        # a terminal in whose foreground this process is not: reading it would stop the process
        assert not can_read_keys(stream)
    os.close(there)


def test_the_place_of_the_report(tmp_path: Path) -> None:
    (tmp_path / "missions" / "m1").mkdir(parents=True)
    assert report_place("m1", "drone", tmp_path) == f"report: {tmp_path}/missions/m1/report.html"
    text = report_place("m2", "drone", tmp_path)
    assert text == "report: missions/m2/report.html on drone; here by panoexec fetch m2 --from HOST"
