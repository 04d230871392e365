"""Logging with structlog: readable on a terminal, sentences with fields in systemd's journal, else JSON; on stderr.

Modules log with `structlog.get_logger(__name__)`; mission and shot ids are bound by `structlog.contextvars`.
"""

from __future__ import annotations

import logging
import sys
from functools import partial
from typing import Literal, TextIO, TypeAlias

import structlog

from panoexec.journald import Journal, is_journal, sentence

LogLevel: TypeAlias = Literal["debug", "info", "warning", "error"]
LogFormat: TypeAlias = Literal["auto", "human", "json"]


def configure_logs(level: LogLevel = "info", log_format: LogFormat = "auto", stream: TextIO | None = None) -> None:
    """Set up structlog, and standard logging for libraries, once per process.

    Args:
        level: least severity that is shown.
        log_format: `auto` is readable text on a terminal, an entry of systemd's journal where stderr goes there, and
            JSON otherwise.
        stream: stderr if not given; stdout belongs to results.
    """
    out = sys.stderr if stream is None else stream
    human = out.isatty() if log_format == "auto" else log_format == "human"
    journal = Journal() if log_format == "auto" and not human and is_journal(out) else None
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        # journald stamps lines itself; a person reads local time, a machine UTC
        structlog.processors.TimeStamper(fmt="%H:%M:%S" if human else "iso", utc=not human),
    ]
    last: list[structlog.typing.Processor] = (
        [structlog.dev.ConsoleRenderer(colors=out.isatty())]
        if human
        else [
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(ensure_ascii=False) if journal is None else partial(_send, journal),
        ]
    )
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared,
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        wrapper_class=structlog.stdlib.BoundLogger,
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=False,
    )
    handler = _TextHandler(out, journal)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
        )
    )
    root = logging.getLogger()
    for old in root.handlers:
        if isinstance(old, _TextHandler):
            old.close()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # libraries that log too much at INFO
    for name in ("asyncio", "matplotlib", "PIL"):
        logging.getLogger(name).setLevel(logging.WARNING)


class _TextHandler(logging.StreamHandler[TextIO]):
    """Writes lines; an entry without text has gone to the journal."""

    def __init__(self, stream: TextIO, journal: Journal | None) -> None:
        super().__init__(stream)
        self._journal = journal

    def close(self) -> None:
        super().close()
        if self._journal is not None:
            self._journal.close()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = self.format(record)
            if text:
                self.stream.write(text + self.terminator)
                self.flush()
        except Exception:  # noqa: BLE001  (as in the class above: a log must not end what it tells of)
            self.handleError(record)


def _send(journal: Journal, logger: object, method: str, entry: structlog.typing.EventDict) -> str:
    """Send an entry to the journal; what it does not take is a line on stderr."""
    del logger, method
    return "" if journal.send(entry) else sentence(entry)
