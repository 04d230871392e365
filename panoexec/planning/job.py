"""Planning as a job for another process: in goes what is to be planned, out comes a plan, or why there is none.

`main` is that process: a `Job` on its standard input, an `Outcome` on its standard output, both pickled, as both ends
are this very program. It imports the planner and nothing else, so that it begins at once.
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
from panoexec.optics import Camera
from panoexec.planning.make_plan import finished, make_plan
from panoexec.planning.model import Constraints, Plan, Timing
from panoexec.planning.order.shot_order import Order
from panoexec.planning.request import check_request

_NICE: Final = 5
_PR_SET_PDEATHSIG: Final = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What is to be planned.

    Attributes:
        camera, constraints: of the panorama.
        method, order: how.
        timing: what a shot costs.
        plan: a given plan, which is only to be judged.
    """

    camera: Camera
    constraints: Constraints
    method: str
    order: Order
    timing: Timing
    plan: Plan | None = None

    def done(self) -> Plan:
        """Compute; takes seconds, or minutes, and a core.

        Raises:
            PlanningError: no plan can satisfy the constraints.
        """
        if self.plan is None:
            return make_plan(self.camera, self.constraints, method=self.method, timing=self.timing, order=self.order)
        check_request(self.plan.camera, self.plan.constraints)
        return finished(self.plan, self.timing)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A plan, or why there is none: the kind of error, and its text."""

    plan: Plan | None = None
    kind: Literal["planning", "usage", ""] = ""
    text: str = ""


def outcome_of(job: Job) -> Outcome:
    """Plan; errors of ours become part of the outcome."""
    try:
        return Outcome(plan=job.done())
    except PlanningError as error:
        return Outcome(kind="planning", text=str(error))
    except UsageError as error:
        return Outcome(kind="usage", text=str(error))
    except PanoexecError as error:
        return Outcome(text=str(error))


def main() -> None:
    """The process."""
    with contextlib.suppress(OSError, AttributeError):  # where the parent is killed, nobody needs the plan any more
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    with contextlib.suppress(OSError):  # the service may not be allowed to
        os.nice(_NICE)
    job = pickle.loads(sys.stdin.buffer.read())  # noqa: S301  (from our own parent)
    sys.stdout.buffer.write(pickle.dumps(outcome_of(job)))
