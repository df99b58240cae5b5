"""The study file: what is read, what is refused and with which words."""

import copy
import dataclasses
import math
import pickle
from importlib.machinery import ModuleSpec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bo_tuner import package_files
from bo_tuner.errors import BoTunerError, PackageFilesError, StudyError
from bo_tuner.study import strict_yaml
from bo_tuner.study.distributions import Discrete, TruncatedNormal
from bo_tuner.study.parts import Budget, Objective
from bo_tuner.study.study_file import (
    load_study,
    parse_study,
    shipped_studies,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)

STUDY = """\
name: drive
nodes:
  drive: {node: drive, result: ~/cut_result}
parameters:
  gains.kp: {node: drive, type: double, bounds: [0, 10.0], default: 1}
  window: {node: drive, type: integer, bounds: [1, 9], default: 3, minimum_correlation: 0.1}
  span: {node: drive, type: integer, bounds: [1, 12], default: 4}
  echo: {node: drive, type: integer, tied_to: window}
  offset: {node: drive, type: double, fixed: 2}
order: [[window, span]]
contexts:
  load: {node: drive, distribution: uniform, bounds: [1, 2]}
seed_parameter: {node: drive, parameter: seed}
trigger: {node: drive, service: ~/run}
metrics:
  error: {node: drive}
  peak: {node: drive, key: peak_p99, unit: A}
objective: {metric: error}
constraints:
  current: {kind: chance, metric: peak, upper: 3, probability: 0.9}
  worst: {kind: worst_case, metric: peak, upper: 5}
budget: {trials: 12, initial_trials: 4}
"""


def mapping():
    return strict_yaml.parse(STUDY).value


def put(value, *path):
    """The study with a value put in; a callable value changes what is there."""
    changed = mapping()
    inner = changed
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return changed


def refusal(changed):
    with pytest.raises(StudyError) as caught:
        study_from_mapping(changed)
    text = str(caught.value)
    assert "\n" not in text
    return text


class TestShippedStudies:
    def test_names(self):
        assert shipped_studies() == ["benchmark", "full"]

    def test_benchmark_is_the_scenario(self):
        study = load_study("benchmark")
        space = study.search_space()
        assert space.names == ("control_horizon", "lambda_mpc")
        np.testing.assert_array_equal([space.lower, space.upper], [[1, -5], [20, 1]])
        assert space.defaults == {
            "control_horizon": 15,
            "prediction_horizon": 15,
            "lambda_mpc": -3.0,
            "lambda_kf": -1.0,
        }
        assert study.budget == Budget(
            trials=30,
            initial_trials=10,
            drawn_contexts=5,
            search_evaluations=10,
            validation_draws=25,
        )

    def test_full_is_the_scenario(self):
        study = load_study("full")
        space = study.search_space()
        assert space.names == ("control_horizon", "prediction_horizon", "lambda_mpc", "lambda_kf")
        np.testing.assert_array_equal([space.lower, space.upper], [[1, 1, -5, -5], [20, 25, 1, 2]])
        assert study.order == (("control_horizon", "prediction_horizon"),)
        assert space.defaults == load_study("benchmark").search_space().defaults
        assert (study.budget.trials, study.budget.initial_trials) == (80, 20)

    @pytest.mark.parametrize("name", ["benchmark", "full"])
    def test_contexts_and_constraints_are_the_scenario(self, name):
        study = load_study(name)
        assert study.name == name
        assert list(study.contexts) == ["stiffness_factor", "damping_factor"]
        for variable in study.contexts.values():
            assert variable.distribution == TruncatedNormal(
                mean=1.0, standard_deviation=0.2, bounds=(0.7, 1.3), nominal=1.0
            )
        (real_time,) = study.chance_constraints
        assert real_time.probability == 0.96
        assert study.metrics[real_time.metric].key == "return_time_p99"
        worst = study.worst_case_constraint
        assert worst is not None
        assert (worst.metric, worst.upper) == ("overshoot", 0.09)
        assert (study.objective.metric, study.objective.scale) == ("tracking_error", "log")
        assert study.nodes["controller"].inprocess_parameters == {"return_time": "modelled"}


