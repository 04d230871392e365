"""Imported first by what runs for days: imports structlog without rich.

structlog imports rich where it is installed, to draw tracebacks on terminals, which a daemon never does.

Measured (`python -m tests.bench savings`): 74.3 MB resident without rich and 77.4 MB with it. A daemon that flew 200
missions holds 88 MB; the budget is 90 MB (docs/mission.md).
"""

from __future__ import annotations

import sys

if not {"rich", "structlog"} & sys.modules.keys():
    sys.modules["rich"] = None  # type: ignore[assignment]  # makes `import rich` fail
    try:
        import structlog  # noqa: F401
    finally:
        del sys.modules["rich"]
