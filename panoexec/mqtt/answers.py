"""The `data` of each command's answer, and the plan on the topic `plan`, as models.

`asyncapi.yaml` is generated from them; the answer about a plan is built from them, and tests hold the others to them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema

from panoexec.inputs.plan_file import FORMAT, camera_to_data, plan_to_data
from panoexec.inputs.plan_options import ConstraintsModel
from panoexec.mqtt.messages import State
from panoexec.planning.model import Certificate, Estimate, Plan

Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
FiniteOrNull: TypeAlias = Annotated[Finite | None, WithJsonSchema({"type": ["number", "null"]})]
WholeOrNull: TypeAlias = Annotated[int | None, WithJsonSchema({"type": ["integer", "null"]})]
TextOrNull: TypeAlias = Annotated[str | None, WithJsonSchema({"type": ["string", "null"]})]


class Fields(BaseModel):
    """A JSON object that panoexec sends; a field with a default may be missing."""

    model_config = ConfigDict(frozen=True)


class CameraFields(Fields):
    """A camera with its field of view.

    `panoexec.inputs.plan_file.camera_to_data` writes it.
    """

    name: str
    sensor_width_mm: Finite
    sensor_height_mm: Finite
    image_width_px: int
    image_height_px: int
    focal_length_mm: Finite
    hfov_deg: Finite
    vfov_deg: Finite
    lens: Literal["calibrated", "nominal"]
    calibrated_focal_length_mm: Annotated[Finite | None, WithJsonSchema({"type": "number"})] = None
    distortion: Annotated[dict[str, Finite] | None, WithJsonSchema({"type": "object"})] = None
    principal_point_px: Annotated[
        tuple[Finite, Finite] | None, WithJsonSchema({"type": "array", "items": {"type": "number"}})
    ] = None
    fov_margin: Finite = 0.0


class PoseFields(Fields):
    """One gimbal pose; roll is 0."""

    index: int
    row: int
    pitch_deg: Finite
    yaw_deg: Finite


class PlanFields(Fields):
    """A plan file, format panoexec.plan/1.

    `panoexec.inputs.plan_file.plan_to_data` writes it.
    """

    format: Annotated[str, WithJsonSchema({"const": FORMAT})]
    method: str
    camera: CameraFields
    constraints: ConstraintsModel
    shots: Annotated[tuple[PoseFields, ...], Field(min_length=1)]
    certificate: Certificate | None
    estimate: Estimate | None
    lower_bound: WholeOrNull
    notes: tuple[str, ...]


class PlannedFields(Fields):
    """What an answer says of a plan.

    `battery_need_frac` is the part of a full battery that shooting needs by `[guards] hover_min`, null if that is not
    set; `plan`, the plan file, is there if the request had `shots`.
    """

    images: int
    rows: int
    duration_s: FiniteOrNull
    estimate: Estimate | None
    certificate: Certificate | None
    camera: CameraFields
    lower_bound: WholeOrNull
    notes: tuple[str, ...]
    battery_need_frac: FiniteOrNull = None
    plan: PlanFields | None = None


class MissionFields(Fields):
    """Which mission; null if none was begun."""

    mission_id: TextOrNull


class StartedFields(PlannedFields, MissionFields):
    """The mission that begins, and its plan."""


class MissionStateFields(MissionFields):
    """The mission and its state after the command."""

    state: str


class OfferedFields(MissionFields):
    """The mission; its state only while it is under way."""

    state: Annotated[str | None, WithJsonSchema({"type": "string"})] = None


class StoppedStateFields(MissionStateFields):
    """The mission and its state after the command; null and `idle` if the mission does not exist yet.

    `durable`: the command outlives the process, because it is in the mission's journal; it is executed in any case.
    """

    durable: bool


class StoppedFields(OfferedFields):
    """The mission; its state only while it is under way. Null if no mission was begun.

    `durable`: the command outlives the process, because it is on disk; it is executed in any case.
    """

    durable: bool


class ShotFields(Fields):
    """The shot that the command was about, and the mission."""

    shot: int
    mission_id: TextOrNull
    state: str


class ProfileFields(Fields):
    """The camera from now on."""

    camera: CameraFields


class FindingFields(Fields):
    """The result of one check: `ok`, `note`, `warning` (a mission with reduced quality or safety) or `missing`."""

    area: str
    check: str
    verdict: Literal["ok", "note", "warning", "missing"]
    found: str
    needed: str
    advice: str


class DoctorFields(Fields):
    """The findings of an examination, as `panoexec doctor --json` prints them."""

    format: Annotated[str, WithJsonSchema({"const": "panoexec.doctor/1"})]
    healthy: bool
    autopilot: TextOrNull
    examined_by: Literal["doctor", "daemon"]
    counts: dict[str, int]
    findings: tuple[FindingFields, ...]


class StoredMissionFields(Fields):
    """A mission of the storage."""

    mission_id: str
    name: str
    state: str
    shots_total: int
    shots_done: int
    photos: int
    size_bytes: int
    path: str
    problem: str


class MissionsFields(Fields):
    """The newest missions of the storage, oldest first."""

    missions: tuple[StoredMissionFields, ...]


class PresetFields(Fields):
    """A preset: its id for requests, its name for people, and the fields of the request that it stands for."""

    preset: str
    name: str
    fields: dict[str, Any]


class PresetsFields(Fields):
    """The presets of the configuration."""

    presets: tuple[PresetFields, ...]


class ThumbnailsFields(Fields):
    """How many thumbnails are sent, as the link has room."""

    mission_id: str
    count: int


ANSWERS: dict[str, type[BaseModel]] = {
    "plan": PlannedFields,
    "start": StartedFields,
    "pause": StoppedStateFields,
    "resume": OfferedFields,
    "abort": StoppedFields,
    "finish": StoppedStateFields,
    "skip": ShotFields,
    "repeat": ShotFields,
    "get": State,
    "doctor": DoctorFields,
    "missions": MissionsFields,
    "presets": PresetsFields,
    "thumbnails": ThumbnailsFields,
    "set_profile": ProfileFields,
}
"""The model of the `data` of each command's answer."""


def planned(plan: Plan, *, hover_s: float, shots: bool) -> dict[str, Any]:
    """What an answer says of a plan, as JSON.

    Args:
        plan: the plan.
        hover_s: hover time of a full battery; 0 if unknown.
        shots: whether it has the plan file, too.
    """
    estimate = plan.estimate
    fields = PlannedFields(
        images=len(plan.shots),
        rows=len({shot.row for shot in plan.shots}),
        duration_s=None if estimate is None else estimate.duration_s,
        estimate=estimate,
        certificate=plan.certificate,
        camera=CameraFields(**camera_to_data(plan.camera)),
        lower_bound=plan.lower_bound,
        notes=plan.notes,
        battery_need_frac=None if estimate is None or hover_s <= 0 else round(estimate.duration_s / hover_s, 4),
    )
    told = fields.model_dump(mode="json", exclude_unset=True)
    return told | {"plan": plan_to_data(plan)} if shots else told
