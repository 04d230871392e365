"""What the attitude reports of a gimbal are worth, by the parameters of the autopilot that sends them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Final, Literal, TypeAlias

from panoexec.devices import YawFrame

Feedback: TypeAlias = Literal["earth", "vehicle", "body", "none"]
"""Kind of the attitude reports: measured in the earth, the vehicle or the body frame, or an echo of the setpoint
(`none`)."""

FRAMES: Final[dict[Feedback, YawFrame]] = {
    "earth": YawFrame.EARTH,
    "vehicle": YawFrame.VEHICLE,
    "body": YawFrame.BODY,
}
SERVO: Final = 1
BRUSHLESS_PWM: Final = 7
_ARDUPILOT_ECHOES: Final = {
    SERVO: "servos: the autopilot reports the angles that it demands, relative to the airframe",
    BRUSHLESS_PWM: "a PWM gimbal: the autopilot reports the angles that it demands",
}
_PX4_ECHOES: Final = {
    0: "AUX outputs: the autopilot reports the angles that it demands",
    1: "MAVLink gimbal protocol v1: the autopilot reports the angles that it demands",
}

Parameter: TypeAlias = Callable[[str], Awaitable[float | None]]


async def echo_by_parameters(parameter: Parameter, *, ardupilot: bool, device_id: int) -> tuple[str, YawFrame | None]:
    """Why the attitude that an autopilot itself reports is no measurement, by its own configuration.

    ArduPilot sets the flag of the vehicle frame even for servo angles, and PX4 none at all: the flags do not tell.

    Args:
        parameter: reads a parameter; None if it does not exist.
        ardupilot: whether it is an ArduPilot, else a PX4.
        device_id: gimbal device id.

    Returns:
        The reason, "" if no parameter says so; and the frame that the reports really have, None for the stated one.
    """
    name = f"MNT{max(device_id, 1)}_TYPE" if ardupilot else "MNT_MODE_OUT"
    value = await parameter(name)
    if value is None:
        return "", None
    why = (_ARDUPILOT_ECHOES if ardupilot else _PX4_ECHOES).get(int(value))
    if why is None:
        return "", None
    return f"{name} = {value:g} ({why})", YawFrame.BODY if ardupilot and value == SERVO else None
