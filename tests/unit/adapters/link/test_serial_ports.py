from pathlib import Path
from types import SimpleNamespace

import pytest

from panoexec.adapters.link import serial_ports
from panoexec.adapters.link.serial_ports import SerialPort, connection_of, find_flight_controller, list_serial_ports
from panoexec.errors import LinkError
from panoexec.inputs.vehicle_sections import VehicleSection

PIXHAWK = SerialPort(
    device="/dev/ttyACM0",
    vendor_id=0x1209,
    product_id=0x5740,
    product="Pixhawk1",
    stable_path="/dev/serial/by-id/usb-ArduPilot_Pixhawk1_42-if00",
    serial_number="42",
)
PIXHAWK_SECOND = SerialPort(
    device="/dev/ttyACM1",
    vendor_id=0x1209,
    product_id=0x5740,
    product="Pixhawk1",
    stable_path="/dev/serial/by-id/usb-ArduPilot_Pixhawk1_42-if02",
    interface=2,
    serial_number="42",
)
CUBE = SerialPort(device="/dev/ttyACM2", vendor_id=0x2DAE, product_id=0x1016, product="CubeOrange", serial_number="7")
RADIO = SerialPort(device="/dev/ttyUSB0", vendor_id=0x10C4, product_id=0xEA60, product="CP2102")
FTDI = SerialPort(device="/dev/ttyUSB1", vendor_id=0x0403, product_id=0x6001, product="FT232R")
UART = SerialPort(device="/dev/ttyAMA0")
GPS = SerialPort(device="/dev/ttyACM3", vendor_id=0x1546, product_id=0x01A9, product="u-blox GNSS")


@pytest.mark.parametrize(
    ("ports", "path"),
    [
        ([PIXHAWK], PIXHAWK.stable_path),
        ([PIXHAWK_SECOND, PIXHAWK], PIXHAWK.stable_path),
        ([UART, RADIO, GPS, CUBE], "/dev/ttyACM2"),
        ([UART, GPS, RADIO], "/dev/ttyUSB0"),
    ],
    ids=["by stable name", "two ports of one board", "autopilot beats adapters", "a lone adapter"],
)
def test_finds_the_flight_controller(ports: list[SerialPort], path: str) -> None:
    url = find_flight_controller(ports, 921_600)
    assert url.mavsdk == f"serial://{path}:921600"


@pytest.mark.parametrize(
    ("section", "url"),
    [
        (VehicleSection(serial="auto", baud=57_600), "serial:///dev/ttyACM2:57600"),
        (VehicleSection(serial="/dev/ttyAMA0", baud=115_200), "serial:///dev/ttyAMA0:115200"),
        (VehicleSection(connection="udpin://0.0.0.0:14551"), "udpin://0.0.0.0:14551"),
    ],
)
def test_a_configuration_names_the_autopilots_place(
    monkeypatch: pytest.MonkeyPatch, section: VehicleSection, url: str
) -> None:
    monkeypatch.setattr(serial_ports, "list_serial_ports", lambda: [UART, CUBE])
    assert connection_of(section).mavsdk == url


@pytest.mark.parametrize(
    ("ports", "seen"),
    [
        ([], "this machine has no serial port"),
        ([UART], "/dev/ttyAMA0 (not USB)"),
        ([GPS], "/dev/ttyACM3 (1546:01a9, u-blox GNSS)"),
    ],
)
def test_explains_what_it_saw_when_it_finds_none(ports: list[SerialPort], seen: str) -> None:
    with pytest.raises(LinkError) as caught:
        find_flight_controller(ports, 57_600)
    assert seen in str(caught.value)
    assert 'connection = "serial:///dev/serial/by-id/' in str(caught.value)


@pytest.mark.parametrize("pair", [(PIXHAWK, CUBE), (RADIO, FTDI)], ids=["autopilots", "adapters"])
def test_asks_which_of_two(pair: tuple[SerialPort, SerialPort]) -> None:
    with pytest.raises(LinkError) as caught:
        find_flight_controller([UART, *pair], 57_600)
    message = str(caught.value)
    assert all(port.device in message for port in pair)
    assert "/dev/ttyAMA0" not in message
    assert f'connection = "serial://{pair[0].path}:57600"' in message


def test_two_adapters_without_serial_number_are_two_boards() -> None:
    twin = SerialPort(device="/dev/ttyUSB7", vendor_id=0x10C4, product_id=0xEA60, product="CP2102")
    with pytest.raises(LinkError, match="2 ports"):
        find_flight_controller([RADIO, twin], 57_600)


def test_lists_this_machine_and_survives_without_stable_names(tmp_path: Path) -> None:
    ports = list_serial_ports(tmp_path / "absent")
    assert all(port.device.startswith("/dev/") and not port.stable_path for port in ports)


def test_prefers_stable_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = tmp_path / "ttyACM0"
    device.touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-ArduPilot-if00").symlink_to(device)

    listed = SimpleNamespace(
        device=str(device), vid=0x1209, pid=0x5741, product=None, serial_number=None, location="1-1.4:1.2"
    )
    monkeypatch.setattr("panoexec.adapters.link.serial_ports.list_ports.comports", lambda: [listed])
    (port,) = list_serial_ports(by_id)
    assert port.path == str(by_id / "usb-ArduPilot-if00")
    assert (port.product, port.interface) == ("", 2)