class TestReading:
    def test_types_and_defaults(self):
        study = parse_study(STUDY)
        gain = study.parameters["gains.kp"]
        assert (gain.bounds, gain.default) == ((0.0, 10.0), 1.0)
        assert all(type(value) is float for value in (*gain.bounds, gain.default))
        assert type(study.parameters["window"].default) is int
        assert study.parameters["offset"].fixed == study.parameters["offset"].default == 2.0
        assert study.metrics["error"].key == "error"
        assert study.trigger.timeout == 30.0
        assert (study.seed, study.description) == (1, "")
        assert study.search_space().defaults == {
            "gains.kp": 1.0,
            "window": 3,
            "span": 4,
            "echo": 3,
            "offset": 2.0,
        }
        assert study.context_space().names == ("load",)

    def test_sections_that_may_be_left_out(self):
        changed = mapping()
        for key in ("contexts", "constraints", "order", "seed_parameter"):
            del changed[key]
        study = study_from_mapping(changed)
        assert study.context_space().dimension == 0
        assert study.worst_case_constraint is None
        assert study.chance_constraints == ()
        assert study == study_from_mapping(
            changed | {"contexts": {}, "constraints": {}, "order": []}
        )

    def test_one_and_twelve_parameters(self):
        fields = {"node": "drive", "type": "double", "bounds": [0, 1], "default": 0}
        for count in (1, 12):
            changed = mapping() | {"parameters": {f"p{i}": fields for i in range(count)}}
            changed["order"] = []
            assert study_from_mapping(changed).search_space().dimension == count

    def test_node_parameters_of_every_ros_type(self):
        values = {"a": True, "b": 3, "c": 0.5, "group.d": "x", "e": [1, 2], "f": [0.5], "g": ["x"]}
        node = study_from_mapping(put(values, "nodes", "drive", "parameters")).nodes["drive"]
        assert node.parameters == values | {"e": (1, 2), "f": (0.5,), "g": ("x",)}

    def test_assignments_go_to_nodes_under_their_own_names(self):
        changed = put("gain", "parameters", "gains.kp", "parameter")
        changed["contexts"]["load"]["parameter"] = "mass"
        study = study_from_mapping(changed)
        told = study.assignments({"gains.kp": 2.0, "window": 3}, {"load": 1.5}, 7)
        assert told == {"drive": {"gain": 2.0, "window": 3, "mass": 1.5, "seed": 7}}

    def test_a_study_cannot_be_changed_and_can_be_sent_to_a_process(self):
        study = load_study("full")
        with pytest.raises(dataclasses.FrozenInstanceError):
            study.seed = 2
        assert pickle.loads(pickle.dumps(study)) == study


class TestWriting:
    @pytest.mark.parametrize("name", ["benchmark", "full"])
    def test_shipped_study_as_run_reads_back_equal(self, name):
        study = load_study(name).replace(seed=5, trials=7)
        again = parse_study(study_to_yaml(study))
        assert again == study
        assert list(again.parameters) == list(study.parameters)

    def test_every_kind_of_value_reads_back_equal(self):
        changed = mapping()
        changed["nodes"]["drive"] |= {
            "package": "drives",
            "executable": "drive",
            "object": "drives.sim:Drive",
            "parameters": {"a": True, "b": "1e3", "c": 1e-7, "d": ["yes", "012", ""], "e": [1]},
        }
        changed["contexts"]["load"] = {
            "node": "drive",
            "distribution": "discrete",
            "values": [1, 2.5],
            "probabilities": [0.25, 0.75],
            "nominal": 1,
        }
        changed["objective"] = {"metric": "error", "scale": "log", "direction": "maximize"}
        changed["description"] = "Two\nlines: with 'quotes', # and \u00b5m"
        study = study_from_mapping(changed)
        assert isinstance(study.contexts["load"].distribution, Discrete)
        assert parse_study(study_to_yaml(study)) == study
        assert study_from_mapping(study_to_mapping(study)) == study

    @given(
        st.recursive(
            st.none()
            | st.booleans()
            | st.integers(-(2**63), 2**63)
            | st.text(max_size=12)
            | st.floats(allow_nan=False)
            | st.sampled_from(["1e3", "0o7", "on", "~", "1_0", "012"]),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.text(max_size=5), inner, max_size=3)
            ),
            max_leaves=8,
        )
    )
    @settings(max_examples=150, deadline=None, derandomize=True)
    def test_whatever_is_dumped_is_parsed_unchanged(self, value):
        again = strict_yaml.parse(strict_yaml.dump(value)).value
        assert again == value
        assert repr(again) == repr(value)


