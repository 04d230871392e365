"""`check-config`: every problem at once, good ones shown, environment included."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from panoexec.cli.app import run

GOOD = '[vehicle]\nid = "kite"\nconnection = "udpin://0.0.0.0:14540"\n[mqtt]\nhost = "broker"\n'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "config.toml"
    path.write_text(GOOD)
    return path


def test_a_good_one_is_shown(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check-config", str(file)]) == 0
    out = capsys.readouterr().out
    for part in (f"{file} is valid", "kite on udpin://0.0.0.0:14540", "dji-x5s-15mm", "broker:1883"):
        assert part in out


def test_as_json_with_the_environments_changes(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOEXEC_MQTT__PORT", "8883")
    assert run(["check-config", str(file), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["ok"], document["problems"]) == (True, [])
    assert document["config"]["mqtt"]["port"] == 8883


def test_all_problems_come_at_once_one_line_each(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    secret = file.with_name("password")
    secret.write_text("x")
    secret.chmod(0o644)
    file.write_text(
        '[vehicle]\nconnection = "udpin:0.0.0.0"\n[camera]\nprofile = "no-such"\n'
        f'[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "{secret}"\nca_file = "{file.parent}/none.crt"\n'
        f'[web]\nlisten = "0.0.0.0:8090"\nusers_file = "{secret}"\ncert_file = "{secret}"\nkey_file = "{secret}"\n'
    )
    assert run(["check-config", str(file)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert len(lines) == 6
    assert all(line.startswith(f"panoexec: {file}: ") for line in lines)
    for part in (
        "readable by everybody on this computer",
        "ca_file",
        "no camera profile 'no-such'",
        "vehicle.connection",
        "web.users_file",
        "web.cert_file",
    ):
        assert part in err


def test_a_page_that_others_reach_needs_users(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text('[web]\nlisten = "0.0.0.0:8090"\n')
    assert run(["check-config", str(file)]) == 2
    assert "users_file" in capsys.readouterr().err


def test_problems_as_json(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text("[mqtt]\nport = 0\nhots = 1\n")
    assert run(["check-config", str(file), "--json"]) == 2
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False
    assert len(document["problems"]) == 2


def test_a_file_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check-config", str(tmp_path / "none.toml")]) == 2
    assert "cannot be read" in capsys.readouterr().err
