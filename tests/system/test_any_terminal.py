"""Whatever a terminal or a pipe is like, a command's result arrives or nothing is said."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.cli.app import COMMANDS
from tests.repository import ROOT

PLAN = ("plan", "--camera", "dji-x5s-15mm", "--elevation", "-10", "10", "--azimuth", "0", "30")
LINES: list[tuple[str, ...]] = [
    *((name, "--help") for name in COMMANDS),
    PLAN,
    ("cameras",),
    ("cameras", "dji-x5s-15mm"),
    ("verify", "scenario-1-hdrpano"),
]


def command(arguments: tuple[str, ...], **environment: str) -> tuple[list[str], dict[str, str]]:
    return [sys.executable, "-m", "panoexec", *arguments], os.environ | environment


def run(arguments: tuple[str, ...], encoding: str) -> subprocess.CompletedProcess[bytes]:
    argv, environment = command(arguments, PYTHONIOENCODING=encoding)
    return subprocess.run(argv, capture_output=True, cwd=ROOT, env=environment, check=False, timeout=60)


@pytest.mark.parametrize("arguments", LINES[len(COMMANDS) :], ids=" ".join)
def test_an_encoding_costs_no_result(arguments: tuple[str, ...]) -> None:
    whole = run(arguments, "utf-8")
    plain = run(arguments, "ascii")
    assert plain.returncode == whole.returncode
    assert b"internal error" not in plain.stderr
    assert len(plain.stdout.splitlines()) == len(whole.stdout.splitlines())
    if "°" in whole.stdout.decode():
        assert "deg" in plain.stdout.decode("ascii")


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1"])
def test_a_western_code_page_is_used_as_far_as_it_goes(encoding: str) -> None:
    done = run(("cameras", "dji-x5s-15mm"), encoding)
    assert done.returncode == 0
    assert re.search(r"\d\d\.\d\d°", done.stdout.decode(encoding))


def test_json_says_the_same_in_ascii(tmp_path: Path) -> None:
    profile = tmp_path / "kamera.toml"
    shipped = (ROOT / "panoexec/profiles/dji-x5s-15mm.toml").read_text(encoding="utf-8")
    profile.write_text(shipped.replace('"DJI', '"Größe → ° DJI', 1), encoding="utf-8")
    documents = [json.loads(run(("cameras", str(profile), "--json"), name).stdout) for name in ("utf-8", "ascii")]
    assert documents[0] == documents[1]
    assert "Größe → °" in json.dumps(documents[0], ensure_ascii=False)


WITHOUT_A_READER = """
import gc, json, os, sys
from panoexec.__main__ import main
from panoexec.cli.app import COMMANDS, module_of

for name in COMMANDS:
    module_of(name)
gc.freeze()
for line in sys.stdin.buffer:
    reader, writer = os.pipe()
    os.close(reader)
    errors, said = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(writer, 1)
        os.dup2(said, 2)
        os.close(errors)
        sys.argv = ["panoexec", *json.loads(line)]
        main()  # the interpreter ends as it does after any command
    os.close(writer)
    os.close(said)
    with os.fdopen(errors, encoding="utf-8") as stream:
        told = stream.read()
    ended = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), told]
    os.write(1, json.dumps(ended).encode() + b"\\n")  # sys.stdout is as a new interpreter has it
"""
"""Runs each command in a process that is forked: starting an interpreter for each takes longer than all the rest."""


@pytest.fixture(scope="module")
def without_a_reader() -> Iterator[subprocess.Popen[str]]:
    """Takes commands, tells exit code and standard error of each; nobody reads their standard output."""
    argv, pipe = [sys.executable, "-c", WITHOUT_A_READER], subprocess.PIPE
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True, cwd=ROOT) as process:
        yield process
        assert process.stdin is not None
        process.stdin.close()


@pytest.mark.parametrize("arguments", LINES, ids=" ".join)
def test_a_reader_that_has_gone_is_no_error(
    without_a_reader: subprocess.Popen[str], arguments: tuple[str, ...]
) -> None:
    assert without_a_reader.stdin is not None
    assert without_a_reader.stdout is not None
    print(json.dumps(arguments), file=without_a_reader.stdin, flush=True)
    code, told = json.loads(without_a_reader.stdout.readline())
    assert told == ""
    assert code in {0, 1}


def test_a_reader_that_has_gone_is_no_error_for_a_whole_interpreter() -> None:
    argv, environment = command(("cameras",))
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            argv, stdout=writer, stderr=subprocess.PIPE, cwd=ROOT, env=environment, check=False, timeout=60
        )
    finally:
        os.close(writer)
    assert done.stderr == b""
    assert done.returncode in {0, 1}
