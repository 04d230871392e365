"""Import structlog without rich; to be imported first by long-running processes.

Where rich is installed, structlog imports it to render tracebacks on terminals. The daemon never renders any, and the
import would cost it 5 MB and 0.06 s.
"""

from __future__ import annotations

import sys

if not {"rich", "structlog"} & sys.modules.keys():
    sys.modules["rich"] = None  # type: ignore[assignment]  # makes `import rich` fail
    try:
        import structlog  # noqa: F401
    finally:
        del sys.modules["rich"]
