"""Watching for another daemon that publishes as the same vehicle."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Final

TWIN_S: Final = 40.0
"""How long a foreign state counts; a daemon publishes its own at least every 15 s."""

BLIND_S: Final = 40.0
"""After so long without any state, the own one included, this client may not read it."""


class TwinWatch:
    """Recognizes the state of another process by its `boot_id`."""

    def __init__(self, boot_id: str, *, clock: Callable[[], float] = time.monotonic) -> None:
        """Describe it.

        Args:
            boot_id: of this process; "" recognizes nobody.
            clock: monotonic seconds.
        """
        self._boot_id = boot_id
        self._clock = clock
        self._heard_s = -math.inf
        self._watching_since_s = math.inf

    def watch(self) -> None:
        """Note that from now on this client gets the vehicle's states, its own ones too."""
        self._watching_since_s = self._clock()

    @property
    def blind(self) -> bool:
        """Whether not even the own state was heard: some brokers accept a subscription and deliver nothing."""
        return self._clock() - self._watching_since_s > BLIND_S

    @property
    def present(self) -> bool:
        """Whether another daemon was heard lately."""
        return self._clock() - self._heard_s < TWIN_S

    def hear(self, payload: bytes, *, retained: bool) -> bool:
        """Take a state of the vehicle; returns whether another daemon has just appeared."""
        if retained or not self._boot_id:
            return False
        try:
            state = json.loads(payload)
        except ValueError:
            return False
        boot_id = state.get("boot_id") if isinstance(state, dict) else None
        if not isinstance(boot_id, str):
            return False
        self._watching_since_s = math.inf  # it has eyes
        if boot_id == self._boot_id:
            return False
        new = not self.present
        self._heard_s = self._clock()
        return new
