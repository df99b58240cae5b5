"""The study file: what is read, and written again."""

import dataclasses
import pickle

import numpy as np
import pytest
from drive_text import STUDY, mapping, put
from hypothesis import given, settings
from hypothesis import strategies as st

from bo_tuner.errors import StudyError
from bo_tuner.study import strict_yaml
from bo_tuner.study.budget import Budget
from bo_tuner.study.distributions import Discrete, TruncatedNormal
from bo_tuner.study.parts import Objective
from bo_tuner.study.study_file import (
    load_study,
    parse_study,
    shipped_studies,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)


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
        (real_time,) = study.drawn_constraints
        assert real_time.probability == 0.96
        assert study.metrics[real_time.metric].key == "return_time_p99"
        (worst,) = study.worst_case_constraints
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
        assert study.worst_case_constraints == ()
        assert study.drawn_constraints == ()
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

    def test_its_spaces_are_made_once(self):
        study = load_study("full")
        assert study.search_space() is study.search_space()
        assert study.context_space() is study.context_space()
        # Another process, and a changed study, make their own.
        again = pickle.loads(pickle.dumps(study))
        assert again.context_space() is not study.context_space()
        fewer = dataclasses.replace(study, contexts={})
        assert fewer.context_space().names == ()


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
    @settings(max_examples=150)
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
            ({"run": 300}, "certificate.run: unknown key; expected one of draws"),
            (300, "certificate: expected a mapping"),
        ],
    )
    def test_what_a_certificate_needs_is_checked(self, section, message):
        mapping = study_to_mapping(parse_study(STUDY)) | {"certificate": section}
        with pytest.raises(StudyError) as caught:
            study_from_mapping(mapping)
        assert str(caught.value).startswith(message)

    def test_fewer_trials_than_the_initial_design(self):
        """An option and the file are read alike."""
        study = parse_study(STUDY)
        assert (study.budget.initial_trials < 12, study.budget.warning) == (True, "")
        fewer = study.replace(trials=2)
        assert fewer.budget.initial_trials == 2
        assert fewer.budget.warning.startswith("the initial design takes all of the 2 trials")
        assert study.replace(initial_trials=13).budget.initial_trials == 12

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"trials": 0}, "budget.trials: expected an integer of at least 1, found 0"),
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

    @pytest.mark.parametrize("scale", ["linear", "log"])
    @pytest.mark.parametrize(("direction", "worse"), [("minimize", 1.25), ("maximize", 0.75)])
    def test_a_loss_is_relative_to_the_metric_on_both_scales(self, scale, direction, worse):
        objective = Objective(metric="error", scale=scale, direction=direction)
        cost, other = objective.to_cost(self.values), objective.to_cost(worse * self.values)
        np.testing.assert_allclose(objective.relative_loss(other, cost), 0.25)
        np.testing.assert_allclose(objective.worsened(cost, 0.25), other)
        np.testing.assert_array_equal(objective.worsened(cost, 0.0), cost)

    def test_a_loss_beside_zero_is_relative_to_what_stands_for_it(self):
        objective = Objective(metric="error")
        assert objective.relative_loss(1.0, 0.0, 4.0) == 0.25
        assert objective.worsened(0.0, 0.25, 4.0) == 1.0
        assert objective.relative_loss(0.0, 0.0) == 0.0


class TestBudget:
    def test_trials_alone(self):
        budget = Budget(trials=10, initial_trials=3)
        assert [budget.remaining(n, 7 * n) for n in (0, 4, 10, 12)] == [10, 6, 0, 0]

    def test_evaluations_end_it_first(self):
        """After 4 trials of 5 evaluations, 30 more suffice for 6; after 50, for none."""
        budget = Budget(trials=100, initial_trials=3, evaluations=50)
        assert budget.remaining(4, 20) == 6
        assert budget.is_spent(11, 50)
        assert not budget.is_spent(11, 49)
        assert budget.is_spent(100, 10)

    def test_another_budget_replaces_it(self):
        evaluations = load_study("benchmark").replace(evaluations=300)
        assert (evaluations.budget.trials, evaluations.budget.evaluations) == (300, 300)
        most = load_study("benchmark").replace(evaluations=60_000).budget
        assert (most.trials, most.evaluations) == (10_000, 60_000)
        trials = evaluations.replace(trials=30).budget
        assert (trials.trials, trials.evaluations) == (30, None)
