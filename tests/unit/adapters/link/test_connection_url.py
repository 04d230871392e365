import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.link.connection_url import ConnectionUrl, Kind, parse_connection
from panoexec.errors import UsageError


@pytest.mark.parametrize(
    ("text", "mavsdk"),
    [
        ("udpin://0.0.0.0:14540", "udpin://0.0.0.0:14540"),
        ("udpout://10.0.0.2:14550", "udpout://10.0.0.2:14550"),
        ("tcpin://127.0.0.1:5760", "tcpin://127.0.0.1:5760"),
        ("tcpout://router.local:5760", "tcpout://router.local:5760"),
        ("  udpin://0.0.0.0:14540 ", "udpin://0.0.0.0:14540"),
        ("UDPIN://0.0.0.0:14540", "udpin://0.0.0.0:14540"),
        ("serial:///dev/serial/by-id/usb-A:B-if00:921600", "serial:///dev/serial/by-id/usb-A:B-if00:921600"),
        ("serial_flowcontrol:///dev/ttyS1:57600", "serial_flowcontrol:///dev/ttyS1:57600"),
        # MAVSDK's older spelling: no host means to listen
        ("udp://:14540", "udpin://0.0.0.0:14540"),
        ("udp://0.0.0.0:14540", "udpin://0.0.0.0:14540"),
        ("udp://10.0.0.2:14550", "udpout://10.0.0.2:14550"),
        ("tcp://127.0.0.1:5760", "tcpout://127.0.0.1:5760"),
        ("tcp://:5760", "tcpin://0.0.0.0:5760"),
        # MAVProxy: udp: listens, tcp: calls
        ("udp:127.0.0.1:14550", "udpin://127.0.0.1:14550"),
        ("udpin:0.0.0.0:14550", "udpin://0.0.0.0:14550"),
        ("udpout:10.0.0.2:14550", "udpout://10.0.0.2:14550"),
        ("tcp:127.0.0.1:5762", "tcpout://127.0.0.1:5762"),
        ("tcpin:0.0.0.0:5762", "tcpin://0.0.0.0:5762"),
        ("/dev/ttyACM0,57600", "serial:///dev/ttyACM0:57600"),
        ("/dev/ttyACM0", "serial:///dev/ttyACM0:115200"),
    ],
)
def test_reads_and_translates(text: str, mavsdk: str) -> None:
    assert parse_connection(text).mavsdk == mavsdk


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "unknown protocol"),
        ("14540", "unknown protocol"),
        ("foo://x:1", "unknown protocol 'foo'"),
        ("foo:x:1", "unknown protocol 'foo'"),
        ("udpin://0.0.0.0", "port is missing"),
        ("udpin://0.0.0.0:99999", "port '99999'"),
        ("udpin://0.0.0.0:0", "port '0'"),
        ("udpin://0.0.0.0:14540x", "port '14540x'"),
        ("udpin://0.0.0.0:１４", "port"),
        ("udpin://:14540", "host is missing"),
        ("udpout://0.0.0.0:14540", "not to connect to"),
        ("udpout://a b:14540", "not a host"),
        ("serial:///dev/ttyACM0", "baud rate is missing"),
        ("serial://ttyACM0:57600", "not the path of a serial device"),
        ("serial:///dev/ttyACM0:fast", "baud rate 'fast'"),
        ("serial:///dev/ttyACM0:1", "baud rate '1'"),
        ("/dev/ttyACM0,", "baud rate ''"),
        ("raw://", "unknown protocol 'raw'"),
    ],
)
def test_refuses_with_a_reason_and_what_it_would_accept(text: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint) as caught:
        parse_connection(text)
    assert repr(text) in str(caught.value)
    assert "udpin://0.0.0.0:14540" in str(caught.value)
    assert caught.value.exit_code == 2


@given(st.text(max_size=40))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    try:
        url = parse_connection(text)
    except UsageError as error:
        refusal = str(error)
        assert "\n" not in refusal
    else:
        assert parse_connection(url.mavsdk) == url


@given(
    kind=st.sampled_from(["udpin", "udpout", "tcpin", "tcpout"]),
    host=st.ip_addresses(v=4).map(str).filter(lambda host: host != "0.0.0.0"),
    port=st.integers(1, 65535),
)
def test_its_own_form_survives_a_round_trip(kind: Kind, host: str, port: int) -> None:
    url = ConnectionUrl(kind=kind, host=host, port=port)
    assert parse_connection(str(url)) == url
    assert url.listens == kind.endswith("in")
