"""Answers PTP operations as a camera without vendor extensions does. Pure logic, no sockets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from panoexec.sim.tethered import ptp
from panoexec.sim.tethered.card import Card, CardObject
from panoexec.sim.tethered.ptp import STORE, Answer, Kind, Op, Property

Reply: TypeAlias = tuple[Answer, bytes | None]
"""A response code, and the data before it."""
SHUTTER: Final = 0x500D
APERTURE: Final = 0x5007
ISO: Final = 0x500F
WHITE_BALANCE: Final = 0x5005
FOCUS_MODE: Final = 0x500A
FOCAL_LENGTH: Final = 0x5008
PROGRAM: Final = 0x500E
BATTERY: Final = 0x5001
_SHUTTER_SPEEDS: Final = (
    *(1, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 31, 40, 50, 62, 80, 100, 125, 166, 200, 250, 333, 500, 1000),
)
"""In 0.1 ms, by thirds of a stop as far as that unit allows."""
MANUAL: Final = 1
"""Value of exposure program, white balance and focus mode for: set by hand."""


def usual_properties(focal_length_mm: float) -> list[Property]:
    """The settings of a camera with a fixed lens: exposure in 0.1 ms, aperture and focal length in hundredths."""
    return [
        Property(code=BATTERY, kind=Kind.UINT8, value=80, choices=(80,)),
        Property(code=WHITE_BALANCE, kind=Kind.UINT16, value=2, choices=(2, 1, 4, 5, 6)),
        Property(code=APERTURE, kind=Kind.UINT16, value=560, choices=(280, 400, 560, 800, 1100)),
        Property(
            code=FOCAL_LENGTH,
            kind=Kind.UINT32,
            value=round(100 * focal_length_mm),
            choices=(round(100 * focal_length_mm),),
        ),
        Property(code=FOCUS_MODE, kind=Kind.UINT16, value=2, choices=(2, 1)),
        Property(code=SHUTTER, kind=Kind.UINT32, value=100, choices=_SHUTTER_SPEEDS),
        Property(code=PROGRAM, kind=Kind.UINT16, value=2, choices=(2, 1, 3, 4)),
        Property(code=ISO, kind=Kind.UINT16, value=100, choices=(100, 200, 400, 800, 1600)),
    ]


@dataclass(slots=True, kw_only=True)
class Responder:
    """One camera, whoever is connected.

    Attributes:
        card: what it stores; None: there is no card.
        shoot: starts a photo; returns the response code.
        free_images: how many photos fit, as it tells.
        properties: by code.
        vendor, model, serial: as told.
        session: whether a session is open.
        locked: codes of settings that cannot be changed now.
        on_setting: called after a setting was changed.
    """

    card: Card | None
    shoot: Callable[[], Answer]
    free_images: Callable[[], int] = lambda: 9999
    properties: dict[int, Property] = field(default_factory=dict)
    vendor: str = "panoexec"
    model: str = "simulated"
    serial: str = "1"
    session: bool = False
    locked: set[int] = field(default_factory=set)
    on_setting: Callable[[], None] = lambda: None

    def answer(self, code: int, params: Sequence[int], data: bytes) -> Reply:
        """Carry out an operation.

        Args:
            code: of the operation.
            params: its parameters.
            data: what was sent with it.

        Returns:
            The response code, and the data to send before it; None for an operation without data.
        """
        padded = (*params, 0, 0, 0)
        if code == Op.OPEN_SESSION:
            self.session = True  # also for a client that comes anew, whose session before was not closed
            return Answer.OK, None
        if code == Op.GET_DEVICE_INFO:
            return Answer.OK, ptp.device_info(
                properties=tuple(self.properties), vendor=self.vendor, model=self.model, serial=self.serial
            )
        if not self.session:
            return Answer.SESSION_NOT_OPEN, None
        action = self._actions().get(code)
        if action is not None:
            return action(padded, data)
        if code not in set(Op):
            return Answer.OPERATION_NOT_SUPPORTED, None
        return (Answer.STORE_NOT_AVAILABLE, None) if self.card is None else self._stored(Op(code), padded, self.card)

    def _actions(self) -> dict[int, Callable[[Sequence[int], bytes], Reply]]:
        """What works without a card."""
        return {
            Op.CLOSE_SESSION: lambda _params, _data: self._close(),
            Op.INITIATE_CAPTURE: lambda _params, _data: (self._capture(), None),
            Op.GET_STORAGE_IDS: lambda _params, _data: (Answer.OK, ptp.array32([] if self.card is None else [STORE])),
            Op.GET_PROPERTY_DESCRIPTION: lambda params, _data: self._told(params[0], lambda one: one.description()),
            Op.GET_PROPERTY_VALUE: lambda params, _data: self._told(params[0], lambda one: one.packed(one.value)),
            Op.SET_PROPERTY_VALUE: lambda params, data: (self._set(params[0], data), None),
        }

    def _close(self) -> Reply:
        self.session = False
        return Answer.OK, None

    def _capture(self) -> Answer:
        if self.card is None:
            return Answer.STORE_NOT_AVAILABLE
        return Answer.STORE_READ_ONLY if self.card.read_only else self.shoot()

    def _told(self, code: int, tell: Callable[[Property], bytes]) -> Reply:
        found = self.properties.get(code)
        return (Answer.PROPERTY_NOT_SUPPORTED, None) if found is None else (Answer.OK, tell(found))

    def _set(self, code: int, data: bytes) -> Answer:
        found = self.properties.get(code)
        if found is None:
            return Answer.PROPERTY_NOT_SUPPORTED
        value = found.unpacked(data)
        if len(found.choices) < 2 or code in self.locked:
            return Answer.ACCESS_DENIED
        if value is None or value not in found.choices:
            return Answer.INVALID_VALUE
        found.value = value
        self.on_setting()
        return Answer.OK

    def _stored(self, op: Op, params: Sequence[int], card: Card) -> Reply:
        """Operations on the card."""
        if op is Op.GET_STORAGE_INFO:
            if params[0] != STORE:
                return Answer.INVALID_STORAGE, None
            return Answer.OK, ptp.storage_info(
                size_bytes=card.size_bytes,
                free_bytes=card.size_bytes - card.used_bytes,
                free_images=self.free_images(),
                read_only=card.read_only,
            )
        if op in {Op.GET_OBJECT_HANDLES, Op.GET_NUM_OBJECTS}:
            handles = card.handles(storage=params[0], form=params[1], parent=params[2])
            return (Answer.INVALID_STORAGE, None) if handles is None else (Answer.OK, ptp.array32(handles))
        found = card.find(params[0])
        return (Answer.INVALID_HANDLE, None) if found is None else _object(op, found, params)


def _object(op: Op, found: CardObject, params: Sequence[int]) -> Reply:
    """Operations on a folder or a file."""
    if op is Op.GET_OBJECT_INFO:
        return Answer.OK, found.info()
    if op is Op.GET_THUMB or found.path is None:
        return (Answer.NO_THUMBNAIL if op is Op.GET_THUMB else Answer.INVALID_HANDLE), None
    try:
        with found.path.open("rb") as file:
            if op is Op.GET_OBJECT:
                return Answer.OK, file.read()
            file.seek(params[1])
            return Answer.OK, file.read(params[2])
    except OSError:
        return Answer.GENERAL_ERROR, None
