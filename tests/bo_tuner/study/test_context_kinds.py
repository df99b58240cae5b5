"""Contexts that are integers, truth values or texts, and those that stand in the steps of a run."""

import itertools
from collections import Counter

import numpy as np
import pytest
from functions import make_study
from signal_runs import signal_study

from bo_tuner.errors import ParameterError, StudyError
from bo_tuner.study.braces import filled, filled_condition
from bo_tuner.study.changes import incomparable_changes
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.descriptors import Described, node_problems
from bo_tuner.study.distributions import Discrete, Triangular, Uniform
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml

LOAD = Uniform(bounds=(1.0, 2.0))
COUNT = Uniform(bounds=(1.0, 4.0))
BRAKE = Discrete(values=(False, True), probabilities=(0.9, 0.1))
ROOM = Discrete(values=("office", "garage", "yard"), probabilities=(0.5, 0.3, 0.2))


def space_of(**distributions):
    return ContextSpace(distributions, ["count"])


MIXED = space_of(load=LOAD, count=COUNT, brake=BRAKE, room=ROOM)
CONTEXT = {"load": 1.25, "count": 3, "brake": True, "room": "yard"}


class TestSpace:
    def test_a_context_and_back(self):
        row = MIXED.rows([CONTEXT])
        found = MIXED.to_dict(MIXED.to_contexts(MIXED.to_cube(row))[0])
        assert found == CONTEXT
        assert [type(value) for value in found.values()] == [float, int, bool, str]

    def test_texts_are_as_far_apart_whichever_they_are(self):
        points = MIXED.cube_of([CONTEXT | {"room": room} for room in ROOM.values])
        pairs = itertools.combinations(points, 2)
        assert [np.sum((a - b) ** 2) for a, b in pairs] == pytest.approx([1.0, 1.0, 1.0])
        assert MIXED.columns == ["load", "count", "brake", "room.0", "room.1", "room.2"]
        assert MIXED.dimension == 6

    def test_any_point_is_a_possible_context(self):
        points = np.random.default_rng(0).normal(0.5, 1.0, (300, MIXED.dimension))
        found = [MIXED.to_dict(row) for row in MIXED.to_contexts(points)]
        assert {context["room"] for context in found} == set(ROOM.values)
        assert {context["brake"] for context in found} == {False, True}
        assert {context["count"] for context in found} == {1, 2, 3, 4}
        assert all(1.0 <= context["load"] <= 2.0 for context in found)

    def test_draws_follow_the_probabilities(self):
        drawn = MIXED.draw_stratified(1000, np.random.default_rng(0))
        counts = Counter(MIXED.to_dict(row)["room"] for row in drawn)
        assert counts == {"office": 500, "garage": 300, "yard": 200}

    def test_integers_of_uniform_bounds_are_equally_probable(self):
        drawn = MIXED.draw_stratified(1000, np.random.default_rng(0))
        counts = Counter(MIXED.to_dict(row)["count"] for row in drawn)
        assert counts == {1: 250, 2: 250, 3: 250, 4: 250}

    def test_integers_of_another_distribution_are_the_nearest(self):
        """Of a triangle on [0, 2], an eighth of the area is below 1/2."""
        triangle = Triangular(bounds=(0.0, 2.0), mode=1.0)
        space = ContextSpace({"n": triangle}, ["n"])
        drawn = space.draw_stratified(800, np.random.default_rng(0))
        assert Counter(drawn[:, 0].tolist()) == {0.0: 100, 1.0: 600, 2.0: 100}

    def test_nominal_is_the_most_probable(self):
        nominal = MIXED.to_dict(MIXED.nominal())
        assert nominal == {"load": 1.5, "count": 2, "brake": False, "room": "office"}
        named = Discrete(values=("a", "b", "c"), nominal="c")
        space = space_of(room=named)
        assert space.to_dict(space.nominal()) == {"room": "c"}
        assert named.probabilities == pytest.approx((1 / 3,) * 3)

    def test_some_values_given_and_the_others_nominal(self):
        given = {"count": 3, "room": "yard"}
        completed = MIXED.completed(given)
        assert completed == MIXED.to_dict(MIXED.nominal()) | given
        assert [type(value) for value in completed.values()] == [float, int, bool, str]

    @pytest.mark.parametrize(
        ("given", "refusal"),
        [
            ({"lode": 1.0}, "expected load, count, brake, room, found 'lode'"),
            ({"load": 2.5}, "load: expected a possible value, the nearest is 2, found 2.5"),
            ({"load": 1.5, "count": 3.25}, "count: expected a possible value, the nearest is 3"),
            ({"load": float("nan")}, "finite"),
            ({"room": "attic"}, "room: expected one of"),
            ({"load": 1.5, "brake": 1}, "brake: expected one of"),
        ],
    )
    def test_values_that_are_not_possible(self, given, refusal):
        with pytest.raises(ParameterError, match=refusal):
            MIXED.completed(given)

    def test_corners_have_every_text_with_every_end(self):
        found = [tuple(MIXED.to_dict(row).values()) for row in MIXED.to_contexts(MIXED.corners())]
        expected = itertools.product([1.0, 2.0], [1, 4], [False, True], ROOM.values)
        assert Counter(found) == Counter(expected)

    def test_listed_integers_are_all_met(self):
        gear = Discrete(values=(1, 3, 4))
        space = ContextSpace({"load": LOAD, "gear": gear}, ["gear"])
        corners = [tuple(space.to_dict(row).values()) for row in space.to_contexts(space.corners())]
        assert Counter(corners) == Counter(itertools.product([1.0, 2.0], [1, 3, 4]))

    @pytest.mark.parametrize("most", [4, 40])
    def test_corners_that_would_be_too_many_still_have_every_text(self, most):
        texts = Discrete(values=tuple(f"map {k}" for k in range(most)))
        numbers = {f"x{k}": LOAD for k in range(6)}
        space = space_of(**numbers, site=texts, room=ROOM)
        corners = [space.to_dict(row) for row in space.to_contexts(space.corners())]
        assert len(corners) == max(32, most)
        assert {c["site"] for c in corners} == set(texts.values)
        assert {c["room"] for c in corners} == set(ROOM.values)
        ends = {tuple(c[f"x{k}"] for k in range(5)) for c in corners}
        assert ends == set(itertools.product([1.0, 2.0], repeat=5))

    @pytest.mark.parametrize(
        "wrong", [{"room": "cellar"}, {"room": 1}, {"brake": 1}, {"brake": "yes"}, {"load": "1"}]
    )
    def test_other_values_are_none(self, wrong):
        with pytest.raises(ParameterError, match="expected"):
            MIXED.cube_of([CONTEXT | wrong])


