"""README, docs and help texts say only what is there: links, files, command lines, options, keys, benchmarks.

What a command prints is not looked at here; tables of faults, states and numbers have tests of their own.
"""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

import panoexec
from panoexec.cli.app import COMMANDS, module_of, parser_of
from panoexec.errors import UsageError
from panoexec.inputs.config import Config
from tests.repository import ROOT

DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
FENCE = re.compile(r"^```[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^ {4}(\S.*)$", re.MULTILINE)
INLINE = re.compile(r"`([^`\n]+)`")
PYTHON_OF_OTHERS = {"sim_vehicle.py", "mavproxy.py"}

each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


def text_of(document: Path) -> str:
    """The text without what it says is only planned."""
    return re.sub(
        r"^## Planned\n.*?(?=^## |\Z)", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )


def prose_of(document: Path) -> str:
    """The text without its blocks of code, a paragraph a line, so that what is broken over lines is whole."""
    return re.sub(r"(?<=\S)\n(?=[^\s|#*-])", " ", FENCE.sub("", text_of(document)))


def code_lines(text: str) -> list[str]:
    """Lines to be typed: fenced or indented by four, comments cut off, continued lines joined."""
    blocks = [*FENCE.findall(text), *INDENTED.findall(FENCE.sub("", text))]
    return [line.split("  #")[0].split(" # ")[0] for b in blocks for line in b.replace("\\\n", " ").splitlines()]


def commands(line: str) -> Iterator[list[str]]:
    """The arguments of each `panoexec` in a line of shell, the command first."""
    for command in re.split(r"&&|[;&|]", line):
        found = re.match(r"\s*(?:runuser -u panoexec -- )?(?:\w+=\S* )*(?:\.venv/bin/)?panoexec (.*)", command)
        if found:
            yield shlex.split(found[1])


def typed(document: Path) -> list[list[str]]:
    return [words for line in code_lines(text_of(document)) for words in commands(line)]


def mentioned(document: Path) -> list[list[str]]:
    """Also those that begin with the command: `dry-run --resume`."""
    spans = [
        f"panoexec {span}" if re.match(rf"({'|'.join(COMMANDS)}) --", span) else span
        for span in INLINE.findall(prose_of(document))
    ]
    return [words for span in spans for words in commands(span)]


def parser(command: str, *, lenient: bool = False) -> argparse.ArgumentParser:
    module = module_of(command)
    made = parser_of(command, module)
    if lenient:
        for action in made._actions:
            action.required = False
    return made


def parse(words: list[str], *, lenient: bool = False) -> None:
    """Read a command line as panoexec does.

    Raises:
        UsageError: it would be refused.
    """
    intermixed = getattr(module_of(words[0]), "INTERMIXED", False)
    made = parser(words[0], lenient=lenient)
    if words[1:] != ["--help"]:
        (made.parse_intermixed_args if intermixed else made.parse_args)(words[1:])


def slug(heading: str) -> str:
    """The anchor that a heading gets on a page."""
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").strip().lower()).replace(" ", "-")


def anchors(document: Path) -> set[str]:
    return {slug(found) for found in re.findall(r"^#+ (.*)$", FENCE.sub("", text_of(document)), re.MULTILINE)}


def test_the_readers_of_documents_find_what_is_in_them() -> None:
    """What finds nothing proves nothing."""
    readme = ROOT / "README.md"
    assert ["verify", "plan.json", "--tolerance-yaw", "1.0"] in typed(readme)
    assert ["doctor", "--config", "/etc/panoexec/config.toml"] in typed(readme)
    assert ["cameras"] in mentioned(readme)
    sitl = typed(ROOT / "docs" / "sitl.md")
    assert ["dry-run", "--sitl", "--speedup", "5"] in sitl
    assert len(sitl) == 6
    assert sum(len(typed(document)) for document in DOCUMENTS) >= 15
    assert "messages-to-the-pilot-statustext" in anchors(ROOT / "docs" / "mission.md")
    with pytest.raises(UsageError, match="--speed"):
        parse(["dry-run", "--speed", "20"])


@each_document
def test_command_lines_are_accepted(document: Path) -> None:
    for words in typed(document):
        parse(words)
    for words in mentioned(document):
        assert words[0] in COMMANDS, words
        if len(words) > 1:
            parse(words, lenient=True)


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_of_help_texts_are_accepted(command: str) -> None:
    text = module_of(command).__doc__
    assert text is not None
    # what an example does may stand beside it
    for line in re.findall(r"^  (panoexec .*?)(?: {2,}.*)?$", text, re.MULTILINE):
        for words in commands(line):
            parse(words)


