"""Logging with structlog: readable on a terminal, one JSON document per line for journald; always on stderr.

Modules log with `structlog.get_logger(__name__)`; mission and shot ids are bound by `structlog.contextvars`.
"""

from __future__ import annotations

import logging
import sys
from typing import Literal, TextIO, TypeAlias

import structlog

LogLevel: TypeAlias = Literal["debug", "info", "warning", "error"]
LogFormat: TypeAlias = Literal["auto", "human", "json"]


def configure_logs(level: LogLevel = "info", log_format: LogFormat = "auto", stream: TextIO | None = None) -> None:
    """Set up structlog, and standard logging for libraries, once per process.

    Args:
        level: least severity that is shown.
        log_format: `auto` is readable text on a terminal and JSON otherwise.
        stream: stderr if not given; stdout belongs to results.
    """
    out = sys.stderr if stream is None else stream
    human = out.isatty() if log_format == "auto" else log_format == "human"
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
        else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer(ensure_ascii=False)]
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
    handler = logging.StreamHandler(out)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # libraries that log too much at INFO
    for name in ("asyncio", "matplotlib", "PIL"):
        logging.getLogger(name).setLevel(logging.WARNING)
