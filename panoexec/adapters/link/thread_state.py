"""What Python keeps of the vendor's thread between its calls.

Measured (`python -m tests.bench savings`): a daemon that hears every report takes 1.7 to 2.0 % of a core with it and
1.8 to 2.5 % without it, a ratio of 1.09 to 1.25. The budget while capturing is 6 % (docs/mission.md), and up to 5.7 %
are used.
"""

from __future__ import annotations

import ctypes
import threading

_known = threading.local()


def keep_thread_state() -> None:
    """Keep the Python thread state of the calling thread, which Python did not create; may be called repeatedly.

    For each callback of such a thread ctypes makes a thread state, with memory of its own from the system, and destroys
    it afterwards (PyGILState_Ensure and _Release, which count), a hundred times a second. Counted once more, the state
    stays until the process ends: a few kilobytes a connection.
    """
    if not hasattr(_known, "kept"):
        _known.kept = ctypes.pythonapi.PyGILState_Ensure()
