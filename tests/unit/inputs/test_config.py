from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError

from panoexec.errors import InputFileError
from panoexec.inputs.config import Config, load_config
from panoexec.inputs.service_sections import MqttSection
from panoexec.inputs.validation import problem_lines
from tests.repository import ROOT

EXAMPLE = ROOT / "config" / "panoexec.toml"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "config.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_example_shows_the_defaults() -> None:
    example = load_config(EXAMPLE, {})
    expected = Config().model_dump()
    # the only keys that the example sets and the code leaves open
    expected["vehicle"]["connection"] = "udpin://0.0.0.0:14540"
    assert example.model_dump() == expected


def test_the_example_names_every_key() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    for section, field in Config.model_fields.items():
        if section == "presets":  # tables by names of the user's choice
            assert f"# [{section}.roof]" in text
            continue
        assert f"[{section}]" in text
        body = text.split(f"[{section}]", 1)[1].split("\n[", 1)[0]
        assert field.annotation is not None
        for key, inner in field.annotation.model_fields.items():
            if isinstance(inner.annotation, type) and issubclass(inner.annotation, BaseModel):
                table = text.split(f"\n[{section}.{key}]", 1)[1].split("\n[", 1)[0]
                assert all(f"\n{one} =" in table or f"\n# {one} =" in table for one in inner.annotation.model_fields)
            else:
                assert f"\n{key} =" in body or f"\n# {key} =" in body, f"[{section}] {key}"


def test_all_problems_are_told_at_once_with_key_and_value(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        """
[vehicle]
id = "my drone"
colour = "red"
[pointing]
attempts = 0
settle_s = -1
[mission]
elevation_deg = [30, -90]
[mqtt]
port = "lots"
""",
    )
    with pytest.raises(InputFileError) as caught:
        load_config(path, {"PANOEXEC_NOWHERE__KEY": "1"})
    text = "\n".join(caught.value.problems)
    for part in ("'my drone'", "vehicle.colour", "pointing.attempts", "pointing.settle_s", "reversed", "mqtt.port"):
        assert part in text
    assert "NOWHERE" in text
    assert len(caught.value.problems) == 7
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ('[vehicle]\nconnection = "udpin://0.0.0.0:1"\nserial = "auto"', "exclude each other"),
        ('[camera]\ntrigger = "serial"', "needs serial_port"),
        ('[camera]\ntrigger = "serial"\nserial_port = "/dev/x"\nevidence = "file_seen"', "cannot provide"),
        ("[pointing]\nsettle_s = 5\nsettle_timeout_s = 5", "must be more than"),
        ('[gimbal]\nyaw = "vehicle"\n[guards]\nallowed_modes = ["POSCTL"]', "no mode in which it can be turned"),
        ('[mqtt]\ncert_file = "a"', "belong together"),
        ('[mqtt]\npassword_file = "a"', "needs username"),
        ("[mission]\nazimuth_deg = [-180, 200]", "at most 360"),
        ("[mission]\noverlap_h = 15", "mission.overlap_h is 15"),
        ("[mission]\noverlap_h = nan", "mission.overlap_h is nan"),
        ('[mqtt]\nprefix = "/a"', "not a topic prefix"),
        ('[mqtt]\nhost = ""', "'' is not a host: give a name or an address"),
        ('[mqtt]\nhost = "mqtt://broker.local"', "without mqtt:// and without a port"),
        ('[mqtt]\nhost = "broker.local:1883"', "'broker.local:1883' is not a host"),
        ('[mqtt]\nhost = "10.0.0.2:1883"', "'10.0.0.2:1883' is not a host"),
        ('[mqtt]\nhost = "broker local"', "'broker local' is not a host"),
        ("[guards\n", "not valid TOML"),
    ],
)
def test_impossible_combinations_are_errors(tmp_path: Path, text: str, part: str) -> None:
    with pytest.raises(InputFileError, match="config") as caught:
        load_config(write(tmp_path, text), {})
    assert part in str(caught.value)


def test_a_missing_file_and_bytes_that_are_no_text(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="cannot be read"):
        load_config(tmp_path / "none.toml", {})
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputFileError, match="not UTF-8"):
        load_config(tmp_path / "bytes.toml", {})


def test_the_environment_overrides_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, '[mqtt]\nhost = "a"\nport = 1\n')
    environment = {
        "PANOEXEC_MQTT__HOST": "broker.local",
        "PANOEXEC_MQTT__PORT": "8883",
        "PANOEXEC_MISSION__ELEVATION_DEG": "[-90, 45]",
        "PANOEXEC_GUARDS__ALLOWED_MODES": '["HOLD"]',
        "PANOEXEC_UNRELATED": "x",
    }
    config = load_config(path, environment)
    assert (config.mqtt.host, config.mqtt.port) == ("broker.local", 8883)
    assert config.mission.elevation_deg == (-90, 45)
    assert config.guards.allowed_modes == ("HOLD",)


def test_a_bad_override_names_its_key(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"mqtt\.port is 'high'"):
        load_config(write(tmp_path, ""), {"PANOEXEC_MQTT__PORT": "high"})


@pytest.mark.parametrize(
    "host", ["broker.local", "10.0.0.2", "a", "::1", "fe80::1%eth0", "2001:db8::7", "my_broker-2.x"]
)
def test_hosts_are_names_or_addresses(host: str) -> None:
    assert MqttSection(host=host).host == host


def test_a_password_in_the_wrong_place_is_not_repeated() -> None:
    with pytest.raises(ValidationError) as caught:
        MqttSection(host="drone:secret@broker.local")
    lines = problem_lines(caught.value)
    assert "is not a host" in lines[0]
    assert "secret" not in lines[0]


def test_a_camera_on_another_system_is_refused_with_what_to_set(tmp_path: Path) -> None:
    path = tmp_path / "panoexec.toml"
    path.write_text("[camera]\nsystem = 2\n", encoding="utf-8")
    with pytest.raises(InputFileError, match="set the camera's own system id to that of the vehicle"):
        load_config(path, {})