class TestReplace:
    def test_seed_and_budget(self):
        study = parse_study(STUDY)
        other = study.replace(
            seed=9, trials=30, initial_trials=6, drawn_contexts=3, search_evaluations=0
        )
        assert other.seed == 9
        assert other.budget == Budget(
            trials=30, initial_trials=6, drawn_contexts=3, search_evaluations=0, validation_draws=25
        )
        assert study == parse_study(STUDY)
        assert study.replace() == study

    @pytest.mark.parametrize(
        ("section", "message"),
        [
            ({"draws": 1}, "certificate.draws: expected an integer of at least 2, found 1"),
            ({"confidence": 1.0}, "certificate.confidence: "),
            ({"confidence": 0}, "certificate.confidence: "),
            ({"draw": 300}, "certificate.draw: unknown key; did you mean 'draws'?"),
            (300, "certificate: expected a mapping"),
        ],
    )
    def test_what_a_certificate_needs_is_checked(self, section, message):
        mapping = study_to_mapping(parse_study(STUDY)) | {"certificate": section}
        with pytest.raises(StudyError) as caught:
            study_from_mapping(mapping)
        assert str(caught.value).startswith(message)

    def test_fewer_trials_than_the_initial_design(self):
        assert parse_study(STUDY).replace(trials=2).budget.initial_trials == 2

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"trials": 0}, "budget.trials: expected an integer of at least 1, found 0"),
            ({"initial_trials": 13}, "budget.initial_trials: 13 are more than the 12 trials"),
            ({"validation_draws": 0}, "budget.validation_draws: expected an integer of at least 1"),
            ({"seed": -1}, "seed: expected an integer of at least 0, found -1"),
        ],
    )
    def test_is_checked_again(self, change, message):
        with pytest.raises(StudyError) as caught:
            parse_study(STUDY).replace(**change)
        assert str(caught.value).startswith(message)


class TestObjective:
    values = np.array([0.2, 1.0, 40.0])

    @pytest.mark.parametrize("scale", ["linear", "log"])
    @pytest.mark.parametrize("direction", ["minimize", "maximize"])
    def test_cost_falls_as_the_metric_gets_better(self, scale, direction):
        objective = Objective(metric="error", scale=scale, direction=direction)
        cost = objective.to_cost(self.values)
        assert np.all(np.diff(cost) > 0.0) == (direction == "minimize")
        np.testing.assert_allclose(objective.from_cost(cost), self.values)

    def test_log_of_what_is_not_positive_is_not_a_number(self):
        cost = Objective(metric="error", scale="log").to_cost([0.0, -1.0, np.nan, 1.0])
        assert np.all(np.isnan(cost) == [True, True, True, False])


NUMBERS_REFUSED = [
    ("3", "found text '3'"),
    (True, "found true"),
    (None, "found nothing"),
    ([3], "found a list of 1"),
    ({"x": 3}, "found a mapping"),
]


