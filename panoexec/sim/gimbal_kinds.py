"""Kinds of gimbals as they are sold and wired, by name: `--gimbal-kind NAME` of `simulate` and `dry-run`.

A kind only names settings of the simulation (`panoexec.sim.config`), so each of its numbers can be changed with
`--set`. How the gimbal then behaves on the wire is in `panoexec.sim.mavlink`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from panoexec.errors import UsageError
from panoexec.sim.config import SimConfig

DEFAULT_GIMBAL: Final = "mavlink"


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalKindSpec:
    """One kind.

    Attributes:
        text: what it does.
        vehicle: changed fields of `SimConfig`.
        gimbal: changed fields of `GimbalConfig`.
        autopilot: the autopilot that it needs; "" for any.
    """

    text: str
    vehicle: Mapping[str, Any] = field(default_factory=dict)
    gimbal: Mapping[str, Any] = field(default_factory=dict)
    autopilot: str = ""


GIMBAL_KINDS: Final[dict[str, GimbalKindSpec]] = {
    DEFAULT_GIMBAL: GimbalKindSpec(
        text="a MAVLink gimbal (component 154) that reports what it measures, 50 times a second"
    ),
    "siyi": GimbalKindSpec(
        text="driven by ArduPilot's own driver (MNT1_TYPE 8): no component of its own; what the autopilot reports is "
        "renewed ten times a second, in steps of 0.1° and 0.12 s old; it rests 0.3° beside its commands",
        vehicle={"mount": "driver"},
        gimbal={"report_hz": 10.0, "report_step_deg": 0.1, "report_age_s": 0.12, "steady_error_deg": 0.3},
        autopilot="ardupilot",
    ),
    "gremsy": GimbalKindSpec(
        text="a manager of its own beside the autopilot's: component 154 offers itself (280, 281) and refuses control, "
        "because the autopilot has it",
        vehicle={"gimbal_beside": "manager"},
    ),
    "own-manager": GimbalKindSpec(
        text="as gremsy, but the autopilot's manager refuses control, and the gimbal's own obeys",
        vehicle={"gimbal_beside": "only-manager"},
    ),
    "two": GimbalKindSpec(
        text="a second gimbal (component 171, device 2 of the autopilot) that looks around by itself and tells its "
        "attitude as well",
        vehicle={"gimbal_beside": "second"},
    ),
    "stranger": GimbalKindSpec(
        text="when the gimbal falls silent (fault attitude-stop), component 155 tells attitudes, always at the target",
        vehicle={"gimbal_beside": "stranger"},
    ),
    "echo": GimbalKindSpec(
        text="on outputs of the autopilot, which reports the angles that it demands: PX4's MNT_MODE_OUT 0, ArduPilot's "
        "MNT1_TYPE 7",
        vehicle={"mount": "echo"},
    ),
    "echo-untold": GimbalKindSpec(
        text="as echo, but the parameter cannot be read",
        vehicle={"mount": "echo", "mount_told": False},
    ),
    "echo-device": GimbalKindSpec(
        text="a MAVLink gimbal (component 154) that reports its target instead of what it measures",
        gimbal={"report_target": True},
    ),
    "servo": GimbalKindSpec(
        text="servos on ArduPilot's outputs (MNT1_TYPE 1): the autopilot reports the angles that it demands, relative "
        "to the airframe",
        vehicle={"mount": "servo"},
        autopilot="ardupilot",
    ),
    "ten-hertz": GimbalKindSpec(
        text="reports ten times a second, whatever it is asked for",
        gimbal={"report_hz": 10.0, "report_obeys": False},
    ),
    "asked": GimbalKindSpec(
        text="reports ten times a second, until component 154 itself is asked for more",
        gimbal={"report_hz": 10.0},
    ),
    "north-off": GimbalKindSpec(
        text="its compass is 60° off: it obeys and reports yaws from its own north, and tells the heading (delta_yaw) "
        "that it believes in",
        gimbal={"north_off_deg": 60.0},
    ),
}


def with_gimbal_kind(config: SimConfig, name: str) -> SimConfig:
    """The configuration with a kind of gimbal.

    Raises:
        UsageError: there is no such kind, or it needs the other autopilot; the message lists what there is.
    """
    kind = GIMBAL_KINDS.get(name)
    if kind is None:
        raise UsageError(f"--gimbal-kind {name}: no such kind; there are {', '.join(GIMBAL_KINDS)}")
    if kind.autopilot and config.autopilot != kind.autopilot:
        raise UsageError(f"--gimbal-kind {name} needs --autopilot {kind.autopilot}")
    return replace(config, gimbal=replace(config.gimbal, **kind.gimbal), **kind.vehicle)


def gimbal_kinds_text() -> str:
    """All kinds with what they do, one a line."""
    width = max(map(len, GIMBAL_KINDS))
    return "\n".join(f"{name:<{width}}  {kind.text}" for name, kind in GIMBAL_KINDS.items())
