"""docs/contract.md and the program say the same: verbs, options, formats, topics, commands, states, sections."""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
from pathlib import Path
from typing import Any, get_args

import panoexec
from panoexec import errors
from panoexec.cli.app import COMMANDS, EXIT_DONE, EXIT_INTERRUPTED, module_of, parser_of
from panoexec.inputs import plan_file
from panoexec.inputs.config import Config
from panoexec.mission.log.events import Event
from panoexec.mission.log.states import MissionState
from panoexec.mqtt.messages import ErrorFields, LinksFields, Response, State, StateDelta
from panoexec.mqtt.requests import MAX_PAYLOAD, REQUESTS, ErrorCode, PlanRequest, ToleranceFields
from panoexec.mqtt.topics import Topics
from panoexec.store import manifest
from panoexec.store.directory import MissionDirectory
from tests.repository import ROOT

WHOLE = (ROOT / "docs" / "contract.md").read_text(encoding="utf-8")
TEXT, PLANNED = WHOLE.split("## Planned\n")


def section(title: str) -> str:
    """The text below a heading, a line a paragraph."""
    found = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL)
    assert found is not None, title
    return found[1]


def flat(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def code(text: str) -> list[str]:
    return re.findall(r"`([^`]+)`", text)


def rows(title: str) -> dict[str, str]:
    """What stands beside each `name` of the tables in a section."""
    return dict(re.findall(r"^\| `([^`]+)` \| (.*) \|$", section(title), re.MULTILINE))


def between(text: str, start: str, end: str) -> list[str]:
    return code(flat(text).split(start)[1].split(end)[0])


def options(verb: str) -> set[str]:
    parser: argparse.ArgumentParser = parser_of(verb, module_of(verb))
    return {option for action in parser._actions for option in action.option_strings}


def shape(value: Any) -> Any:
    """The keys of a JSON document, and of the first item of each list of objects."""
    if isinstance(value, dict):
        return {key: shape(item) for key, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [shape(value[0])]
    return None


def test_verbs_and_their_options() -> None:
    verbs = rows("Command line")
    assert set(verbs) == set(COMMANDS)
    for verb, text in verbs.items():
        assert {span for span in code(text) if span.startswith("--")} <= options(verb), verb


def test_exit_codes() -> None:
    told = {int(number) for number in re.findall(r"^\| (\d+) \|", section("Command line"), re.MULTILINE)}
    kinds = (errors.PanoexecError, errors.UsageError, errors.DeviceError)
    assert told == {EXIT_DONE, *(kind.exit_code for kind in kinds), EXIT_INTERRUPTED}


def test_the_plan_file(tmp_path: Path) -> None:
    block = re.search(r"^```json\n(.*?)^```", section("Plan file"), re.MULTILINE | re.DOTALL)
    assert block is not None
    document = json.loads(block[1])
    assert document["format"] == plan_file.FORMAT
    plan = panoexec.plan("dji-x5s-15mm", elevation_deg=(-10, 10), azimuth_deg=(0, 60))
    assert shape(document) == shape(json.loads(json.dumps(plan_file.plan_to_data(plan))))
    (tmp_path / "plan.json").write_text(block[1])
    assert not panoexec.verify(tmp_path / "plan.json").certified


def test_the_mission_directory() -> None:
    cells = re.findall(r"^\| (`.*`) \|", section("Mission directory"), re.MULTILINE)
    directory = MissionDirectory(Path("x"))
    paths = (
        directory.plan,
        directory.manifest,
        directory.journal,
        directory.report,
        directory.outputs,
        directory.images,
    )
    assert {path.name for path in paths} <= {name for cell in cells for name in code(cell)}
    text = section("Mission directory")
    recorded = json.loads((ROOT / "tests" / "data" / "recorded" / "manifest.json").read_text(encoding="utf-8"))
    recorded |= {"digest": "", "journal": {}}  # an earlier version wrote it
    shot = recorded["shots"][0]
    shot |= {"sha256": None, "bridge": None}
    shot["attempts"][0] |= {"seq": 0, "sha256": None, "proof": ""}
    keys = {
        *recorded,
        "gimbal",
        "name",
        "tour",
        "parallax",
        "time_contradictions",
    }  # which an earlier version did not write
    assert {*between(text, f'(`"format": "{manifest.FORMAT}"`) has', "A shot has"), "format"} == keys
    assert set(between(text, "A shot has", "An attempt has")) == {*shot}
    assert set(between(text, "An attempt has", "What each value means")) == {*shot["attempts"][0]}


def test_topics_and_payloads() -> None:
    told = rows("MQTT")
    topics = Topics("panoexec", "<vehicle>")
    thumbnail = topics.thumbnail("<mission_id>", "<shot>")
    ours = (topics.status, topics.state, topics.state_delta, topics.plan, topics.event, thumbnail)
    answered = (topics.request("<command>"), topics.response("<command>"))
    assert set(told) == {topic.removeprefix("panoexec/<vehicle>/") for topic in (*ours, *answered)}
    within = {"ok", "age_s"}
    assert set(code(told["state"])) - within == set(State.model_fields)
    assert set(code(told["state/delta"])) - {"seq"} == set(StateDelta.model_fields)
    assert {*LinksFields.model_fields} <= set(re.findall(r"\w+", told["state"]))
    assert set(code(told["event"])) == {"type", "id", "time", *(field.name for field in dataclasses.fields(Event))}
    assert set(code(told["response/<command>"])) - {"ok"} == {*Response.model_fields, *ErrorFields.model_fields}


def test_commands_fields_and_error_codes() -> None:
    text = section("MQTT")
    assert between(text, "Commands are", "The fields of") == list(REQUESTS)
    fields = between(text, "and `start` are", "What is missing")
    named = {span for span in fields if re.fullmatch(r"\w+", span)}
    assert named == set(PlanRequest.model_fields) - {"transaction"}
    assert f'{{"{", ".join(ToleranceFields.model_fields)}"}}'.replace(", ", '", "') in fields
    assert set(between(text, "Error codes:", "Mission states:")) == set(get_args(ErrorCode))
    assert f"above {MAX_PAYLOAD // 1024} KiB" in flat(text)


def test_mission_states() -> None:
    assert between(section("MQTT"), "Mission states:", "; [mission.md]") == [state.value for state in MissionState]


def test_sections_of_the_configuration() -> None:
    assert [name.strip("[]") for name in rows("Configuration")] == list(Config.model_fields)


def test_options_that_are_planned_are_not_there_yet() -> None:
    built_for_others = {"--dry-run", "--json", "--listen", "--name", "--set"}  # named there, of verbs that have them
    known = {option for verb in COMMANDS for option in options(verb)} - built_for_others
    assert not known & set(re.findall(r"--[a-z-]+", PLANNED))


def test_code_cites_the_contract_by_its_file() -> None:
    """What a reader is sent to has to be in the repository."""
    for path in (ROOT / "panoexec").rglob("*.py"):
        for line in path.read_text(encoding="utf-8").splitlines():
            if re.search(r"\bcontract\b", line, re.IGNORECASE):
                assert "docs/contract.md" in line, f"{path.relative_to(ROOT)}: {line.strip()}"
