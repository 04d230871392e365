"""`panoexec web`: users without a server, an address that needs users, and a missing package."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.web.users import read_users


def with_password(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(text + "\n"))


def test_users_are_added_changed_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "web-users"
    config = tmp_path / "config.toml"
    config.write_text(f'[web]\nusers_file = "{path}"\n', encoding="utf-8")
    with_password(monkeypatch, "correct horse")
    assert run(["web", "--config", str(config), "--add-user", "anna", "--role", "operator"]) == 0
    assert read_users(path)["anna"].role == "operator"
    with_password(monkeypatch, "battery staple")
    assert run(["web", "--users-file", str(path), "--add-user", "anna"]) == 0
    anna = read_users(path)["anna"]
    assert (anna.role, anna.matches("battery staple")) == ("viewer", True)
    before = path.read_bytes()
    with_password(monkeypatch, "short")
    assert run(["web", "--users-file", str(path), "--add-user", "bert"]) == 2
    assert run(["web", "--users-file", str(path), "--remove-user", "carl"]) == 2
    assert path.read_bytes() == before
    assert run(["web", "--users-file", str(path), "--remove-user", "anna"]) == 0
    assert read_users(path) == {}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--listen", "0.0.0.0:8090"), "--add-user"),
        (("--listen", "nowhere"), "HOST:PORT"),
        (("--users-file", "/no/such/file"), "--add-user"),
        (("--storage", "/no/such/folder"), "has no folder missions"),
        (("--add-user", "anna"), "--users-file"),
    ],
)
def test_what_cannot_be_is_one_line(options: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["web", *options]) == 2
    err = capsys.readouterr().err
    assert told in err
    assert len(err.splitlines()) == 1


def test_a_question_without_an_answer_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ended(prompt: str) -> str:
        raise EOFError(prompt)  # as of Ctrl-D

    monkeypatch.setattr("getpass.getpass", ended)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    assert run(["web", "--users-file", str(tmp_path / "web-users"), "--add-user", "anna"]) == 2
    assert capsys.readouterr().err == "panoexec: no password was given: nothing was changed\n"
    assert list(tmp_path.iterdir()) == []
