"""Standard streams that never cost a result: any encoding, a reader that has gone, a question without an answer."""

from __future__ import annotations

import codecs
import getpass
import os
import sys
from contextlib import suppress
from io import TextIOWrapper
from typing import Final, TextIO

from panoexec.errors import UsageError

_HANDLER: Final = "panoexec.spell"
_SPELLED: Final = {
    "°": "deg", "±": "+/-", "×": "x", "·": "-", "²": "2", "³": "3", "½": "1/2", "µ": "u", "→": "->", "←": "<-",
    "↑": "^", "↓": "v", "…": "...", "–": "-", "—": "-", "−": "-", "≤": "<=", "≥": ">=", "≈": "~", "∞": "inf",
    "τ": "tau", "σ": "sigma", "β": "beta", "ψ": "psi", "Δ": "delta", "∪": "u", "‘": "'", "’": "'", "“": '"', "”": '"',
    "•": "*", "✓": "ok", "✗": "x", "█": "#", "░": ".", "─": "-", "━": "-", "│": "|", "\u00a0": " ", "\u202f": " ",
}  # fmt: skip
"""How a character is spelled where the stream's encoding does not have it."""


def _spell(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    # the replacement is encoded as well, so it must be ASCII
    return "".join(_SPELLED.get(one, "?") for one in error.object[error.start : error.end]), error.end


def make_lenient() -> None:
    """Let stdout and stderr spell out what their encoding does not have, instead of failing in the middle of a result.

    A terminal or a pipe may have any encoding (PYTHONIOENCODING, LANG=C, Windows code pages over ssh).
    """
    codecs.register_error(_HANDLER, _spell)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors=_HANDLER)


def can_encode_all(stream: TextIO) -> bool:
    """Whether a stream's encoding has every character (a UTF)."""
    encoding = (getattr(stream, "encoding", None) or "ascii").lower().replace("_", "-")
    return encoding.startswith("utf")


def is_broken_pipe(error: BaseException) -> bool:
    """Whether an error is that the reader of a pipe has closed it, also as the only kind in a group."""
    if isinstance(error, BaseExceptionGroup):
        return all(is_broken_pipe(one) for one in error.exceptions)
    return isinstance(error, BrokenPipeError)


def discard_output() -> None:
    """Send what is still written to nowhere: the reader has gone, and Python would say so once more at exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
            continue
        with suppress(OSError, ValueError):
            os.dup2(nowhere, stream.fileno())


def ask_password(prompt: str) -> str:
    """What is typed at a terminal, unseen.

    Raises:
        UsageError: nothing was (Ctrl-D, or a terminal that has gone).
    """
    try:
        return getpass.getpass(prompt)
    except EOFError:
        raise UsageError("no password was given: nothing was changed") from None
