"""Imported first by what runs for days: imports structlog without rich.

structlog takes rich along where it is installed, to draw tracebacks on terminals. That is 5 MB and 0.06 s of a daemon
that never draws one.
"""

from __future__ import annotations

import sys

if not {"rich", "structlog"} & sys.modules.keys():
    sys.modules["rich"] = None  # type: ignore[assignment]  # makes `import rich` fail
    try:
        import structlog  # noqa: F401
    finally:
        del sys.modules["rich"]
