"""Man page, completions and documents of the package, as they are built into it."""

from __future__ import annotations

import gzip
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from panoexec.cli.app import COMMANDS, module_of, parser_of
from tests.repository import ROOT

BASH = "usr/share/bash-completion/completions/panoexec"
ZSH = "usr/share/zsh/vendor-completions/_panoexec"
FISH = "usr/share/fish/vendor_completions.d/panoexec.fish"
MAN = "usr/share/man/man1/panoexec.1.gz"


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("tree")
    made(root)
    return root


def made(root: Path) -> None:
    command = [sys.executable, str(ROOT / "packaging" / "manual.py"), str(root)]
    subprocess.run(command, check=True, env={"PYTHONPATH": str(ROOT), "SOURCE_DATE_EPOCH": "1790000000"}, timeout=120)


def options(verb: str) -> set[str]:
    return {option for action in parser_of(verb, module_of(verb))._actions for option in action.option_strings}


def test_the_page_has_every_verb_with_every_option(tree: Path) -> None:
    text = gzip.decompress((tree / MAN).read_bytes()).decode()
    assert text.startswith('.TH PANOEXEC 1 2026-09-21 "panoexec ')
    sections = dict(zip(*[iter(re.split(r'^\.SS "panoexec (\S+)"$', text, flags=re.MULTILINE)[1:])] * 2, strict=True))
    assert [name.replace("\\", "") for name in sections] == list(COMMANDS)
    for name, section in sections.items():
        verb = name.replace("\\", "")
        plain = section.replace("\\-", "-")
        missing = [x for x in options(verb) - {"-h", "--help"} if not re.search(rf"^\\fB.*{x}\b", plain, re.MULTILINE)]
        assert missing == [], verb


@pytest.mark.skipif(shutil.which("man") is None, reason="needs man-db")
def test_the_page_is_sound(tree: Path) -> None:
    page = tree / "panoexec.1"
    page.write_bytes(gzip.decompress((tree / MAN).read_bytes()))
    command = ["man", "--warnings", "--local-file", str(page)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr == ""
    assert "panoexec watch" in done.stdout


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["wa"], {"watch"}),
        (["p"], {"plan", "pause"}),
        (["watch", "--pre"], {"--prefix"}),
        (["plan", "--guarantee", ""], {"coverage", "all"}),
        (["demo", "--"], options("demo")),
    ],
)
def test_bash_completes_verbs_options_and_choices(tree: Path, words: list[str], offered: set[str]) -> None:
    given = " ".join(f"'{word}'" for word in ["panoexec", *words])
    script = f"""
    set -eu -o pipefail
    source {tree / BASH}
    [ "$(complete -p panoexec)" = "complete -o bashdefault -F _shtab_panoexec panoexec" ]
    set +eu
    COMP_WORDS=({given}) COMP_CWORD={len(words)}
    _shtab_panoexec
    printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True, timeout=30)
    assert {word for word in done.stdout.split() if word != "-h"} == offered - {"-h"}


@pytest.mark.parametrize(("shell", "place"), [("bash", BASH), ("zsh", ZSH), ("fish", FISH)])
def test_completions_are_sound(tree: Path, shell: str, place: str) -> None:
    text = (tree / place).read_text(encoding="utf-8")
    for verb in COMMANDS:
        assert verb in text
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    subprocess.run([shell, "-n", str(tree / place)], check=True, timeout=30)


def test_they_are_the_same_each_time(tree: Path, tmp_path: Path) -> None:
    made(tmp_path)
    for place in (BASH, ZSH, FISH, MAN):
        assert (tmp_path / place).read_bytes() == (tree / place).read_bytes()


def test_links_lead_somewhere_in_the_package(tmp_path: Path) -> None:
    subprocess.run([ROOT / "packaging" / "documents", str(tmp_path / "panoexec")], check=True, timeout=60)
    there = tmp_path / "panoexec"
    assert not [path for path in there.rglob("*") if path.is_symlink()]
    pages = [*there.glob("*.md"), *(there / "docs").rglob("*.md")]
    links = [
        (page, target.partition("#")[0])
        for page in pages
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
        if not target.startswith(("http://", "https://"))
    ]
    assert len(links) > 100
    lost = [f"{page.relative_to(there)}: {target}" for page, target in links if not (page.parent / target).exists()]
    assert lost == []
