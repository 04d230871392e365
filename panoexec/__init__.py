"""panoexec: a multirotor takes a complete gigapixel panorama by itself.

The public interface for Python programs; docs/python.md shows it at work:

* `plan(camera, …)` computes a certified `Plan`; `Plan.save` and `Plan.load` write and read plan files.
* `verify(plan, …)` proves or refutes any plan and returns its `Certificate`.
* `load_profile(name)` gives the `CameraProfile` of a camera; `Camera` describes one directly.
* `open_mission(path)` reads the directory of a mission.

All angles are degrees, all overlaps fractions of the image area. Every error that is raised on purpose is a
`PanoexecError` whose text can be shown to a user. `import panoexec` itself loads none of the program: a name is
imported when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from panoexec.api.missions import Attempt, Attitude, Mission, MissionShot, open_mission
    from panoexec.api.plans import Plan, plan, verify
    from panoexec.errors import InputFileError, PanoexecError, PlanningError, UsageError
    from panoexec.inputs.camera_profiles import CameraProfile, load_profile
    from panoexec.optics import Camera
    from panoexec.planning.model import AngleBox, Certificate, GimbalLimits, Shot, Tolerance, Turning

__version__ = "0.1.0"

__all__ = [
    "AngleBox",
    "Attempt",
    "Attitude",
    "Camera",
    "CameraProfile",
    "Certificate",
    "GimbalLimits",
    "InputFileError",
    "Mission",
    "MissionShot",
    "PanoexecError",
    "Plan",
    "PlanningError",
    "Shot",
    "Tolerance",
    "Turning",
    "UsageError",
    "__version__",
    "load_profile",
    "open_mission",
    "plan",
    "verify",
]

_MODULES = {
    "panoexec.api.missions": ("Attempt", "Attitude", "Mission", "MissionShot", "open_mission"),
    "panoexec.api.plans": ("Plan", "plan", "verify"),
    "panoexec.errors": ("InputFileError", "PanoexecError", "PlanningError", "UsageError"),
    "panoexec.inputs.camera_profiles": ("CameraProfile", "load_profile"),
    "panoexec.optics": ("Camera",),
    "panoexec.planning.model": ("AngleBox", "Certificate", "GimbalLimits", "Shot", "Tolerance", "Turning"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


if not TYPE_CHECKING:  # a type checker knows the names from above, and finds the misspelt ones

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used (PEP 562)."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(_MODULE_OF[name]), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
