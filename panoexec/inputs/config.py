"""The configuration of the daemon, read from a TOML file and environment variables and validated.

Every key can be overridden by `PANOEXEC_<SECTION>__<KEY>`, which is parsed as a TOML value if possible and is a string
otherwise. Unknown keys, values out of range and impossible combinations are errors; all are reported at once. Secrets
are not part of the configuration, only the paths of their files.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from ipaddress import IPv6Address
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, field_validator, model_validator

from panoexec.azimuths import azimuth_range
from panoexec.errors import InputFileError
from panoexec.inputs.skyline import skyline_of
from panoexec.inputs.validation import problem_lines, read_toml
from panoexec.planning.search.budget import DEFAULT_BUDGET_S, MOST_BUDGET_S

ENV_PREFIX = "PANOEXEC_"
TURNING_MODES = frozenset({"OFFBOARD", "HOLD"})
"""Flight modes, by MAVSDK's names, in which ArduPilot (OFFBOARD) or PX4 (HOLD) executes yaw commands."""
_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_CAMERA_PORT = re.compile(r"usb:(\d{3},\d{3})?|ptpip:[A-Za-z0-9._-]+(:\d{1,5}(:\d{1,5})?)?")
_ORIGIN = re.compile(r"https?://([A-Za-z0-9_.-]{1,253}|\[[0-9A-Fa-f:.]+\])(:\d{1,5})?")
_HOST_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,252}")

Positive: TypeAlias = Annotated[FiniteFloat, Field(gt=0)]
SkyAt: TypeAlias = Annotated[FiniteFloat, Field(ge=-90, le=90)]
NotNegative: TypeAlias = Annotated[FiniteFloat, Field(ge=0)]
Fraction: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=1)]
Overlap: TypeAlias = Annotated[FiniteFloat, Field(ge=0, lt=1)]
ToleranceDeg: TypeAlias = Annotated[FiniteFloat, Field(ge=0, le=45)]
Range: TypeAlias = tuple[FiniteFloat, FiniteFloat]
EvidenceName: TypeAlias = Literal[
    "commanded", "acknowledged", "counted", "feedback_pin", "capture_message", "file_seen"
]


class Section(BaseModel):
    """Base of all sections: unknown keys are errors, values are immutable, defaults are validated as well."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


def _ordered_range(value: Range, least: float, most: float) -> Range:
    low, high = value
    if not low < high:
        raise ValueError(f"[{low:g}, {high:g}] is empty or reversed: the first value must be less than the second")
    if low < least or high > most:
        raise ValueError(f"[{low:g}, {high:g}] must lie within [{least:g}, {most:g}]")
    return value


def _is_ipv6(text: str) -> bool:
    try:
        IPv6Address(text)
    except ValueError:
        return False
    return True


class VehicleSection(Section):
    """`[vehicle]`: vehicle id and connection to the autopilot."""

    id: str = "drone"
    connection: str | None = None
    serial: str | None = None
    baud: Annotated[int, Field(ge=1200, le=4_000_000)] = 921_600
    system_id: Annotated[int, Field(ge=1, le=255)] | None = None
    component_id: Annotated[int, Field(ge=1, le=255)] = 191
    commanders: tuple[Annotated[int, Field(ge=1, le=255)], ...] | None = None
    yaw_rate_deg_s: Positive | None = None
    yaw_acceleration_deg_s2: Positive | None = None

    @field_validator("id")
    @classmethod
    def _id_fits_a_topic(cls, value: str) -> str:
        if not _ID.fullmatch(value):
            raise ValueError(f"{value!r} is not an id: use 1 to 64 of A-Z a-z 0-9 _ - (the id is part of MQTT topics)")
        return value

    @model_validator(mode="after")
    def _one_way_to_connect(self) -> Self:
        if self.connection is not None and self.serial is not None:
            raise ValueError("connection and serial exclude each other: set only one of them")
        return self


class RcSection(Section):
    """`[rc]`: switches of the pilot's transmitter."""

    start_channel: Annotated[int, Field(ge=1, le=18)] | None = None
    abort_channel: Annotated[int, Field(ge=1, le=18)] | None = None
    preset: str | None = None

    @model_validator(mode="after")
    def _two_switches(self) -> Self:
        if self.start_channel is not None and self.start_channel == self.abort_channel:
            raise ValueError(f"start_channel and abort_channel are both {self.start_channel}: give each its own")
        return self


class StationsSection(Section):
    """`[stations]`: panoramas at waypoints of the autopilot's own mission."""

    enabled: bool = False
    guided: bool = False
    radius_m: Positive = 2.0
    speed_m_s: Positive = 5.0
    longest_s: Annotated[FiniteFloat, Field(ge=10, le=86_400)] = 900.0
    visits: Annotated[int, Field(ge=1, le=100)] = 1


