"""The configured connection to the autopilot; with `serial = "auto"`, the serial port of the flight controller."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from serial.tools import list_ports

from panoexec.adapters.link.connection_url import ConnectionUrl, parse_connection
from panoexec.errors import LinkError
from panoexec.inputs.vehicle_sections import VehicleSection

BY_ID: Final = Path("/dev/serial/by-id")

AUTOPILOT_USB_IDS: Final[Mapping[tuple[int, int | None], str]] = {
    (0x1209, 0x5740): "ArduPilot, two USB ports",
    (0x1209, 0x5741): "ArduPilot",
    (0x1209, 0x1013): "Matek H743",
    (0x0483, 0x5740): "STM32 flight controller",
    (0x0483, 0xA32F): "ModalAI Flight Core v1",
    (0x0483, 0xA330): "ModalAI Flight Core v2",
    (0x1B8C, 0x0036): "PX4 FMU v6U",
    (0x1FC9, 0x001C): "NXP FMUK66",
    (0x1FC9, 0x0024): "NXP Tropic",
    (0x1FC9, 0x0025): "NXP MR-TROPIC",
    (0x26AC, None): "3DR, PX4 and mRo boards",
    (0x27AC, None): "VRBrain, F4BY",
    (0x2DAE, None): "CubePilot",
    (0x3162, None): "Holybro",
    (0x3163, None): "CUAV",
    (0x3185, None): "Auterion, ARK",
    (0x35A7, None): "ThePeach",
    (0x3643, None): "PX4 FMU v6X-RT, ZeroOne",
}
"""USB vendor and product ids of flight controllers; a product of None means any of that vendor.

Sources: ArduPilot's hwdef files (USB_VENDOR, and 0x1209 as default), QGroundControl's list of USB boards.
"""

TELEMETRY_USB_IDS: Final[Mapping[tuple[int, int | None], str]] = {
    (0x0403, None): "FTDI USB-to-serial",
    (0x10C4, 0xEA60): "CP210x USB-to-serial (telemetry radio)",
    (0x067B, None): "Prolific USB-to-serial",
    (0x1A86, None): "CH340 USB-to-serial",
}
"""USB-to-serial adapters, which may be connected to a flight controller's telemetry port or to anything else."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialPort:
    """One serial port as the operating system lists it.

    Attributes:
        device: its name, for example /dev/ttyACM0.
        vendor_id, product_id: USB ids, None if it is not a USB device.
        product: the USB product string, "" if there is none.
        stable_path: a name that survives re-plugging (/dev/serial/by-id/…), "" if there is none.
        interface: number of the USB interface; boards with two ports use MAVLink on the first.
        serial_number: of the USB device; ports with one number belong to one board.
    """

    device: str
    vendor_id: int | None = None
    product_id: int | None = None
    product: str = ""
    stable_path: str = ""
    interface: int = 0
    serial_number: str = ""

    @property
    def path(self) -> str:
        """The name to open: the stable path if there is one."""
        return self.stable_path or self.device

    def describe(self) -> str:
        """Text for messages: `/dev/ttyUSB0 (10c4:ea60, CP2102)`."""
        if self.vendor_id is None or self.product_id is None:
            return f"{self.device} (not USB)"
        return f"{self.device} ({self.vendor_id:04x}:{self.product_id:04x}, {self.product or 'unnamed'})"


def find_flight_controller(ports: Sequence[SerialPort], baud: int) -> ConnectionUrl:
    """Select the serial port of the flight controller.

    A port with a flight controller's USB ids takes precedence; of a board with two ports the first is used. Otherwise a
    single USB-to-serial adapter is used, as it is most likely connected to a telemetry port.

    Args:
        ports: all serial ports of the machine.
        baud: rate to open it with, bits a second (USB ports ignore it).

    Raises:
        LinkError: none or several were found; the message lists the ports and the config entry to write.
    """
    for known in (AUTOPILOT_USB_IDS, TELEMETRY_USB_IDS):
        found = _one_per_board([port for port in ports if _known_as(port, known)])
        if len(found) == 1:
            return ConnectionUrl(kind="serial", path=found[0].path, baud=baud)
        if found:
            raise LinkError(
                f'serial = "auto" found {len(found)} ports that may be the flight controller: '
                f'{_listing(found)}; name one: connection = "serial://{found[0].path}:{baud}"'
            )
    seen = f"found {_listing(ports)}" if ports else "this machine has no serial port"
    raise LinkError(
        f'serial = "auto" found no flight controller: {seen}; plug it in, or name the port: '
        f'connection = "serial:///dev/serial/by-id/DEVICE:{baud}"'
    )


def connection_of(section: VehicleSection) -> ConnectionUrl:
    """The connection of a configuration; searches the serial ports for `serial = "auto"`.

    Raises:
        LinkError: none or several ports may be the flight controller.
    """
    if section.serial == "auto":
        return find_flight_controller(list_serial_ports(), section.baud)
    if section.serial is not None:
        return parse_connection(f"serial://{section.serial}:{section.baud}")
    assert section.connection is not None
    return parse_connection(section.connection)


def list_serial_ports(by_id: Path = BY_ID) -> list[SerialPort]:
    """The serial ports of this machine, including UARTs that nothing is connected to."""
    stable = _stable_paths(by_id)
    out = []
    for port in list_ports.comports():
        interface = str(port.location or "").rpartition(":")[2].rpartition(".")[2]
        out.append(
            SerialPort(
                device=port.device,
                vendor_id=port.vid,
                product_id=port.pid,
                product=port.product or "",
                stable_path=stable.get(port.device, ""),
                interface=int(interface) if interface.isdigit() else 0,
                serial_number=port.serial_number or "",
            )
        )
    return sorted(out, key=lambda port: port.device)


def _stable_paths(by_id: Path) -> dict[str, str]:
    try:
        links = sorted(by_id.iterdir())
    except OSError:
        return {}
    return {str(link.resolve()): str(link) for link in links}


def _known_as(port: SerialPort, known: Mapping[tuple[int, int | None], str]) -> bool:
    if port.vendor_id is None:
        return False
    return (port.vendor_id, port.product_id) in known or (port.vendor_id, None) in known


def _one_per_board(ports: Iterable[SerialPort]) -> list[SerialPort]:
    """The first interface of each board; a port without a serial number counts as a board."""
    boards: dict[object, SerialPort] = {}
    for port in sorted(ports, key=lambda port: (port.interface, port.device)):
        board = (port.vendor_id, port.product_id, port.serial_number) if port.serial_number else port.device
        boards.setdefault(board, port)
    return sorted(boards.values(), key=lambda port: port.device)


def _listing(ports: Sequence[SerialPort]) -> str:
    return ", ".join(port.describe() for port in ports)
