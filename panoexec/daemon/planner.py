"""Planning in a separate process: it may take a core for minutes, and a vehicle may be flying meanwhile.

A thread could not be stopped, would hold up attitudes and answers, and its memory could not be bounded.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import signal
import sys
from typing import Final

from panoexec.daemon.errors import PlanningBudgetError
from panoexec.daemon.planner_process import Outcome, out_of_memory, out_of_time
from panoexec.errors import PanoexecError, PlanningError, UsageError
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.planning.model import Plan

_CHILD: Final = "from panoexec.daemon.planner_process import main; main()"
_KINDS: Final[dict[str, type[PanoexecError]]] = {
    "planning": PlanningError,
    "usage": UsageError,
    "budget": PlanningBudgetError,
    "": PanoexecError,
}
_CRASHES: Final = frozenset({-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGBUS})
_MOST_TOLD: Final = 300
# one thread: numpy's linear algebra starts one for each core, each with buffers of its own
_ENVIRONMENT: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}


async def plan_apart(spec: PlanSpec) -> Plan:
    """Compute a plan in a child process, which ends with this call, however that ends.

    Raises:
        PlanningError: no plan can satisfy the constraints.
        PlanningBudgetError: it needs more memory, processor time or images than `panoexec.daemon.planner_process`
            grants.
        PanoexecError: it failed otherwise.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", _CHILD),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=os.environ | _ENVIRONMENT,
    )
    try:
        out, complaint = await process.communicate(pickle.dumps(spec))
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    if process.returncode != 0 or not out:
        raise _ended(process.returncode, complaint.decode(errors="replace").strip())
    outcome = pickle.loads(out)  # noqa: S301  (from our own child)
    assert isinstance(outcome, Outcome)
    if outcome.plan is None:
        raise _KINDS[outcome.kind](outcome.text)
    return outcome.plan


def _ended(code: int | None, complaint: str) -> PanoexecError:
    """The error for a child that ended without an outcome.

    Args:
        code: of its exit.
        complaint: what it wrote to standard error.
    """
    if code == -signal.SIGKILL:
        return PlanningBudgetError(f"the kernel ended the planner: the computer is out of memory, or {out_of_time()}")
    # libraries that do not report a failed allocation to Python
    if code in _CRASHES or "memory" in _told(complaint).lower():
        return PlanningBudgetError(out_of_memory())
    if code == -signal.SIGXCPU:
        return PlanningBudgetError(out_of_time())
    return PanoexecError(f"planning ended with code {code}: {_told(complaint)[-_MOST_TOLD:]}")


def _told(complaint: str) -> str:
    """What a child complained of: of a traceback the end, as its lines of code may say anything."""
    return complaint.rpartition("\n")[2] if "Traceback (most recent call last)" in complaint else complaint
