"""Whoever follows deltas has the same states as whoever gets whole ones, whatever is lost or repeated on the way."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from panoexec.cli.watch_view import Watched, fleet_view, mission_view
from panoexec.mission.log.states import MissionState
from panoexec.mqtt.messages import ErrorDegFields, LinkFields, LinksFields, PoseFields, State, dump
from panoexec.mqtt.outbox import Outbox, Outgoing
from panoexec.mqtt.state_deltas import StateFollower, merge_patch, patched
from panoexec.mqtt.state_forms import WHOLE_S, StateForms
from panoexec.mqtt.topics import Topics
from tests.schemas import misfits

TOPICS = Topics("panoexec", "drone")

# RFC 7386, appendix A, but for documents that are no objects
RFC: list[tuple[Any, Any, Any]] = [
    ({"a": "b"}, {"a": "c"}, {"a": "c"}),
    ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
    ({"a": "b"}, {"a": None}, {}),
    ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
    ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
    ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
    ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
    ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
    (["a", "b"], ["c", "d"], ["c", "d"]),
    ({"a": "b"}, ["c"], ["c"]),
    ({"a": "foo"}, None, None),
    ({"e": None}, {"a": 1}, {"e": None, "a": 1}),
    ([1, 2], {"a": "b", "c": None}, {"a": "b"}),
    ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
]


@pytest.mark.parametrize(("document", "patch", "result"), RFC)
def test_a_patch_does_what_the_rfc_says(document: Any, patch: Any, result: Any) -> None:
    before = json.dumps([document, patch])
    assert patched(document, patch) == result
    assert json.dumps([document, patch]) == before, "the arguments stay as they are"


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.sampled_from("abcd"), inner, max_size=3),
    max_leaves=8,
)
objects = st.dictionaries(st.sampled_from("abcd"), json_values, max_size=4)


def without_nulls(value: Any) -> Any:
    """What JSON merge patches can say: members that are null are missing."""
    if not isinstance(value, dict):
        return value
    return {key: without_nulls(inner) for key, inner in value.items() if inner is not None}


@given(objects, objects)
def test_a_patch_makes_one_document_the_other(old: dict[str, Any], new: dict[str, Any]) -> None:
    made = json.loads(json.dumps(patched(old, json.loads(json.dumps(merge_patch(old, new))))))
    assert json.dumps(without_nulls(made), sort_keys=True) == json.dumps(without_nulls(new), sort_keys=True)


links = st.builds(LinkFields, ok=st.booleans(), age_s=st.none() | st.floats(0, 99))
degrees = st.floats(-180, 180)
errors = st.none() | st.builds(ErrorDegFields, pitch=degrees, roll=degrees, yaw=degrees)
poses = st.builds(PoseFields, pitch_deg=degrees, roll_deg=degrees, yaw_deg=degrees, error_deg=errors)
texts = st.sampled_from(["", "reason", "ä\u2028"])
states = st.builds(
    State,
    state=st.sampled_from([MissionState.CAPTURING, MissionState.CAPTURING, MissionState.PAUSED]),
    mission_id=st.sampled_from([None, "m1", "m1", "m1"]),
    name=texts,
    shots_total=st.just(9),
    shots_done=st.integers(0, 9),
    attempts=st.integers(0, 20),
    retakes=st.integers(0, 20),
    shots=st.sampled_from(["", "d4 c1 t4", "d5 c1 t3"]),
    content=st.dictionaries(st.sampled_from(["ok", "blurred"]), st.integers(0, 9)),
    current=st.none() | st.integers(0, 8),
    eta_s=st.none() | st.floats(0, 999),
    reason=texts,
    resumable=st.sampled_from([None, None, "m0"]),
    link=st.builds(LinksFields, autopilot=links, gimbal=links, camera=links),
    pose=st.none() | poses,
    battery_frac=st.none() | st.floats(0, 1),
    boot_id=st.just("b"),
    seq=st.just(0),
    time=st.just("2026-11-22T07:58:03.100Z"),
)


@dataclass
class Vehicle:
    """The sending side on a slow link: what it hands to the broker, and the state that each message is about."""

    now_s: float = 0.0
    boot_id: str = "boot 1"
    seq: int = 0
    box: Outbox = field(default_factory=Outbox)
    forms: StateForms = field(init=False)

    def __post_init__(self) -> None:
        self.forms = StateForms(TOPICS, clock=lambda: self.now_s)
        self.forms.connected(may=True)

    def sends(self, state: State, *, form: int = 0) -> tuple[str, dict[str, Any], dict[str, Any]]:
        """Topic and document of the message in its best or last form, and the state as it would be as a whole."""
        self.seq += 1
        state = state.model_copy(update={"seq": self.seq, "boot_id": self.boot_id})
        self.box.put(Outgoing(topic=TOPICS.state, payload=dump(state), retain=True))
        (message,) = self.box.take(1, form=lambda one, _: self._forms(one)[form])
        self.forms.sent(message)
        self.box.done(message)
        assert len(self.box) == 0
        document = json.loads(message.payload)
        assert misfits(message.topic.removeprefix("panoexec/drone/").replace("/", "_"), document) == []
        true = json.loads(dump(state))
        for link in true["link"].values():
            link["age_s"] = None if link["age_s"] is None else int(link["age_s"])
        if (pose := true["pose"]) is not None:
            true["pose"] = {name: round(pose[name]) for name in ("pitch_deg", "roll_deg", "yaw_deg")}
            true["pose"]["error_deg"] = None
        return message.topic, document, true

    def _forms(self, message: Outgoing) -> tuple[Outgoing, ...]:
        return self.forms.of(message, held=self.box.held(TOPICS.state), slow=True)

    def connects_again(self) -> None:
        self.box.renew()
        for message in self.box.take(9):
            self.box.done(message)
        self.box.renew()
        self.forms.connected(may=True)


def taken(follower: StateFollower, topic: str, document: dict[str, Any]) -> dict[str, Any] | None:
    document = json.loads(json.dumps(document))
    return follower.delta(document) if topic == TOPICS.state_delta else follower.whole(document)


@settings(max_examples=50)
@given(
    st.lists(
        st.tuples(
            states,
            st.sampled_from([0, -1, -1]),
            st.sampled_from(["goes", "goes", "goes", "lost", "twice"]),
            st.floats(0, 20),
        ),
        min_size=3,
    )
)
def test_deltas_tell_what_whole_states_tell_and_the_next_one_heals(sent: list[tuple[State, int, str, float]]) -> None:
    vehicle, follower = Vehicle(), StateFollower()
    base_lost, shown, whole = True, Watched(), Watched()
    for state, form, fate, pause_s in sent:
        vehicle.now_s += pause_s
        topic, document, true = vehicle.sends(state, form=form)
        if topic == TOPICS.state:
            base_lost = fate == "lost"
        if fate == "lost":
            continue
        heard = taken(follower, topic, document)
        if fate == "twice":
            assert taken(follower, topic, document) in (heard, None)
        if base_lost:
            assert heard is None, "a delta of a state that did not arrive is not believed"
            continue
        assert json.dumps(heard, sort_keys=True) == json.dumps(true, sort_keys=True)
        shown.hear("state", heard)
        whole.hear("state", true)
    assert text_of(mission_view("drone", shown)) == text_of(mission_view("drone", whole)), "watch shows the same"
    assert text_of(fleet_view({"drone": shown})) == text_of(fleet_view({"drone": whole}))


def text_of(view: Any) -> str:
    console = Console(width=200)
    with console.capture() as capture:
        console.print(view)
    return capture.get()


def plain(**fields: Any) -> State:
    ok = LinkFields(ok=True, age_s=0.2)
    base = State(
        state=MissionState.CAPTURING,
        mission_id="20261122T075801.864Z",
        name="chapel, west",
        shots_total=56,
        shots_done=12,
        attempts=14,
        retakes=1,
        shots="d7 r1 d4 a1 c1 t42",
        content={},
        current=13,
        eta_s=71.5,
        reason="",
        resumable=None,
        link=LinksFields(autopilot=ok, gimbal=ok, camera=ok),
        pose=PoseFields(pitch_deg=-20.04, roll_deg=0.01, yaw_deg=60.2, error_deg=None),
        battery_frac=0.74,
        boot_id="a1126ae422a24e519cffb2281c56aebc",
        seq=91,
        time="2026-11-22T07:58:03.100Z",
    )
    return base.model_copy(update=fields)


def test_progress_leaves_as_a_delta_and_what_matters_as_a_whole() -> None:
    vehicle = Vehicle()
    assert vehicle.sends(plain())[0] == TOPICS.state, "nothing to build on yet"
    topic, document, _ = vehicle.sends(plain(shots_done=13, attempts=15, current=14, shots="d7 r1 d5 c1 t42"))
    assert topic == TOPICS.state_delta
    assert document["base"] == 1
    assert document["patch"].keys() == {"shots_done", "attempts", "current", "shots", "seq"}
    assert vehicle.sends(plain(eta_s=None))[1]["patch"] == {"eta_s": None, "seq": 3}
    changes: list[dict[str, Any]] = [{"reason": "battery"}, {"state": MissionState.PAUSED}, {"mission_id": "m2"}]
    for number, change in enumerate(changes):
        assert vehicle.sends(plain(**change))[0] == TOPICS.state, number
    vehicle.now_s += WHOLE_S
    assert vehicle.sends(plain(mission_id="m2"))[0] == TOPICS.state, "in any case every so often"
    assert vehicle.sends(plain(mission_id="m2"))[0] == TOPICS.state_delta
    vehicle.connects_again()
    assert vehicle.sends(plain(mission_id="m2"))[0] == TOPICS.state, "the broker may have lost it"
    vehicle.forms.refuse()
    vehicle.forms.connected(may=True)
    assert vehicle.sends(plain(mission_id="m2"))[0] == TOPICS.state, "a broker that refuses deltas gets none"


def test_what_is_sent_is_whole_as_long_as_the_link_is_not_slow_or_the_broker_keeps_nothing() -> None:
    message = Outgoing(topic=TOPICS.state, payload=dump(plain()), retain=True)
    plan = Outgoing(topic=TOPICS.plan, payload=b"{}", retain=True)
    forms = StateForms(TOPICS)
    forms.connected(may=False)
    assert forms.of(message, held=message.payload, slow=True) == (message,)
    forms.connected(may=True)
    assert forms.of(message, held=message.payload, slow=False) == (message,)
    assert forms.of(plan, held=plan.payload, slow=True) == (plan,)


def test_states_of_another_process_and_older_ones_are_not_mixed_up() -> None:
    follower, first = StateFollower(), Vehicle()
    _, whole, _ = first.sends(plain())
    _, delta, true = first.sends(plain(attempts=15))
    assert follower.delta(delta) is None
    assert follower.whole(whole) == whole
    assert follower.delta(delta) == true
    assert follower.whole(whole) == true, "a repeated older state takes nothing back"
    assert follower.delta(delta) is None
    second = Vehicle(boot_id="boot 2")
    _, other, _ = second.sends(plain())
    assert follower.delta(second.sends(plain(attempts=20))[1]) is None
    assert follower.whole(other) == other, "seq begins anew in each process"
    assert follower.delta(first.sends(plain(attempts=16))[1]) is None


@pytest.mark.parametrize("strange", [None, 1, [], {}, {"patch": 1}, {"patch": {}}, {"patch": {"seq": 5}, "base": 7}])
def test_a_strange_delta_changes_nothing(strange: Any) -> None:
    follower = StateFollower()
    whole = Vehicle().sends(plain())[1]
    follower.whole(whole)
    assert follower.delta(strange) is None
    assert follower.whole(whole) == whole
