"""Requests that the configuration has under a name."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.daemon.mission_request import configuration_problems, spec_of
from panoexec.daemon.presets import presets_document, with_preset
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import plan_to_data
from panoexec.mqtt.requests import PlanRequest, RefusedRequestError, StartRequest
from panoexec.planning.baselines.published import published_plan

ROOF = {
    "name": "Roof and yard",
    "elevation_deg": [-90, -10],
    "overlap": 0.25,
    "tolerance_deg": {"pitch": 0.2, "yaw": 2},
    "reference": "heading",
}


def config(**presets: Any) -> Config:
    return Config.model_validate({"vehicle": {"connection": "udpin://0.0.0.0:1"}, "presets": presets})


def start(**fields: Any) -> StartRequest:
    return StartRequest.model_validate({"transaction": "t", **fields})


def test_its_fields_are_taken_where_the_request_has_none() -> None:
    merged = with_preset(config(roof=ROOF), start(preset="roof", elevation_deg=[-60, 0]))
    assert (merged.name, merged.elevation_deg, merged.overlap) == ("Roof and yard", [-60, 0], 0.25)
    assert (merged.reference, merged.preset, merged.transaction) == ("heading", "roof", "t")
    assert (
        start(preset="roof", name="mine").name == with_preset(config(roof=ROOF), start(preset="roof", name="mine")).name
    )
    plan = with_preset(config(roof=ROOF), PlanRequest.model_validate({"transaction": 1, "preset": "roof"}))
    assert spec_of(config(), plan).constraints.overlap_h == 0.25


def test_one_kind_of_overlap_and_single_tolerances_override() -> None:
    merged = with_preset(config(roof=ROOF), start(preset="roof", overlap_h=0.4, tolerance_deg={"pitch": 0.1}))
    assert (merged.overlap, merged.overlap_h) == (None, 0.4)
    assert merged.tolerance_deg is not None
    assert merged.tolerance_deg.model_dump() == {"pitch": 0.1, "roll": None, "yaw": 2}


def test_a_plan_in_the_request_keeps_its_own_panorama() -> None:
    data = plan_to_data(published_plan("scenario-3-proposed"))
    merged = with_preset(config(roof=ROOF | {"order": "rows"}), start(preset="roof", plan=data))
    assert (merged.elevation_deg, merged.overlap, merged.order) == (None, None, None)
    assert (merged.name, merged.reference) == ("Roof and yard", "heading")


def test_one_that_is_not_there_is_refused_with_the_nearest_one() -> None:
    for presets, told in (({"roof": ROOF}, "did you mean 'roof'?"), ({}, "none is configured")):
        with pytest.raises(RefusedRequestError, match="there is no preset 'rooof'") as refused:
            with_preset(config(**presets), start(preset="rooof"))
        assert refused.value.field == "preset"
        assert told in refused.value.message


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"elevatoin_deg": [-90, 0]}, "presets.x.elevatoin_deg is not a known key: did you mean elevation_deg?"),
        ({"elevation_deg": [0, -90]}, "presets.x.elevation_deg: is [0, -90]: must be [min, max] with -90 ≤ min < max"),
        ({"overlap": "15%"}, "presets.x.overlap is '15%'"),
        ({"overlap": 0.2, "overlap_h": 0.3}, "presets.x.overlap and overlap_h, overlap_v exclude each other"),
        ({"plan": {}}, "presets.x.plan is not a key of a preset"),
        ({"transaction": 1}, "presets.x.transaction is not a key of a preset"),
        ({"preset": "y"}, "presets.x.preset is not a key of a preset"),
    ],
)
def test_a_wrong_one_is_a_problem_of_the_configuration(fields: dict[str, Any], problem: str) -> None:
    (found,) = configuration_problems(config(x=fields))
    assert found.startswith(problem), found


def test_ids_can_be_typed_and_are_not_too_many() -> None:
    assert "is not an id" in configuration_problems(config(**{"a b": {}}))[0]
    assert "at most 50" in configuration_problems(config(**{f"p{i}": {} for i in range(51)}))[0]


def test_answers_have_them_in_order_with_names_for_people() -> None:
    document = presets_document(config(roof=ROOF, all={}))
    assert [(one["preset"], one["name"]) for one in document] == [("roof", "Roof and yard"), ("all", "all")]
    assert document[0]["fields"]["overlap"] == 0.25
    assert "name" not in document[0]["fields"]


@given(overlap=st.floats(0, 0.9), low=st.integers(-90, 0), name=st.text(st.characters(categories=["L"]), max_size=10))
def test_a_request_that_says_everything_is_not_changed(overlap: float, low: int, name: str) -> None:
    said = {"overlap": overlap, "elevation_deg": [low, 1], "name": name, "reference": "north", "method": "paper"}
    said |= {"tolerance_deg": {"pitch": 0.0, "roll": 0.0, "yaw": 0.0}}
    asked = start(preset="roof", **said)
    merged = with_preset(config(roof=ROOF), asked)
    assert merged.model_dump() == asked.model_dump()


def test_stations_need_a_preset_to_name() -> None:
    on = {"vehicle": {"connection": "udpin://0.0.0.0:1"}, "stations": {"enabled": True}}
    problem = "stations.enabled: there is no [presets.NAME], whose number a station could have"
    assert problem in configuration_problems(Config.model_validate(on))
    assert problem not in configuration_problems(Config.model_validate(on | {"presets": {"roof": ROOF}}))
