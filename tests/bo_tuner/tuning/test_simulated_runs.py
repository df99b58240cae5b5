"""What a machine takes of a run of its simulation: what has the same name, and no more."""

from dataclasses import replace

import numpy as np
import pytest
from earlier_runs import GAIN, LOAD, PEAK, record
from functions import NODE

from bo_tuner.errors import RunRecordError
from bo_tuner.methods.registry import METHODS
from bo_tuner.trials import EvaluationState, Outcome, Stage, TrialState
from bo_tuner.tuning.simulated_runs import begun_by_simulation, take_simulation

BOUNDARY = METHODS["boundary"]


@pytest.fixture(scope="module")
def simulated(make_study, function_backend, tmp_path_factory):
    """A run of the simulation."""
    study = make_study().replace(trials=6, initial_trials=4)
    return record(tmp_path_factory.mktemp("runs"), study, function_backend)


def take(simulated, study):
    return take_simulation(simulated, study, BOUNDARY)


def test_all_of_the_same_study(simulated, make_study):
    taken = take(simulated, make_study())
    assert [t.parameters for t in taken.trials] == [t.parameters for t in simulated.trials]
    assert sum(len(t.evaluations) for t in taken.trials) == len(simulated.evaluations)
    assert taken.run == str(simulated.path.resolve())
    assert "left out" not in taken.text


def test_a_machine_is_another_node_with_another_run(simulated, make_study):
    other = {"node": "drive"}
    machine = make_study(
        nodes={"drive": other | {"result": "~/result", "object": "axis_objects:Axis"}},
        parameters={"gain": other | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}},
        contexts=None,
        seed_parameter=None,
        trigger=other | {"service": "~/move"},
        metrics={"error": other, "peak": other},
    )
    taken = take(simulated, machine)
    assert len(taken.trials) == len(simulated.trials)


def test_without_contexts_only_what_was_drawn(simulated, make_study):
    """What a context changes is noise on the machine, but for those that were searched for."""
    taken = take(simulated, make_study(contexts=None))
    stages = [e.stage for t in taken.trials for e in t.evaluations]
    drawn = [e for e in simulated.evaluations if e.stage is Stage.DRAWN]
    assert stages == [Stage.DRAWN] * len(drawn)
    assert all(e.context == {} for t in taken.trials for e in t.evaluations)
    searched = len(simulated.evaluations) - len(drawn)
    assert f"{searched} test runs in a context that was searched for" in taken.text


def test_contexts_that_the_machine_never_has_are_left_out(simulated, make_study):
    taken = take(simulated, make_study(contexts={"load": LOAD | {"bounds": [1.0, 1.5]}}))
    loads = [e.context["load"] for t in taken.trials for e in t.evaluations]
    assert loads
    assert max(loads) <= 1.5
    assert "outside the distribution of load" in taken.text


def test_parameter_sets_that_the_machine_does_not_permit_are_left_out(simulated, make_study):
    narrow = make_study(parameters={"gain": GAIN | {"bounds": [0.4, 1.0]}})
    taken = take(simulated, narrow)
    assert all(trial.parameters["gain"] >= 0.4 for trial in taken.trials)
    assert "outside the bounds of gain" in taken.text


def test_failed_runs_are_data_and_runs_cut_short_are_not(simulated, make_study):
    def ended(trial, outcome, state):
        *whole, last = trial.evaluations
        evaluations = (*whole, replace(last, outcome=outcome))
        return replace(trial, state=state, evaluations=evaluations, worst_cases={})

    crashed = Outcome(EvaluationState.FAILED, {}, "unstable")
    cut = Outcome.cut_short(1.5, {"error": 0.4, "peak": 1.2}, "peak at least 1.2")
    trials = list(simulated.trials)
    trials[0] = ended(trials[0], crashed, TrialState.FAILED)
    trials[1] = ended(trials[1], cut, TrialState.CUT_SHORT)
    taken = take(replace(simulated, trials=tuple(trials)), make_study())
    first = taken.trials[0]
    assert (first.state, first.reason) == (TrialState.FAILED, "unstable")
    assert len(taken.trials[1].evaluations) == len(trials[1].evaluations) - 1
    assert "1 test run cut short" in taken.text


class TestRefusals:
    @pytest.mark.parametrize(
        ("changes", "problem"),
        [
            ({"parameters": {"gain": GAIN, "damping": GAIN}}, "it has no parameter 'damping'"),
            ({"contexts": {"load": LOAD, "wind": LOAD}}, "it has no context 'wind'"),
            (
                {
                    "metrics": {"error": NODE, "peak": NODE, "heat": NODE},
                    "constraints": {"heat": PEAK | {"metric": "heat"}},
                },
                "it has no metric 'heat'",
            ),
            (
                {"metrics": {"error": NODE | {"unit": "mm"}, "peak": NODE}},
                "metric 'error' is in no unit there, in mm here",
            ),
        ],
    )
    def test_what_the_machine_needs_is_missing(self, simulated, make_study, changes, problem):
        with pytest.raises(RunRecordError, match="is no simulation of function: ") as raised:
            take(simulated, make_study(**changes))
        assert problem in str(raised.value)

    def test_a_metric_that_nothing_is_made_of_may_be_missing(self, simulated, make_study):
        more = {"error": NODE, "peak": NODE, "heat": NODE}
        assert take(simulated, make_study(metrics=more)).trials

    def test_nothing_is_left(self, simulated, make_study):
        far = GAIN | {"bounds": [2.0, 3.0], "default": 2.5}
        with pytest.raises(RunRecordError, match="none of its trials can be used: 6 trials"):
            take(simulated, make_study(parameters={"gain": far}))


class TestBeginning:
    def begun(self, simulated, study, number):
        trial = simulated.trials[number]
        record = replace(simulated, summary={"trial": trial.number})
        return begun_by_simulation(study, record, take(record, study)), trial

    def test_with_its_own_start_and_the_result_of_the_simulation(self, simulated, make_study):
        study, trial = self.begun(simulated, make_study(start=["default"]), 2)
        assert [s["gain"] for s in study.starting_sets()] == [0.5, trial.parameters["gain"]]
        assert study.budget.initial_trials == 2
        assert study.budget.trials == 5

    def test_not_with_a_result_that_the_machine_does_not_permit(self, simulated, make_study):
        lowest = int(np.argmin([trial.parameters["gain"] for trial in simulated.trials]))
        narrow = {"gain": GAIN | {"bounds": [0.45, 1.0]}}
        study, _ = self.begun(simulated, make_study(parameters=narrow, start=["default"]), lowest)
        assert [s["gain"] for s in study.starting_sets()] == [0.5]
        assert study.budget.initial_trials == 1

    def test_of_a_run_without_a_result(self, simulated, make_study):
        study = make_study(start=["default"])
        begun = begun_by_simulation(study, simulated, take(simulated, study))
        assert len(begun.starting_sets()) == 1

    def test_its_own_start_takes_all_trials(self, simulated, make_study):
        few = {"trials": 2, "initial_trials": 2, "validation_draws": 5}
        own = make_study(start=["default", {"gain": 0.9}], budget=few)
        study, _ = self.begun(simulated, own, 2)
        assert [s["gain"] for s in study.starting_sets()] == [0.5, 0.9]

    def test_whether_there_is_a_result_is_said(self, simulated, make_study):
        none = "no result that this machine may begin with"
        trial = simulated.trials[2]
        with_result = replace(simulated, summary={"trial": trial.number})
        assert none in take(simulated, make_study()).text
        assert none not in take(with_result, make_study()).text
