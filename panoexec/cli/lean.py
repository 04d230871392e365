"""Import structlog without rich; to be imported first by long-running processes.

Where rich is installed, structlog imports it to render tracebacks on terminals. The daemon never renders any.

Measured (`python -m tests.bench savings`): 74.3 MB resident without rich, 77.4 MB with it. A daemon that flew 200
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
