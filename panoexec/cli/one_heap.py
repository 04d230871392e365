"""One heap for all threads, for what runs for days on a small computer.

The GNU C library gives each thread that allocates a heap of its own, up to eight a core, and hardly returns what was
freed in them. The daemon has a dozen threads that allocate little: one heap saves 5 MB and more of it (measured over a
mission of 206 shots), and what its threads wait for each other is not measurable.
"""

from __future__ import annotations

import ctypes
from typing import Final

_M_ARENA_MAX: Final = -8
"""`malloc.h` of glibc."""


def use_one_heap() -> bool:
    """Set it for this process, before its threads begin; False where the C library cannot."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # musl has none
        return False
    return bool(mallopt(_M_ARENA_MAX, 1))
