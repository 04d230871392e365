"""Write man page and shell completions, made from the parsers of the command line.

Usage: manual.py ROOT, with panoexec and shtab importable. Below ROOT are then
usr/share/man/man1/panoexec.1.gz and the completions of bash, zsh and fish where these shells look for them.
SOURCE_DATE_EPOCH gives the date of the page.
"""

from __future__ import annotations

import argparse
import datetime as dt
import gzip
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import shtab

import panoexec
from panoexec.cli.app import COMMANDS, Parser, module_of

COMPLETIONS: Final = {
    "bash": "usr/share/bash-completion/completions/panoexec",
    "zsh": "usr/share/zsh/vendor-completions/_panoexec",
    "fish": "usr/share/fish/vendor_completions.d/panoexec.fish",
}
MAN: Final = "usr/share/man/man1/panoexec.1.gz"
_ABOUT: Final = """Plans and flies complete gigapixel panoramas by multirotor.

Exit codes: 0 done, 1 the result falls short, 2 wrong usage or input, 3 device or link failure, or a missing tool, 130
interrupted. The documentation is in /usr/share/doc/panoexec."""
_FOLDERS: Final = frozenset({"DIR", "STORAGE", "FOLDER"})


class _OneParser(Parser):
    """The parser of a verb, as shells and man pages need it: with all that the verb's own one has."""

    def __init__(self, **settings: object) -> None:
        super().__init__(
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            **settings,  # type: ignore[arg-type]
        )


def whole_parser() -> argparse.ArgumentParser:
    """One parser with a subparser a verb."""
    whole = _OneParser(prog="panoexec", description=_ABOUT)
    whole.add_argument("--version", action="version", version=panoexec.__version__, help="print the version")
    verbs = whole.add_subparsers(dest="verb", metavar="COMMAND", title="commands")
    for name, command in COMMANDS.items():
        module = module_of(name)
        one = verbs.add_parser(name, help=command.summary, description=(module.__doc__ or "").strip())
        module.add_arguments(one)
        for action in _all_actions(one):
            if isinstance(action.type, type) and issubclass(action.type, Path):
                action.complete = shtab.DIR if action.metavar in _FOLDERS else shtab.FILE  # type: ignore[attr-defined]
    return whole


def _all_actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    yield from parser._actions  # noqa: SLF001  (argparse has no other way)


def man_page(parser: argparse.ArgumentParser, when: dt.date) -> str:
    """The manual page, as roff (man(7)): a section a verb, with its description, examples and options."""
    lines = [
        f'.TH PANOEXEC 1 {when.isoformat()} "panoexec {panoexec.__version__}" "panoexec"',
        ".SH NAME",
        "panoexec \\- complete gigapixel panoramas by multirotor",
        ".SH SYNOPSIS",
        ".B panoexec",
        r"\fICOMMAND\fR [\fIoptions\fR]",
        ".SH DESCRIPTION",
        *_text(parser.description or ""),
        ".SH COMMANDS",
    ]
    (verbs,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))  # noqa: SLF001
    for name, one in verbs.choices.items():
        lines += [f'.SS "panoexec {_escaped(name)}"', *_text(one.description or "")]
        for group in one._action_groups:  # noqa: SLF001
            actions = [action for action in group._group_actions if action.dest != "help"]  # noqa: SLF001
            if actions and group.title not in ("options", "positional arguments"):
                lines += [".PP", rf"\fB{_escaped(group.title or '')}\fR"]
            for action in actions:
                lines += [".TP", _option(action), _escaped(" ".join((action.help or "").split()))]
    return "\n".join(lines) + "\n"


def _option(action: argparse.Action) -> str:
    """An option with its values, as argparse shows them: `--elevation MIN MAX`."""
    formatter = argparse.HelpFormatter("panoexec")
    shown = formatter._format_action_invocation(action)  # noqa: SLF001
    return rf"\fB{_escaped(shown)}\fR"


def _text(text: str) -> list[str]:
    """Paragraphs; lines that are indented stay as they are."""
    lines: list[str] = []
    for paragraph in text.strip().split("\n\n"):
        lines.append(".PP")
        literal = False
        for line in paragraph.splitlines():
            if line.startswith(" ") != literal:
                literal = not literal
                lines.append(".nf" if literal else ".fi")
            lines.append(_escaped(line))
        if literal:
            lines.append(".fi")
    return lines


def _escaped(text: str) -> str:
    r"""Text for roff: a hyphen that is typed is \-, and no line begins with a request."""
    text = text.replace("\\", r"\e").replace("-", r"\-").replace("%%", "%")
    return rf"\&{text}" if text.startswith((".", "'")) else text


def write(root: Path) -> None:
    """Write everything below a folder."""
    stamp = int(os.environ.get("SOURCE_DATE_EPOCH", "0")) or int(dt.datetime.now(dt.UTC).timestamp())
    parser = whole_parser()
    for shell, place in COMPLETIONS.items():
        _put(root / place, shtab.complete(parser, shell).encode())
    page = man_page(parser, dt.datetime.fromtimestamp(stamp, dt.UTC).date())
    _put(root / MAN, gzip.compress(page.encode(), mtime=0))


def _put(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    path.chmod(0o644)


if __name__ == "__main__":
    if len(sys.argv) != 2 or re.match("-", sys.argv[1]):
        raise SystemExit(__doc__)
    write(Path(sys.argv[1]))