@each_document
def test_options_exist(document: Path) -> None:
    known = {option for command in COMMANDS for action in parser(command)._actions for option in action.option_strings}
    for span in INLINE.findall(prose_of(document)):
        if span.startswith("--"):
            option = re.split(r"[ =]", span)[0]
            assert option in known, f"{document.name}: {span}"


@each_document
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", text_of(document)):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        there = document.parent / path if path else document
        assert there.exists(), f"{document.name}: {target}"
        if anchor:
            assert anchor in anchors(there), f"{document.name}: {target}"


@each_document
def test_every_page_is_in_the_index_of_the_site(document: Path) -> None:
    """`make docs` would find it later: a page that no menu leads to."""
    index = (ROOT / ".ci" / "site" / "index.md").read_text(encoding="utf-8").splitlines()
    page = str(document.relative_to(ROOT))
    assert page in index or page.startswith("docs/decisions/"), f"{page}: not in .ci/site/index.md"


@each_document
def test_files_of_the_repository_are_there(document: Path) -> None:
    """Any word of code that is a path below a folder of ours, or the name of a Python file."""
    text = text_of(document)
    code = " ".join([*INLINE.findall(prose_of(document)), *code_lines(text)])
    for word in code.split():
        if word.startswith("panoexec/drone/"):  # a topic
            continue
        if re.fullmatch(r"(panoexec|tests|docs|examples|config|systemd|packaging)/[\w./*-]+", word):
            assert list(ROOT.glob(word)), f"{document.name}: {word}"
        elif re.fullmatch(r"\w+\.py", word) and word not in PYTHON_OF_OTHERS:
            assert list((ROOT / "panoexec").rglob(word)), f"{document.name}: {word}"


@each_document
def test_targets_benchmarks_and_modules_are_there(document: Path) -> None:
    code = "\n".join([*INLINE.findall(prose_of(document)), *code_lines(text_of(document))])
    targets = set(re.findall(r"^([a-z-]+):", text_of(ROOT / "Makefile"), re.MULTILINE))
    assert set(re.findall(r"\bmake ([a-z-]+)", code)) <= targets
    benchmarks = {path.stem.removeprefix("bench_") for path in (ROOT / "tests" / "bench").glob("bench_*.py")}
    named = re.findall(r"python -m tests\.bench ([a-z ]+)", code) + re.findall(r'make bench ARGS="([a-z ]+)"', code)
    assert {name for names in named for name in names.split()} <= benchmarks
    for module in re.findall(r"`(panoexec(?:\.\w+)+)", text_of(document)):
        public = module.split(".")[1] in dir(panoexec)
        assert public or list(ROOT.glob(module.replace(".", "/") + "*")), f"{document.name}: {module}"


@each_document
def test_switches_and_keys_are_there(document: Path) -> None:
    """Environment variables of ours, and keys of the configuration as `[section] key` or PANOEXEC_SECTION__KEY."""
    text = text_of(document)
    code = [path.read_text(encoding="utf-8") for f in ("panoexec", "tests") for path in (ROOT / f).rglob("*.py")]
    sources = "\n".join(code)
    keys = re.findall(r"`\[(\w+)\] (\w+)", text)
    for name in re.findall(r"\bPANOEXEC_(\w+)", text):
        if "__" in name:
            keys.append(tuple(name.lower().split("__")))
        else:
            assert f'"PANOEXEC_{name}"' in sources, f"{document.name}: PANOEXEC_{name}"
    for section, key in keys:
        assert key in type(getattr(Config(), section)).model_fields, f"{document.name}: [{section}] {key}"


def test_every_campaign_is_in_the_table_and_is_run_at_full_length() -> None:
    table = re.findall(r"^\| `(PANOEXEC_\w+)=([^`]*)` \|", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    run = re.findall(r"^ *campaign (PANOEXEC_\w+) (\S+)", (ROOT / ".ci" / "campaigns").read_text(), re.MULTILINE)
    assert {name for name, _ in table} == {name for name, _ in run}
    lengths = dict(run)
    assert {name: size for name, size in table if size.isdigit() and lengths[name] != size} == {}