class TestRefusedTypes:
    @pytest.mark.parametrize(("value", "found"), [(3.0, "found 3.0"), *NUMBERS_REFUSED[:2]])
    @pytest.mark.parametrize("key", ["default", "fixed"])
    def test_integer_parameter(self, key, value, found):
        changed = put({"node": "drive", "type": "integer", key: value}, "parameters", "window")
        if key == "default":
            changed["parameters"]["window"]["bounds"] = [1, 9]
        assert refusal(changed) == f"parameters.window.{key}: expected an integer, {found}"

    @pytest.mark.parametrize(("value", "found"), [(3.0, "found 3.0"), *NUMBERS_REFUSED])
    def test_integer_setting(self, value, found):
        message = refusal(put(value, "budget", "trials"))
        assert message == f"budget.trials: expected an integer, {found}"

    @pytest.mark.parametrize(
        ("value", "found"),
        [
            *NUMBERS_REFUSED,
            (math.nan, "found nan"),
            (math.inf, "found inf"),
            (-math.inf, "found -inf"),
        ],
    )
    def test_double_setting(self, value, found):
        message = refusal(put(value, "constraints", "worst", "upper"))
        assert message.startswith("constraints.worst.upper: expected a ")
        assert message.endswith(found)

    @pytest.mark.parametrize("value", [math.nan, math.inf])
    @pytest.mark.parametrize(
        "path",
        [
            ("parameters", "gains.kp", "default"),
            ("parameters", "offset", "fixed"),
            ("contexts", "load", "nominal"),
            ("trigger", "timeout"),
        ],
    )
    def test_double_that_is_not_finite(self, path, value):
        assert refusal(put(value, *path)).startswith(
            f"{'.'.join(path)}: expected a finite number, found"
        )

    @pytest.mark.parametrize("value", [None, 3, "text", [1]])
    @pytest.mark.parametrize("section", ["nodes", "parameters", "contexts", "metrics", "budget"])
    def test_section_that_is_no_mapping(self, section, value):
        assert refusal(put(value, section)).startswith(f"{section}: expected a mapping")

    def test_integers_beyond_64_bits(self):
        assert "64-bit" in refusal(put(2**63, "seed"))
        assert "64-bit" in refusal(put(10**5000, "parameters", "gains.kp", "default"))


