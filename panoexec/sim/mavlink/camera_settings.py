"""The settings of the simulated MAVLink camera: its camera definition, and the extended parameter protocol.

Source: MAVLink's Camera Definition File; common.xml, messages 320 to 324.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree as ET

from panoexec.sim.mavlink.component import Component
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Message
from panoexec.sim.photos.exposure import Settings, metered

FILE_NAME: Final = "camera.xml"
_UINT32, _FLOAT = mavlink.MAV_PARAM_EXT_TYPE_UINT32, mavlink.MAV_PARAM_EXT_TYPE_REAL32
_FORMATS: Final = {_UINT32: "<I", _FLOAT: "<f"}
_NAMES: Final = {_UINT32: "uint32", _FLOAT: "float"}
_AUTO: Final = 0
_MANUAL: Final = 1
_HEADER_BYTES: Final = 10
_VALUE_AT: Final = 18
_VALUE_BYTES: Final = 128


@dataclass(frozen=True, slots=True)
class _Setting:
    """One parameter: type, text for people, choices (name and value); the first is the default."""

    kind: int
    text: str
    choices: tuple[tuple[str, float], ...]


def _speeds() -> tuple[tuple[str, float], ...]:
    return tuple((f"1/{one}", 1 / one) for one in (100, 125, 160, 200, 250, 320, 400, 500, 640, 800, 1000, 1250, 2000))


_SETTINGS: Final = {
    "CAM_MODE": _Setting(_UINT32, "Camera Mode", (("Photo", 0), ("Video", 1))),
    "CAM_EXPMODE": _Setting(_UINT32, "Exposure Mode", (("Auto", _AUTO), ("Manual", _MANUAL))),
    "CAM_SHUTTERSPD": _Setting(_FLOAT, "Shutter Speed", _speeds()),
    "CAM_APERTURE": _Setting(_FLOAT, "Aperture", (("F5.6", 5.6), ("F2.8", 2.8), ("F4.0", 4.0), ("F8.0", 8.0))),
    "CAM_ISO": _Setting(_UINT32, "ISO", tuple((str(one), one) for one in (100, 200, 400, 800))),
    "CAM_WBMODE": _Setting(_UINT32, "White Balance", (("Auto", _AUTO), ("Daylight", 4), ("Cloudy", 5))),
    "CAM_FOCUSMODE": _Setting(_UINT32, "Focus Mode", (("Auto", _AUTO), ("Manual", _MANUAL))),
}
_MANUAL_ONLY: Final = ("CAM_SHUTTERSPD", "CAM_APERTURE", "CAM_ISO")
"""What can be set only while the exposure mode is manual."""


def definition() -> bytes:
    """The camera definition as the camera serves it."""
    root = ET.Element("mavlinkcamera")
    head = ET.SubElement(root, "definition", version="1")
    ET.SubElement(head, "model").text = "simulated"
    ET.SubElement(head, "vendor").text = "panoexec"
    parameters = ET.SubElement(root, "parameters")
    for name, setting in _SETTINGS.items():
        default = f"{setting.choices[0][1]:.6g}"
        one = ET.SubElement(parameters, "parameter", name=name, type=_NAMES[setting.kind], default=default)
        ET.SubElement(one, "description").text = setting.text
        options = ET.SubElement(one, "options")
        for choice, value in setting.choices:
            option = ET.SubElement(options, "option", name=choice, value=f"{value:.6g}")
            if name == "CAM_EXPMODE" and value == _AUTO:
                excluded = ET.SubElement(option, "exclusions")
                for other in _MANUAL_ONLY:
                    ET.SubElement(excluded, "exclude").text = other
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text


class CameraSettings:
    """The values of these settings, set and told over MAVLink."""

    def __init__(self, component: Component) -> None:
        self._component = component
        self._values: dict[str, float] = {}
        self.forget()

    def forget(self) -> None:
        """Go back to the defaults, as at a start."""
        self._values = {name: setting.choices[0][1] for name, setting in _SETTINGS.items()}

    def receive(self, message: Message) -> None:
        """Handle a message of the extended parameter protocol; ignore others."""
        kind = message.get_type()
        if not kind.startswith("PARAM_EXT_") or not self._component.is_addressed(message):
            return
        if kind == "PARAM_EXT_REQUEST_LIST":
            for name in _SETTINGS:
                self._tell(name)
        elif kind == "PARAM_EXT_REQUEST_READ" and message.param_id in _SETTINGS:
            self._tell(message.param_id)
        elif kind == "PARAM_EXT_SET" and message.param_id in _SETTINGS:
            self._set(message.param_id, bytes(message.get_msgbuf()))

    def _set(self, name: str, frame: bytes) -> None:
        setting = _SETTINGS[name]
        # not pymavlink's `param_value`, which ends at the first zero byte; MAVLink 2 omits zeros at the end
        payload = frame[_HEADER_BYTES : _HEADER_BYTES + frame[1]].ljust(_VALUE_AT + _VALUE_BYTES, b"\0")
        (value,) = struct.unpack_from(_FORMATS[setting.kind], payload, _VALUE_AT)
        known = next((one for _, one in setting.choices if abs(one - value) <= 1e-4 * abs(one)), None)
        shut = name in _MANUAL_ONLY and self._values["CAM_EXPMODE"] != _MANUAL
        result = mavlink.PARAM_ACK_ACCEPTED
        if known is None or shut:
            result = mavlink.PARAM_ACK_VALUE_UNSUPPORTED
        else:
            self._values[name] = known
        packed = self._packed(name)
        self._component.send(mavlink.MAVLink_param_ext_ack_message(name.encode(), packed, setting.kind, result))

    def _tell(self, name: str) -> None:
        index = list(_SETTINGS).index(name)
        kind = _SETTINGS[name].kind
        self._component.send(
            mavlink.MAVLink_param_ext_value_message(name.encode(), self._packed(name), kind, len(_SETTINGS), index)
        )

    def _packed(self, name: str) -> bytes:
        kind, value = _SETTINGS[name].kind, self._values[name]
        return struct.pack(_FORMATS[kind], int(value) if kind == _UINT32 else value).ljust(_VALUE_BYTES, b"\0")

    def at(self, pitch_deg: float) -> Settings:
        """What a photo at that elevation is taken with; in exposure mode Auto the camera meters each by itself."""
        values = self._values
        settings = Settings(
            exposure_s=values["CAM_SHUTTERSPD"],
            f_number=values["CAM_APERTURE"],
            iso=int(values["CAM_ISO"]),
            manual_white_balance=values["CAM_WBMODE"] != _AUTO,
        )
        return settings if values["CAM_EXPMODE"] == _MANUAL else metered(settings, pitch_deg)