class GimbalSection(Section):
    """`[gimbal]`: properties of the gimbal that it does not report itself."""

    feedback: Literal["auto", "earth", "vehicle", "body", "none"] = "auto"
    manager: Annotated[int, Field(ge=0, le=255)] = 0
    device: Annotated[int, Field(ge=0, le=255)] = 0
    yaw: Literal["gimbal", "vehicle", "auto"] = "gimbal"
    pitch_deg: Range | None = None
    yaw_deg: Range | None = None
    yaw_endless: bool | None = None
    pitch_rate_deg_s: Positive = 60.0
    yaw_rate_deg_s: Positive = 90.0
    pitch_acceleration_deg_s2: Positive = 240.0
    yaw_acceleration_deg_s2: Positive = 360.0
    when_taken: Literal["pause", "reclaim"] = "pause"

    @field_validator("pitch_deg", "yaw_deg")
    @classmethod
    def _ordered(cls, value: Range | None) -> Range | None:
        return None if value is None else _ordered_range(value, -360, 360)


class LockSection(Section):
    """`[camera.lock]`: settings that must not change within a panorama."""

    exposure: Literal["off", "first", "manual"] = "off"
    shutter_s: Positive | None = None
    aperture: Positive | None = None
    iso: Annotated[int, Field(gt=0)] | None = None
    white_balance: str = "off"
    focus: Literal["off", "manual"] = "off"

    @model_validator(mode="after")
    def _manual_has_values(self) -> Self:
        values = (self.shutter_s, self.aperture, self.iso)
        if self.exposure == "manual" and self.shutter_s is None:
            raise ValueError('exposure = "manual" needs shutter_s, and where the camera has them aperture and iso')
        if self.exposure != "manual" and any(value is not None for value in values):
            raise ValueError('shutter_s, aperture and iso are for exposure = "manual"')
        return self