NODE = {"node": "axis"}
KINDS = {
    "payload": NODE | {"type": "integer", "distribution": "uniform", "bounds": [0, 6]},
    "gear": NODE | {"type": "integer", "distribution": "discrete", "values": [1, 2, 4]},
    "brake": NODE | {"distribution": "discrete", "values": [False, True]},
    "room": NODE | {"distribution": "discrete", "values": ["office", "yard"], "nominal": "yard"},
}


class TestStudy:
    def test_nodes_get_values_of_their_type(self):
        study = make_study(contexts=KINDS)
        assert [item.type for item in study.contexts.values()] == [
            "integer", "integer", "boolean", "string",
        ]  # fmt: skip
        space = study.context_space()
        context = space.to_dict(space.to_contexts(np.full((1, 4), 1.0))[0])
        values = study.assignments({"gain": 0.5}, context, 1)["axis"]
        assert values == {
            "gain": 0.5, "payload": 6, "gear": 4, "brake": True, "room": "yard", "seed": 1,
        }  # fmt: skip
        assert [type(values[name]) for name in KINDS] == [int, int, bool, str]

    def test_a_study_file_keeps_them(self):
        study = make_study(contexts=KINDS)
        assert parse_study(study_to_yaml(study)) == study

    @pytest.mark.parametrize(
        ("variable", "refusal"),
        [
            ({"values": [1, "a"]}, "values: expected values of one type"),
            ({"values": [True, 2]}, "values: expected values of one type"),
            ({"values": ["a", "a"]}, "values: expected different values"),
            ({"values": ["a"]}, "values: expected at least two values, found 1"),
            ({"values": ["a", "b"], "nominal": "c"}, "nominal: c is none of the values"),
            ({"values": [False, True], "nominal": 1}, "nominal: 1 is none of the values"),
            ({"values": ["a", "b"], "type": "integer"}, "type: expected string, as its values are"),
            ({"values": [1, 2], "type": "boolean"}, "type: expected double, as its values are"),
            ({"values": [1, 2], "type": "text"}, "type: unknown 'text'"),
            (
                {"values": [1, 2.5], "type": "integer"},
                "type: expected integers as the values or bounds of an integer, found 2.5",
            ),
            ({"values": [f"v{k}" for k in range(51)]}, "values: expected at most 50 entries"),
        ],
    )
    def test_refused(self, variable, refusal):
        with pytest.raises(StudyError) as error:
            make_study(contexts={"c": NODE | {"distribution": "discrete"} | variable})
        assert str(error.value).startswith(f"contexts.c.{refusal}")

    def test_another_type_is_another_variable(self):
        then = make_study(contexts=KINDS)
        as_double = {key: value for key, value in KINDS["payload"].items() if key != "type"}
        now = make_study(contexts=KINDS | {"payload": as_double})
        assert incomparable_changes(then, now) == [
            "contexts.payload.type text 'integer' -> text 'double'"
        ]

    def test_a_node_with_another_type_is_told(self):
        study = make_study(contexts=KINDS)
        known = {
            "gain": Described("double", 0.5),
            "seed": Described("integer", 1),
            "payload": Described("double", 1.0),
            "gear": Described("integer", 1, lower=1, upper=3),
            "brake": Described("boolean", False),
            "room": Described("string", "office"),
        }
        assert [str(problem) for problem in node_problems(study, "axis", known)] == [
            "contexts.payload: 'payload' is of type double in the node, not integer",
            "contexts.gear: 4 lies outside the range of 'gear' in the node, [1, 3]",
        ]