class TestRefusedValues:
    @pytest.mark.parametrize(
        ("path", "value", "problem"),
        [
            (
                "parameters/gains.kp/bounds",
                [5, -5],
                "lower bound 5.0 is not below upper bound -5.0",
            ),
            ("parameters/window/bounds", [3, 3], "both bounds are 3; use fixed: 3"),
            (
                "parameters/gains.kp/bounds",
                [0, 1, 2],
                "expected bounds [lower, upper], found a list of 3",
            ),
            (
                "parameters/window/bounds",
                None,
                "missing; expected [lower, upper] (or tied_to or fixed instead)",
            ),
            ("parameters/window/default", None, "missing; expected the hand-tuned value"),
            ("parameters/window/default", 10, "10 lies outside the bounds [1, 9]"),
            ("parameters/window/bounds", [1, 2**60], "expected bounds of at most 2^53 in size"),
            (
                "parameters/window/type",
                "float",
                "unknown 'float'; expected one of double, integer, boolean, string",
            ),
            (
                "parameters/window/minimum_correlation",
                1.0,
                "expected a number between 0 and 1, both excluded, found 1.0",
            ),
            (
                "parameters/gains.kp/minimum_correlation",
                0.1,
                "applies to integers only; leave it out",
            ),
            ("parameters/offset/bounds", [1, 2], "a fixed parameter has no bounds; leave it out"),
            ("parameters/offset/default", 3, "3 differs from the fixed value 2.0; leave it out"),
            ("parameters/echo/bounds", [1, 2], "a tied parameter has no bounds; leave it out"),
            (
                "parameters/echo/tied_to",
                "windw",
                "there is no other parameter 'windw'; did you mean 'window'?",
            ),
            ("metrics/peak/node", "drve", "there is no node 'drve'; did you mean 'drive'?"),
            ("seed_parameter/node", "drve", "there is no node 'drve'; did you mean 'drive'?"),
            ("trigger/node", ["drive"], "expected text, found a list of 1"),
            ("objective/metric", "eror", "there is no metric 'eror'; did you mean 'error'?"),
            (
                "constraints/worst/metric",
                "speed",
                "there is no metric 'speed'; expected one of error, peak",
            ),
            (
                "constraints/current/kind",
                "worst-case",
                "unknown 'worst-case'; did you mean 'worst_case'?",
            ),
            ("constraints/current/probability", "96 %", "expected a number, found text '96 %'"),
            (
                "constraints/current/probability",
                96,
                "expected a number between 0 and 1, both excluded, found 96.0",
            ),
            (
                "constraints/worst/probability",
                0.4,
                "expected at least 0.5 of a worst_case constraint, found 0.4",
            ),
            ("trigger/timeout", 0, "expected a number above 0, found 0.0"),
            ("budget/search_evaluations", -1, "expected an integer of at least 0, found -1"),
            ("budget/initial_trials", 13, "13 are more than the 12 trials in all"),
            ("metrics", {}, "expected at least one"),
            (
                "name",
                "two words",
                "expected a name of letters, digits, _ and -, found text 'two words'",
            ),
            (
                "name",
                "../evil",
                "expected a name of letters, digits, _ and -, found text '../evil'",
            ),
            (
                "nodes/drive/node",
                "/drive",
                "expected a node name without leading slash such as axis, found text '/drive'",
            ),
            (
                "nodes/drive/result",
                "a b",
                "expected a topic name such as ~/cut_result, found text 'a b'",
            ),
            (
                "nodes/drive/object",
                "drives.Drive",
                "expected module:name such as axis.simulation:Axis, found text 'drives.Drive'",
            ),
            (
                "contexts/load/distribution",
                "normal",
                "unknown 'normal'; did you mean 'truncated_normal'?",
            ),
            (
                "contexts/load/mean",
                1.0,
                "unknown key; expected one of node, distribution, unit, parameter, bounds, nominal",
            ),
        ],
    )
    def test_problem_at_the_value(self, path, value, problem):
        keys = path.split("/")
        assert refusal(put(value, *keys)) == f"{'.'.join(keys)}: {problem}"

    @pytest.mark.parametrize(
        ("path", "value", "message"),
        [
            (
                "constraints/current",
                {"kind": "chance", "metric": "peak", "upper": 3},
                "constraints.current.probability: missing; a chance constraint needs one, such as "
                "0.96",
            ),
            (
                "constraints/second",
                {"kind": "worst_case", "metric": "error", "upper": 1},
                "constraints.second.kind: 'worst' is already a worst_case constraint; expected "
                "at most one",
            ),
            (
                "order",
                [["span", "window"]],
                "order[0]: expected 'span' <= 'window', found the defaults 4 and 3",
            ),
            (
                "order",
                [["window", "spam"]],
                "order[0][1]: there is no parameter 'spam'; did you mean 'span'?",
            ),
            (
                "order",
                [["window"]],
                "order[0]: expected [smaller, larger], two names of parameters, found a list of 1",
            ),
            (
                "nodes/drive/package",
                "drives",
                "nodes.drive.executable: missing; package alone does not start a node",
            ),
            (
                "nodes/drive/parameters",
                {"x": None},
                "nodes.drive.parameters.x: expected a number, text, true, false or a list of "
                "these, found nothing",
            ),
            (
                "nodes/drive/parameters",
                {"x": math.nan},
                "nodes.drive.parameters.x: expected a finite number, found nan",
            ),
            (
                "nodes/drive/parameters",
                {"x": [1, 2.0]},
                "nodes.drive.parameters.x: expected a list of values of one type, at least one",
            ),
            (
                "nodes/drive/parameters",
                {"window": 3},
                "parameters.window: parameter 'window' of node 'drive' is already set by "
                "nodes.drive",
            ),
            (
                "seed_parameter/parameter",
                "window",
                "seed_parameter: parameter 'window' of node 'drive' is already set by "
                "parameters.window",
            ),
            (
                "contexts/load",
                {"node": "drive"},
                "contexts.load.distribution: missing; expected one of truncated_normal, "
                "uniform, beta, triangular, discrete",
            ),
        ],
    )
    def test_problem_elsewhere(self, path, value, message):
        assert refusal(put(value, *path.split("/"))) == message

    @pytest.mark.parametrize("name", ["1st", "a b", "a..b", ".a", "a.", "", "\u00e4", "a\nb"])
    def test_names_that_ros_does_not_take(self, name):
        changed = put(mapping()["parameters"]["gains.kp"], "parameters", name)
        assert "expected a ROS parameter name such as gains.kp" in refusal(changed)

    @pytest.mark.parametrize(
        ("path", "suggestion"),
        [
            (("trials",), "expected one of name, nodes"),
            (("objectiv",), "did you mean 'objective'?"),
            (("parameters", "window", "bound"), "did you mean 'bounds'?"),
            (("parameters", "window", "name"), "expected one of node, type"),
            (("contexts", "load", "distributon"), "did you mean 'distribution'?"),
            (("budget", "trails"), "did you mean 'trials'?"),
        ],
    )
    def test_unknown_key(self, path, suggestion):
        message = refusal(put(1, *path))
        assert message.startswith(f"{'.'.join(path)}: unknown key; {suggestion}")

    @pytest.mark.parametrize("key", ["name", "nodes", "metrics", "objective", "budget"])
    def test_missing_section(self, key):
        changed = mapping()
        del changed[key]
        assert refusal(changed) == f"{key}: missing"

    @pytest.mark.parametrize("key", [1, None, True, ("a",)])
    def test_key_that_is_no_text(self, key):
        assert "expected text as a key" in refusal(put(1, key))
        assert "expected a name" in refusal(put({}, "metrics", key))


