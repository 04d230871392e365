import io
import json
import logging

import pytest
import structlog

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
