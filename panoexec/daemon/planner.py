"""Planning in a process of its own: it may take a core for minutes, and a vehicle may be flying meanwhile.

A thread could not be stopped, would hold up attitudes and answers, and those of requests that nobody waits for any more
would pile up.
"""

from __future__ import annotations

import asyncio
import contextlib
import pickle
import sys
from typing import Final

from panoexec.daemon.planner_process import Outcome
from panoexec.errors import PanoexecError, PlanningError, UsageError
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.planning.model import Plan

MOST_S: Final = 300.0
"""Planning that takes longer is given up."""

_CHILD: Final = "from panoexec.daemon.planner_process import main; main()"
_KINDS: Final[dict[str, type[PanoexecError]]] = {"planning": PlanningError, "usage": UsageError, "": PanoexecError}


async def plan_apart(spec: PlanSpec) -> Plan:
    """Compute a plan in a child process, which ends with this call, however that ends.

    Raises:
        PlanningError: no plan can satisfy the constraints, or none was found in time.
        PanoexecError: it failed otherwise.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", _CHILD),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        async with asyncio.timeout(MOST_S):
            out, _ = await process.communicate(pickle.dumps(spec))
    except TimeoutError as error:
        raise PlanningError(
            f"planning took more than {MOST_S:g} s and was given up: ask for a smaller band or a shorter lens"
        ) from error
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    if process.returncode != 0 or not out:
        raise PanoexecError(f"planning ended with code {process.returncode}: out of memory?")
    outcome = pickle.loads(out)  # noqa: S301  (from our own child)
    assert isinstance(outcome, Outcome)
    if outcome.plan is None:
        raise _KINDS[outcome.kind](outcome.text)
    return outcome.plan