class CameraSection(Section):
    """`[camera]`: profile, trigger, and evidence of a photo."""

    profile: str = "dji-x5s-15mm"
    orientation: Literal["landscape", "portrait"] | None = None
    focal_length_mm: Positive | None = None
    lens: Literal["calibrated", "nominal"] | None = None
    component: Annotated[int, Field(ge=0, le=255)] = 0
    trigger: Literal["mavlink", "serial", "gphoto2"] = "mavlink"
    port: str | None = None
    model: str | None = None
    serial_port: str | None = None
    serial_line: Literal["rts", "dtr", "bytes"] = "rts"
    serial_bytes: str | None = None
    pulse_s: Annotated[FiniteFloat, Field(gt=0, le=10)] = 0.1
    bracket: Annotated[int, Field(ge=1, le=9)] = 1
    exposure_s: Positive | None = None
    interval_s: NotNegative | None = None
    latency_s: NotNegative = 0.1
    transfer_s: NotNegative | None = None
    evidence: EvidenceName = "counted"
    file_folders: tuple[Path, ...] = ()
    file_hosts: tuple[str, ...] = ()
    lock: LockSection = LockSection()

    @model_validator(mode="before")
    @classmethod
    def _is_of_the_vehicles_system(cls, data: Any) -> Any:
        if isinstance(data, dict) and "system" in data:
            raise ValueError(
                "there is no key `system`: a camera belongs to the vehicle whose MAVLink system id it has, and MAVSDK "
                "keeps the messages of other systems apart; set the camera's own system id to that of the vehicle, "
                "and choose between several cameras by `component`"
            )
        return data

    @field_validator("port")
    @classmethod
    def _port_is_one_of_libgphoto2(cls, value: str | None) -> str | None:
        if value is not None and not _CAMERA_PORT.fullmatch(value):
            raise ValueError(f'{value!r} is not a port: give "usb:", "usb:001,007" or "ptpip:HOST"')
        return value

    @field_validator("file_hosts")
    @classmethod
    def _hosts_are_hosts(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for host in value:
            if not _HOST_NAME.fullmatch(host) and not _is_ipv6(host):
                raise ValueError(f"{host!r} is not a host: give names or addresses without http:// and without a port")
        return value

    @model_validator(mode="after")
    def _serial_is_complete(self) -> Self:
        if self.trigger == "serial" and not self.serial_port:
            raise ValueError('trigger = "serial" needs serial_port, for example "/dev/serial/by-id/…"')
        if self.trigger != "gphoto2" and (self.port or self.model):
            raise ValueError('port and model name a tethered camera: they need trigger = "gphoto2"')
        if self.trigger == "serial" and self.lock != LockSection():
            raise ValueError(
                "the settings of [camera.lock] are made over the camera's link: they need "
                'trigger = "gphoto2", or "mavlink" with a camera that offers a camera definition'
            )
        if self.serial_line == "bytes" and not self.serial_bytes:
            raise ValueError('serial_line = "bytes" needs serial_bytes, the text to send')
        if self.trigger == "serial" and self.evidence not in ("commanded", "acknowledged", "counted", "feedback_pin"):
            raise ValueError(f'a serial shutter cannot provide evidence = "{self.evidence}": use "commanded"')
        return self


class PointingSection(Section):
    """`[pointing]`: the tolerance τ and the gate."""

    tolerance_pitch_deg: ToleranceDeg = 0.1
    tolerance_roll_deg: ToleranceDeg = 0.1
    tolerance_yaw_deg: ToleranceDeg = 0.7
    settle_s: NotNegative = 0.3
    settle_timeout_s: Positive = 10.0
    max_rate_deg_s: Positive = 5.0
    max_gap_s: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.25
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    accept: Literal["tolerance", "overlap"] = "tolerance"

    @model_validator(mode="after")
    def _settling_can_end(self) -> Self:
        if self.settle_timeout_s <= self.settle_s:
            raise ValueError(
                f"settle_timeout_s = {self.settle_timeout_s:g} must be more than settle_s = {self.settle_s:g}"
            )
        return self


class GuardsSection(Section):
    """`[guards]`: conditions under which a mission does not start, pauses or stops."""

    battery_floor_frac: Fraction = 0.25
    hover_min: NotNegative = 20.0
    position_drift_m: Positive = 3.0
    parallax_px: NotNegative = 0.0
    """0: no limit."""
    allowed_modes: tuple[str, ...] = ("HOLD", "OFFBOARD", "POSCTL")
    attitude_silence_s: Positive = 2.0
    require_in_air: bool = False


class PicturesSection(Section):
    """`[pictures]`: what is made of photos whose files arrive."""

    check: Literal["off", "warn", "retake"] = "retake"
    thumbnails: Literal["mqtt", "local", "off"] = "mqtt"
    thumbnail_bytes_s: Annotated[int, Field(ge=100, le=10_000_000)] = 20_000


class MissionSection(Section):
    """`[mission]`: defaults for requests, and handling of an interrupted mission at start."""

    resume: Literal["auto", "offer"] = "offer"
    method: Literal["certified", "paper", "hdrpano"] = "certified"
    overlap_h: Overlap = 0.15
    overlap_v: Overlap = 0.15
    elevation_deg: Range = (-90.0, 30.0)
    azimuth_deg: Range = (-180.0, 180.0)
    guarantee: Literal["coverage", "all"] = "coverage"
    textured_below: SkyAt | tuple[tuple[FiniteFloat, FiniteFloat], ...] | None = None
    budget_s: Annotated[float, Field(gt=0, le=MOST_BUDGET_S)] = DEFAULT_BUDGET_S
    reference: Literal["north", "heading"] = "north"
    order: Literal["fastest", "rows", "columns", "nadir-first", "sky-first"] = "fastest"

    @field_validator("elevation_deg")
    @classmethod
    def _elevations(cls, value: Range) -> Range:
        return _ordered_range(value, -90, 90)

    @field_validator("azimuth_deg")
    @classmethod
    def _azimuths(cls, value: Range) -> Range:
        azimuth_range(*value)
        return value

    @field_validator("textured_below")
    @classmethod
    def _a_skyline(
        cls, value: float | tuple[tuple[float, float], ...] | None
    ) -> float | tuple[tuple[float, float], ...] | None:
        if value is not None:
            skyline_of(value)
        return value


class MqttSection(Section):
    """`[mqtt]`: broker and credentials; without `host` there is no MQTT connection."""

    host: str | None = None
    port: Annotated[int, Field(ge=1, le=65535)] = 1883
    prefix: str = "panoexec"
    protocol: Literal["5", "3.1.1"] = "5"
    keepalive_s: Annotated[int, Field(ge=5, le=3600)] = 20
    discovery: bool = False
    username: str | None = None
    password_file: Path | None = None
    ca_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None

    @field_validator("host")
    @classmethod
    def _host_is_a_host(cls, value: str | None) -> str | None:
        if value is not None and not _HOST_NAME.fullmatch(value) and not _is_ipv6(value):
            # the part before an @ may be a password, which must not appear in messages
            shown = "the value" if "@" in value else repr(value)
            raise ValueError(f"{shown} is not a host: give a name or an address without mqtt:// and without a port")
        return value

    @field_validator("prefix")
    @classmethod
    def _prefix_is_a_topic(cls, value: str) -> str:
        if not all(_ID.fullmatch(part) for part in value.split("/")):
            raise ValueError(
                f"{value!r} is not a topic prefix: use levels of A-Z a-z 0-9 _ - separated by single slashes"
            )
        return value

    @model_validator(mode="after")
    def _credentials_are_whole(self) -> Self:
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file belong together: set both or neither")
        if self.cert_file is not None and self.ca_file is None:
            raise ValueError("cert_file needs ca_file: client certificates require TLS")
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file needs username")
        return self


class StorageSection(Section):
    """`[storage]`: storage of missions."""

    path: Path = Path("/var/lib/panoexec")
    min_free_mb: NotNegative = 200.0


class WebSection(Section):
    """`[web]`: the operator's page (`panoexec web`)."""

    listen: str = "127.0.0.1:8090"
    users_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None
    origins: tuple[str, ...] = ()

    @field_validator("listen")
    @classmethod
    def _listen_is_an_address(cls, value: str) -> str:
        listen_address(value)
        return value

    @field_validator("origins")
    @classmethod
    def _origins_are_origins(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for origin in value:
            if not _ORIGIN.fullmatch(origin):
                raise ValueError(f'{origin!r} is not an origin: give scheme and host, "https://ground.example"')
        return value

    @model_validator(mode="after")
    def _certificate_has_a_key(self) -> Self:
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file belong together: set both or neither")
        return self


def listen_address(text: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`, `[IPV6]:PORT` or `PORT`.

    Raises:
        ValueError: it is none.
    """
    host, _, port = text.rpartition(":")
    host = host[1:-1] if host.startswith("[") and host.endswith("]") and _is_ipv6(host[1:-1]) else host
    host = host or "127.0.0.1"
    if not (port.isdecimal() and int(port) <= 65_535) or not (_HOST_NAME.fullmatch(host) or _is_ipv6(host)):
        raise ValueError(f"{text!r} is not an address to listen at: give HOST:PORT, for example 127.0.0.1:8090")
    return host, int(port)


class LogSection(Section):
    """`[log]`: level and format of the log."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["auto", "human", "json"] = "auto"


class Config(Section):
    """The complete configuration."""

    vehicle: VehicleSection = VehicleSection()
    gimbal: GimbalSection = GimbalSection()
    camera: CameraSection = CameraSection()
    pointing: PointingSection = PointingSection()
    guards: GuardsSection = GuardsSection()
    pictures: PicturesSection = PicturesSection()
    mission: MissionSection = MissionSection()
    mqtt: MqttSection = MqttSection()
    storage: StorageSection = StorageSection()
    web: WebSection = WebSection()
    rc: RcSection = RcSection()
    stations: StationsSection = StationsSection()
    log: LogSection = LogSection()
    presets: dict[str, dict[str, Any]] = {}
    """Requests with a name; `panoexec.daemon.presets` checks them by the model of the request."""

    @model_validator(mode="after")
    def _a_vehicle_that_pans_may_be_turned(self) -> Self:
        modes = self.guards.allowed_modes
        if self.gimbal.yaw != "gimbal" and modes and not set(modes) & TURNING_MODES:
            raise ValueError(
                f'gimbal.yaw = "{self.gimbal.yaw}" turns the vehicle, but guards.allowed_modes = {list(modes)} has no '
                f"mode in which it can be turned: OFFBOARD (ArduPilot: GUIDED) or HOLD (PX4)"
            )
        return self


def load_config(path: Path, environment: Mapping[str, str]) -> Config:
    """Read and check a configuration.

    Args:
        path: the TOML file.
        environment: environment variables; `PANOEXEC_<SECTION>__<KEY>` override the file.

    Raises:
        InputFileError: the file or an overriding variable is invalid; the error lists every problem.
    """
    if not path.exists():
        copy = "config/panoexec.toml of a clone or /usr/share/panoexec/config.toml of the package"
        raise InputFileError(str(path), [f"cannot be read: there is no such file; copy {copy}"])
    tables = read_toml(path)
    problems = _apply_environment(tables, environment)
    try:
        config = Config.model_validate(tables)
    except ValidationError as error:
        raise InputFileError(str(path), problems + problem_lines(error, Config)) from error
    if problems:
        raise InputFileError(str(path), problems)
    return config


def _apply_environment(tables: dict[str, Any], environment: Mapping[str, str]) -> list[str]:
    """Put overriding variables into the tables; returns the problems of their names."""
    problems: list[str] = []
    for name, text in sorted(environment.items()):
        if not name.startswith(ENV_PREFIX) or "__" not in name:
            continue
        section, _, key = name.removeprefix(ENV_PREFIX).lower().partition("__")
        if section not in Config.model_fields:
            known = ", ".join(sorted(Config.model_fields))
            problems.append(f"environment variable {name}: unknown section {section!r}; sections are {known}")
            continue
        table = tables.setdefault(section, {})
        if isinstance(table, dict):
            table[key] = _toml_value(text)
    return problems


def _toml_value(text: str) -> object:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
