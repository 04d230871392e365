"""Sections of the configuration about the vehicle, what it carries, and how missions are flown."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, FiniteFloat, field_validator, model_validator

from panoexec.azimuths import azimuth_range
from panoexec.inputs.sections import (
    EvidenceName,
    Fraction,
    NotNegative,
    Overlap,
    Positive,
    Range,
    Section,
    SkyAt,
    ToleranceDeg,
    is_ipv6,
    ordered_range,
)
from panoexec.inputs.skyline import skyline_of
from panoexec.planning.search.budget import DEFAULT_BUDGET_S, MOST_BUDGET_S

_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")

_CAMERA_PORT = re.compile(r"usb:(\d{3},\d{3})?|ptpip:[A-Za-z0-9._-]+(:\d{1,5}(:\d{1,5})?)?")

_HOST_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,252}")


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
        return None if value is None else ordered_range(value, -360, 360)


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
            if not _HOST_NAME.fullmatch(host) and not is_ipv6(host):
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
        return ordered_range(value, -90, 90)

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