IN_STEPS = {"x": 0.1, "n": 3, "on": True, "room": "yard"}


class TestBraces:
    @pytest.mark.parametrize(
        ("content", "expected"),
        [
            ({"pose": {"x": "{x}", "y": 2}}, {"pose": {"x": 0.1, "y": 2}}),
            (["{n}", "{on}", "{room}"], [3, True, "yard"]),
            ("go to {room} {n} times, {on}", "go to yard 3 times, true"),
            ("{x}", 0.1),
            ("{{room}} is {room}", "{room} is yard"),
            ('{"data": {"x": {x}}}', '{"data": {"x": 0.1}}'),
            ("{}", "{}"),
            ("{ x }", "{ x }"),
            (7, 7),
        ],
    )
    def test_content(self, content, expected):
        found = filled(content, IN_STEPS)
        assert found == expected
        assert type(found) is type(expected)

    def test_conditions_have_numbers(self):
        found = filled_condition("abs(p - {x}) < 0.1 and {on} == 1", IN_STEPS | {"x": -2.5})
        assert found == "abs(p - (-2.5)) < 0.1 and (1.0) == 1"


GOAL = {"distribution": "uniform", "bounds": [-1.0, 1.0]}
RUN = {
    "before": [{"wait_until": {"condition": "abs(angle - {goal}) < 2"}}],
    "start": [{"publish": {"topic": "/setpoint", "message": {"data": "{goal}"}}}],
    "end": {"after": 2.0},
}


def study_of(run=None, **contexts):
    return study_from_mapping(
        signal_study(run=RUN | (run or {}), contexts={"goal": GOAL} | contexts)
    )


class TestSteps:
    def test_a_variable_without_a_node_is_set_on_none(self):
        study = study_of()
        assert study.assignments({"gain": 0.5}, {"goal": 0.3}, 1) == {"servo": {"gain": 0.5}}
        assert parse_study(study_to_yaml(study)) == study

    @pytest.mark.parametrize(
        ("changes", "refusal"),
        [
            (
                {"start": [{"publish": {"topic": "/s", "message": {"data": "{goall}"}}}]},
                "run.start[0].publish.message: there is no context or parameter 'goall'; did you "
                "mean 'goal'?",
            ),
            (
                {"after": [{"wait": 1.0}, {"call": {"service": "/s", "request": {"d": "to {y}"}}}]},
                "run.after[1].call.request: there is no context or parameter 'y'",
            ),
            (
                {"start": [{"send_goal": {"action": "/a", "goal": {"p": {"x": ["{x}"]}}}}]},
                "run.start[0].send_goal.goal: there is no context or parameter 'x'",
            ),
            (
                {"before": [{"wait_until": {"condition": "angle > {x}"}}]},
                "run.before[0].wait_until.condition: there is no context or parameter 'x'",
            ),
            (
                {"end": {"when": "angle > {x}"}},
                "run.end.when: there is no context or parameter 'x'",
            ),
            (
                {"abort_when": "abs(angle - {goal}) > 3"},
                "run.abort_when: expected no name in braces, found 'goal'",
            ),
            (
                {"after": [{"publish": {"topic": "/s", "message": {"data": "{goal}"}}}]},
                "run.after[0].publish.message: expected no context, found 'goal'",
            ),
        ],
    )
    def test_names_of_no_context(self, changes, refusal):
        with pytest.raises(StudyError) as error:
            study_of(run=changes)
        assert str(error.value).startswith(refusal)

    def test_one_that_is_used_nowhere(self):
        with pytest.raises(StudyError) as error:
            study_of(gaol=GOAL)
        assert str(error.value).startswith("contexts.gaol: is used nowhere; expected node, or")

    def test_one_of_a_study_without_a_run(self):
        with pytest.raises(StudyError, match="is used nowhere"):
            make_study(contexts={"goal": GOAL})

    def test_a_text_in_a_condition(self):
        room = {"distribution": "discrete", "values": ["a", "b"]}
        with pytest.raises(StudyError, match="'goal' is a text; expected a number"):
            study_of(goal=room)

    def test_a_parameter_without_a_node(self):
        with pytest.raises(StudyError, match=r"contexts.goal.parameter: without a node there is"):
            study_of(goal=GOAL | {"parameter": "goal"})

    def test_one_of_a_node_may_be_used_as_well(self):
        assert study_of(goal=GOAL | {"node": "servo"}).contexts["goal"].parameter == "goal"
