"""The configuration in force, and its reload at SIGHUP."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Protocol

import structlog

from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.logs import configure_logs

_RELOADABLE: Final = ("gimbal", "camera", "pointing", "guards", "pictures", "mission", "log")

_log = structlog.get_logger(__name__)


class Reloader(Protocol):
    """Reads the configuration again."""

    def __call__(self) -> Config:
        """The new configuration.

        Raises:
            PanoexecError: it is wrong; the old one stays in force.
        """
        ...


class LiveConfig:
    """Call it for the configuration as of now."""

    def __init__(
        self, config: Config, *, read: Reloader, notifier: SystemdNotifier, status_line: Callable[[], str]
    ) -> None:
        """Describe it.

        Args:
            config: checked, in force until a reload.
            read: reads it again.
            notifier: learns when a reload begins and ends.
            status_line: for the service manager.
        """
        self._config = config
        self._read = read
        self._notifier = notifier
        self._status_line = status_line

    def __call__(self) -> Config:
        """The configuration in force."""
        return self._config

    def reload(self) -> None:
        """Read the configuration again; sections that cannot change while running are kept, and logged."""
        self._notifier.reloading(time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000)
        try:
            new = self._read()
        except PanoexecError as error:
            _log.error("configuration invalid; the previous one stays in force", error=str(error))
        else:
            keep = {name: getattr(self._config, name) for name in type(new).model_fields if name not in _RELOADABLE}
            # [web] is another process's
            fixed = [name for name in keep if name != "web" and getattr(new, name) != keep[name]]
            self._config = new.model_copy(update=keep)
            configure_logs(self._config.log.level, self._config.log.format)
            _log.info("configuration reloaded", needs_restart=fixed)
        self._notifier.ready(self._status_line())
