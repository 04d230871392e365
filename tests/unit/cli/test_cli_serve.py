"""What the daemon does not carry with it, and what it does not begin with."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from panoexec.cli.app import run


def test_the_daemon_imports_nothing_that_it_never_needs() -> None:
    heavy = {"rich", "matplotlib", "PIL", "pymavlink", "panoexec.sim", "panoexec.dryrun", "panoexec.stitching"}
    program = f"import sys, panoexec.cli.serve, panoexec.daemon.daemon; print(*sorted(set(sys.modules) & {heavy}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_rich_is_there_for_those_who_draw() -> None:
    program = "import panoexec.cli.lean, structlog, rich.table; print(rich.table.Table.__name__)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["Table"]


def test_threads_share_one_heap_where_the_c_library_can() -> None:
    program = """
import ctypes, os, sys, threading
from panoexec.cli.one_heap import use_one_heap
done = use_one_heap()
gate = threading.Barrier(5)
def work():
    gate.wait()
    kept = [ctypes.create_string_buffer(200_000 // 4) for _ in range(8)]
    gate.wait()
threads = [threading.Thread(target=work) for _ in range(4)]
[t.start() for t in threads]
gate.wait(); gate.wait()
[t.join() for t in threads]
if done:
    ctypes.CDLL(None).malloc_stats()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr.count("Arena") <= 1


@pytest.mark.parametrize(("under_systemd", "code"), [(False, 2), (True, 78)])
@pytest.mark.parametrize(
    ("key", "value", "part"),
    [
        ("storage.path", "/proc/panoexec", "/proc/panoexec: cannot be used"),
        ("mqtt.password_file", "{folder}/open", "readable by everybody on this computer"),
        ("mqtt.ca_file", "{folder}/none", "cannot be read (No such file or directory)"),
    ],
)
def test_what_cannot_be_used_ends_it_with_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    key: str,
    value: str,
    part: str,
    under_systemd: bool,
    code: int,
) -> None:
    if under_systemd:
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "none"))
    else:
        monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    (tmp_path / "open").write_text("secret\n")
    (tmp_path / "open").chmod(0o644)
    monkeypatch.setattr("panoexec.cli.serve.configure_logs", lambda *_: None)  # logs are this process's
    monkeypatch.setattr("panoexec.cli.serve.open_at_once", lambda _: None)
    settings = {
        "vehicle.connection": "udpin://127.0.0.1:1",
        "storage.path": str(tmp_path),
        "mqtt.host": "127.0.0.1",
        "mqtt.username": "drone",
    }
    settings[key] = value.format(folder=tmp_path)
    config = tmp_path / "c.toml"
    config.write_text("".join(f'{name} = "{text}"\n' for name, text in settings.items()))
    assert run(["serve", "--config", str(config)]) == code
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert part in err