class TestLines:
    """Errors of a file name the file, the line and the path of keys."""

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (
                "bounds: [0, 10.0]",
                "bounds: [1.0, -5.0]",
                "5: parameters.gains.kp.bounds: lower bound 1.0 is not below upper bound -5.0",
            ),
            ("trials: 12, ", "", "22: budget.trials: missing"),
            ("  peak:", "  error:", "17: metrics.error: given twice, first in line 16"),
            ("order:", "ordr:", "10: ordr: unknown key; did you mean 'order'?"),
            ("name: drive\n", "name: drive\nname: b\n", "2: name: given twice, first in line 1"),
            ("[[window, span]]", "[[window,\n span]]\n extra", "12: not valid YAML:"),
            ("[[window, span]]", "[[window, span", "11: not valid YAML:"),
            ("name: drive", "name: drive\x07", "1: not a text file: character 0x7"),
            ("name: drive", "name: &a drive", "1: name: anchors and aliases"),
            ("name: drive", "name: *a", "1: name: anchors and aliases"),
            ("name: drive", "name: !!str drive", "1: name: tags (!) are not supported"),
            ("name: drive", "name: !!python/object/apply:os.getcwd []", "1: name: tags (!)"),
            ("name: drive", "? [a]\n: b", "1: expected text as a key"),
            ("name: drive", "1: b", "1: expected text as a key, found 1"),
            ("name: drive", "<<: {name: drive}", "1: <<: unknown key"),
            ("budget:", "---\nbudget:", "22: expected a single document"),
            ("name: drive", f"seed: {'9' * 5000}", "1: seed: integer of too many digits"),
            ("name: drive", f"name: {'[' * 5000}", "1: name: nested deeper than 20 levels"),
        ],
    )
    def test_message(self, old, new, message):
        assert old in STUDY
        with pytest.raises(StudyError) as caught:
            parse_study(STUDY.replace(old, new, 1), "mine.yaml")
        assert str(caught.value).startswith(f"mine.yaml:{message}")
        assert "\n" not in str(caught.value)
        assert isinstance(caught.value, (BoTunerError, ValueError))
        assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)

    def test_long_and_unprintable_keys_stay_on_one_short_line(self):
        with pytest.raises(StudyError) as caught:
            parse_study(f'"a\\n{"b" * 500}": 1', "mine.yaml")
        assert str(caught.value).startswith("mine.yaml:1: a\\nbbb")
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 300


