"""The child process in which the daemon plans: in goes a `PlanSpec`, out comes an `Outcome`.

`main` reads the one from standard input and writes the other to standard output, both pickled, as both ends are this
very program. It imports the planner and neither pydantic nor asyncio, so that it starts at once.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import signal
import sys
from dataclasses import dataclass
from typing import Final, Literal

from panoexec.errors import PanoexecError, PlanningError, UsageError
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.planning.model import Plan

_NICE: Final = 5
_PR_SET_PDEATHSIG: Final = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A plan, or why there is none: the kind of error, and its text."""

    plan: Plan | None = None
    kind: Literal["planning", "usage", ""] = ""
    text: str = ""


def outcome_of(spec: PlanSpec) -> Outcome:
    """Plan; panoexec's own errors become part of the outcome."""
    try:
        return Outcome(plan=spec.plan())
    except PlanningError as error:
        return Outcome(kind="planning", text=str(error))
    except UsageError as error:
        return Outcome(kind="usage", text=str(error))
    except PanoexecError as error:
        return Outcome(text=str(error))


def main() -> None:
    """Run the process: read, plan, write."""
    with contextlib.suppress(OSError, AttributeError):  # where the parent is killed, nobody needs the plan any more
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    with contextlib.suppress(OSError):  # the service may not be allowed to
        os.nice(_NICE)
    spec = pickle.loads(sys.stdin.buffer.read())  # noqa: S301  (from our own parent)
    sys.stdout.buffer.write(pickle.dumps(outcome_of(spec)))
