import io
import json
import logging
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog

from panoexec import journald
from panoexec.journald import Journal, is_journal, sentence
from panoexec.logs import configure_logs

pytestmark = pytest.mark.usefixtures("restored_logs")


def test_json_is_one_document_a_line_with_bound_ids() -> None:
    out = io.StringIO()
    configure_logs("info", "json", out)
    structlog.contextvars.bind_contextvars(mission="m1", shot=3)
    structlog.get_logger("panoexec.x").info("shot accepted", error_deg=0.02)
    logging.getLogger("library").warning("old %s", "style")
    first, second = (json.loads(line) for line in out.getvalue().splitlines())
    assert first["event"] == "shot accepted"
    assert (first["mission"], first["shot"], first["error_deg"], first["level"]) == ("m1", 3, 0.02, "info")
    assert (second["event"], second["logger"]) == ("old style", "library")


def test_the_level_hides_what_is_below_it() -> None:
    out = io.StringIO()
    configure_logs("warning", "human", out)
    structlog.get_logger("panoexec").info("hidden")
    structlog.get_logger("panoexec").warning("seen")
    assert "hidden" not in out.getvalue()
    assert "seen" in out.getvalue()


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as there:
        there.settimeout(5)
        there.bind(str(tmp_path / "socket"))
        yield there


def fields_of(datagram: bytes) -> dict[str, str]:
    """The fields of an entry, read by the protocol's own rules."""
    found: dict[str, str] = {}
    while datagram:
        line, _, datagram = datagram.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if not equals:
            size = int.from_bytes(datagram[:8], "little")
            value, datagram = datagram[8 : 8 + size], datagram[8 + size + 1 :]
        assert name.decode() not in found
        found[name.decode()] = value.decode()
    return found


def test_the_journal_gets_a_sentence_and_fields(
    tmp_path: Path, listener: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a unit: stderr is a file that $JOURNAL_STREAM names."""
    monkeypatch.setattr(journald, "SOCKET", str(tmp_path / "socket"))
    with (tmp_path / "stderr").open("w") as stderr:
        there = os.fstat(stderr.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{there.st_dev}:{there.st_ino}")
        configure_logs("info", "auto", stderr)
        log = structlog.get_logger("panoexec.x")
        log.warning("request failed", command="pause", error="none\nis under way", unit=3, camera=False)
        first = fields_of(listener.recv(65536))
        try:
            int("broken")
        except ValueError:
            log.exception("shot_rejected", shot=4)
        second = fields_of(listener.recv(65536))
        logging.getLogger("library").info("old %s", "style")
        third = fields_of(listener.recv(65536))
        listener.close()
        (tmp_path / "socket").unlink()
        log.info("not lost")
        logging.getLogger().handlers[0].close()
    assert first["MESSAGE"] == "request failed: none\nis under way (command pause, unit 3, camera no)"
    assert (first["PRIORITY"], first["SYSLOG_IDENTIFIER"]) == ("4", "panoexec")
    assert (first["PANO_UNIT"], first["PANO_LOGGER"]) == ("3", "panoexec.x")
    assert "UNIT" not in first, "journald would take it for its own"
    assert second["MESSAGE"] == "shot rejected: ValueError: invalid literal for int() with base 10: 'broken' (shot 4)"
    assert (second["PRIORITY"], second["PANO_EVENT"]) == ("3", "shot_rejected")
    assert "Traceback" in second["PANO_EXCEPTION"]
    assert (third["MESSAGE"], third["PRIORITY"]) == ("old style", "6")
    assert (tmp_path / "stderr").read_text() == "not lost\n"


def test_a_terminal_a_pipe_and_another_file_are_no_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as there, (tmp_path / "file").open("w") as file:
        there.bind(str(tmp_path / "socket"))
        monkeypatch.setattr(journald, "SOCKET", str(tmp_path / "socket"))
        monkeypatch.delenv("JOURNAL_STREAM", raising=False)
        assert not is_journal(file)
        monkeypatch.setenv("JOURNAL_STREAM", "1:2")
        assert not is_journal(file)
        assert not is_journal(io.StringIO())


def test_values_of_any_kind_and_length_are_sent(tmp_path: Path, listener: socket.socket) -> None:
    journal = Journal(str(tmp_path / "socket"))
    entry = {"event": "links", "level": "info", "files": None, "é-x": "\ud800", "text": "x" * 100_000, "tasks": ["a"]}
    assert journal.send(entry)
    journal.close()
    fields = fields_of(listener.recv(300_000))
    assert len(fields["PANO_TEXT"]) == 48 * 1024
    assert (fields["PANO___X"], fields["PANO_TASKS"]) == ("?", "['a']")
    assert "PANO_FILES" not in fields
    assert sentence({"event": "ready", "vehicle": "drone"}) == "ready (vehicle drone)"