class TestScalars:
    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("1e-3", 1e-3), ("1.5E3", 1500.0), ("-.5", -0.5), ("3.", 3.0), ("12", 12),
            ("-7", -7), ("012", 12), ("on", "on"), ("yes", "yes"), ("1:30", "1:30"),
            ("2020-01-01", "2020-01-01"), ("true", True), ("~", None), ("", None),
            ("'12'", "12"), ('"1e3"', "1e3"), (".inf", math.inf), ("-.inf", -math.inf),
        ],
    )  # fmt: skip
    def test_core_schema(self, text, value):
        found = strict_yaml.parse(f"key: {text}").value["key"]
        assert found == value
        assert type(found) is type(value)

    def test_not_a_number(self):
        assert math.isnan(strict_yaml.parse(".nan").value)

    @pytest.mark.parametrize("text", ["", "# only a comment\n", "---\n...\n"])
    def test_empty_file(self, text):
        with pytest.raises(StudyError, match=r"^mine.yaml: expected a mapping, found nothing$"):
            parse_study(text, "mine.yaml")


class TestFiles:
    def test_path(self, tmp_path):
        path = tmp_path / "mine.yaml"
        path.write_text(STUDY, encoding="utf-8")
        assert load_study(path) == load_study(str(path)) == parse_study(STUDY)

    def test_byte_order_mark_and_windows_line_ends(self, tmp_path):
        path = tmp_path / "mine.yaml"
        path.write_bytes(b"\xef\xbb\xbf" + STUDY.replace("\n", "\r\n").encode())
        assert load_study(path) == parse_study(STUDY)

    def test_name_wins_over_a_file_beside(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        Path("benchmark").write_text("nonsense", encoding="utf-8")
        assert load_study("benchmark").name == "benchmark"

    @pytest.mark.parametrize("name", ["benchmrk", "", "no such\nname"])
    def test_unknown_name_lists_the_shipped_ones(self, name):
        with pytest.raises(StudyError, match=r"shipped are benchmark, full") as e:
            load_study(name)
        assert "\n" not in str(e.value)

    @pytest.mark.parametrize(
        ("content", "problem"),
        [
            (b"\xff\xfe\x00n", "mine.yaml:1: expected UTF-8 text"),
            (b"a: 1\nb: \xe9", "mine.yaml:2: expected UTF-8 text"),
            (b"\x7fELF\x00\x01", "mine.yaml:1: not a text file"),
            (b"#" * 1_000_001, "mine.yaml: expected a file of at most 1 MB"),
        ],
    )
    def test_content_that_is_no_study(self, tmp_path, monkeypatch, content, problem):
        monkeypatch.chdir(tmp_path)
        Path("mine.yaml").write_bytes(content)
        with pytest.raises(StudyError) as caught:
            load_study("mine.yaml")
        assert str(caught.value).startswith(problem)

    def test_unreadable(self, tmp_path):
        with pytest.raises(StudyError, match=r"none.yaml: cannot be read: No such file"):
            load_study(tmp_path / "none.yaml")
        with pytest.raises(StudyError, match="cannot be read: Is a directory"):
            load_study(tmp_path)
        with pytest.raises(StudyError, match="cannot be read"):
            load_study("a\0b.yaml")
        with pytest.raises(StudyError, match="cannot be read: File name too long"):
            load_study("a" * 5000 + ".yaml")


def spec_at(package):
    """Function that finds a package in a folder."""
    return lambda name: ModuleSpec(name, None, origin=str(package / "__init__.py"))


class TestPackageFiles:
    def test_source_tree(self):
        assert (package_files.config_directory() / "studies" / "benchmark.yaml").is_file()

    def test_installed(self, tmp_path, monkeypatch):
        package = tmp_path / "lib" / "python3.12" / "site-packages" / "bo_tuner"
        shipped = tmp_path / "share" / "bo_tuner" / "config" / "studies"
        # Another package's folder must not be taken for ours.
        foreign = package.parent / "config" / "studies"
        for folder in (package, shipped, foreign):
            folder.mkdir(parents=True)
        monkeypatch.setattr(package_files, "find_spec", spec_at(package))
        assert package_files.config_directory() == shipped.parent

    def test_missing(self, tmp_path, monkeypatch):
        monkeypatch.setattr(package_files, "find_spec", spec_at(tmp_path / "a"))
        with pytest.raises(PackageFilesError, match="shipped studies are missing"):
            package_files.config_directory()


def places(value, path=()):
    """Every path into dictionaries and lists."""
    yield path
    if isinstance(value, (dict, list)):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(inner, (*path, key))


PLACES = [path for path in places(mapping()) if path]
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 30),
    st.integers(),
    st.floats(),
    st.sampled_from([10**5000, 2**63, 5e-324, 1.7e308, -1.7e308, 1e300]),
    st.text(max_size=6),
    st.sampled_from(["window", "span", "drive", "error", "integer", "double", "beta", "discrete"]),
    st.lists(st.floats() | st.integers() | st.text(max_size=3), max_size=3),
    st.lists(st.floats(-1e308, 1e308).map(abs), min_size=2, max_size=2).map(sorted),
    st.dictionaries(st.text(max_size=4) | st.integers(), st.integers(), max_size=2),
)
DISTRIBUTION_FIELDS = st.fixed_dictionaries(
    {"distribution": st.sampled_from(["truncated_normal", "uniform", "beta", "triangular"])},
    optional={
        "bounds": st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2).map(sorted),
        **{key: st.floats(1e-9, 1e9) for key in ("mean", "standard_deviation", "a", "b", "mode")},
    },
)


class TestFuzz:
    @given(st.lists(st.tuples(st.sampled_from(PLACES), VALUES, st.booleans()), max_size=3))
    @settings(max_examples=400, deadline=None, derandomize=True)
    def test_a_study_or_one_line(self, edits):
        changed = copy.deepcopy(mapping())
        for path, value, remove in edits:
            inner = changed
            for key in path[:-1]:
                try:
                    inner = inner[key]
                except (KeyError, IndexError, TypeError):
                    break
            else:
                if isinstance(inner, dict) or (
                    isinstance(inner, list) and isinstance(path[-1], int) and path[-1] < len(inner)
                ):
                    inner[path[-1]] = value
                    if remove and isinstance(inner, dict):
                        del inner[path[-1]]
        self.study_or_line(changed)

    @given(VALUES)
    @settings(max_examples=30, deadline=None, derandomize=True)
    def test_any_value(self, value):
        self.study_or_line(value)

    @given(DISTRIBUTION_FIELDS)
    @settings(max_examples=150, deadline=None, derandomize=True)
    def test_any_distribution(self, fields):
        self.study_or_line(put({"node": "drive"} | fields, "contexts", "load"))

    @given(st.text(max_size=40) | st.text("abc:[]{}-,'\"|>&*!%# \n\t", max_size=40))
    @settings(max_examples=300, deadline=None, derandomize=True)
    def test_any_text(self, text):
        with pytest.raises(StudyError) as caught:
            parse_study(text, "mine.yaml")
        assert str(caught.value).isprintable()

    @staticmethod
    def study_or_line(value):
        problem = ""
        try:
            study = study_from_mapping(value)
        except StudyError as error:
            problem = str(error)
        if problem:
            assert problem.isprintable()
            return
        assert parse_study(study_to_yaml(study)) == study
        space = study.search_space()
        rng = np.random.default_rng(0)
        for point in space.latin_hypercube(3, rng):
            space.key(space.to_parameters(point))
        contexts = study.context_space()
        drawn = contexts.draw(3, rng)
        assert np.all((drawn >= contexts.lower) & (drawn <= contexts.upper))
