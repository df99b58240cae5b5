"""Checks before a recommendation, on a backend with a known function."""

from dataclasses import replace

import numpy as np
import pytest
from answering import recommend
from functions import Watcher

from bo_tuner.errors import RunError
from bo_tuner.methods.repetitions import DRAWN_EVALUATIONS, WORST_EVALUATIONS
from bo_tuner.optimizers.ranking import Candidate, Ranking
from bo_tuner.trials import EvaluationState, Outcome, Stage

NODE = {"node": "axis"}
DOUBLE = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
GRID = np.linspace(0.0, 1.0, 11)
NOISE = 0.02


@pytest.fixture
def study(make_study):
    """Error falls and peak, at load 2, rises with x; the limit 1 is met up to x = 0.5."""
    return make_study(parameters={"x": DOUBLE})


def axis(x, load=1.5, seed=0):
    noise = NOISE * np.random.default_rng(seed).normal()
    return {"error": 2.0 - x, "peak": x * load + noise}


def flattering(make_trial):
    """Trials in which every estimated worst case is a fifth too low."""
    return [
        make_trial(k, {"x": float(x)}, [2.0 - x] * 2, worst=0.8 * 2.0 * x, noise=NOISE)
        for k, x in enumerate(GRID)
    ]


def worst_at_two(trials):
    from dataclasses import replace

    return [
        replace(t, worst_cases={"peak": replace(t.worst_cases["peak"], context={"load": 2.0})})
        for t in trials
    ]


def test_flattered_candidates_are_refuted(study, make_trial, function_backend):
    trials = worst_at_two(flattering(make_trial))
    backend = function_backend(study, axis)
    watcher = Watcher()
    answer = recommend(study, backend, trials, observer=watcher)
    evaluations = watcher.evaluations
    x = answer.candidate.trial.parameters["x"]
    assert answer.feasible
    assert 2.0 * x <= 1.0
    assert len(answer.checked) >= 2
    assert (
        len(evaluations)
        == len(backend.calls)
        == len(answer.checked) * (DRAWN_EVALUATIONS + WORST_EVALUATIONS)
    )
    assert {evaluation.stage for evaluation in evaluations} == {
        Stage.CHECK_DRAWN,
        Stage.CHECK_WORST,
    }
    assert len({evaluation.seed for evaluation in evaluations}) == len(evaluations)


def test_what_is_seen_joins_the_record(study, make_trial, function_backend):
    trials = worst_at_two(flattering(make_trial))
    answer = recommend(study, function_backend(study, axis), trials)
    trial = answer.candidate.trial
    x = trial.parameters["x"]
    assert len(trial.observations("error")) == 2 + DRAWN_EVALUATIONS
    assert trial.worst_cases["peak"].value == pytest.approx(
        2.0 * x, abs=4 * NOISE / WORST_EVALUATIONS**0.5
    )


def test_without_checks_the_first_in_rank_is_taken(study, make_trial, function_backend):
    backend = function_backend(study, axis)
    answer = recommend(study, backend, flattering(make_trial), most_checked=0)
    assert backend.calls == []
    assert answer.feasible
    assert answer.checked == ()
    assert answer.candidate.trial.parameters["x"] == pytest.approx(0.6)


def test_nothing_holds(study, make_trial, function_backend):
    """The axis has changed since: every evaluation violates the limit."""
    trials = worst_at_two(flattering(make_trial))
    changed = function_backend(study, lambda x, **_: {"error": 2.0 - x, "peak": 1.5})
    answer = recommend(study, changed, trials, most_checked=3)
    assert not answer.feasible
    assert len(answer.checked) == 3


def test_without_time_for_more_checks_the_next_in_rank_is_taken_unconfirmed(
    study, make_trial, function_backend
):
    """Not the one farthest within the limits, which tracks the worst."""
    trials = worst_at_two(flattering(make_trial))
    answer = recommend(study, function_backend(study, axis), trials, most_checked=1)
    assert not answer.feasible
    # x = 0.6 was refuted.
    assert answer.candidate.trial.parameters["x"] == pytest.approx(0.5)
    assert [trials[number].parameters["x"] for number in answer.checked] == pytest.approx([0.6])


def test_if_all_are_refuted_the_objective_still_counts(study, make_trial, function_backend, failed):
    """Crashes say nothing of the limits, so that all stay where the models put them."""
    trials = flattering(make_trial)[:4]
    backend = function_backend(study, lambda **_: failed("axis: stalled"))
    answer = recommend(study, backend, trials)
    assert not answer.feasible
    assert len(answer.checked) == len(trials)
    assert answer.candidate.trial.parameters["x"] == pytest.approx(0.3)


def test_a_failed_evaluation_refutes(study, make_trial, function_backend, failed):
    backend = function_backend(study, lambda **_: failed("axis: stalled"))
    watcher = Watcher()
    answer = recommend(study, backend, flattering(make_trial), most_checked=2, observer=watcher)
    assert not answer.feasible
    assert [e.outcome.state for e in watcher.evaluations] == [EvaluationState.FAILED] * 2


def test_all_trials_failed(study, make_trial, function_backend):
    trials = [make_trial(k, {"x": float(x)}) for k, x in enumerate(GRID)]
    assert recommend(study, function_backend(study, axis), trials) is None


def test_what_held_but_is_no_longer_believed_is_not_called_feasible(
    study, make_trial, function_backend, monkeypatch
):
    """The models may learn from another candidate's check."""
    trial = replace(make_trial(0, {"x": 0.2}, [1.0], worst=0.4), worst_cases={})
    believed = Candidate(trial, 1.0, 0.9, -0.5, 0.0, 0.0)
    rankings = iter([believed, replace(believed, feasibility=0.1)])

    def ranked(self, study, trials):
        return [replace(next(rankings), trial=trials[0])]

    monkeypatch.setattr(Ranking, "rank", ranked)
    backend = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.4})
    answer = recommend(study, backend, [trial])
    assert answer.checked == (0,)
    assert not answer.feasible


def test_a_lost_evaluation_of_a_check_is_run_again(study, make_trial, function_backend):
    """It tells nothing of the parameters, which had counted as refuted."""
    trials = worst_at_two(flattering(make_trial))[:4]
    calls = []

    def axis_with_losses(**values):
        calls.append(values)
        if len(calls) in (1, 2, 7, 15):
            return Outcome(EvaluationState.LOST, reason="axis gone")
        return axis(**values)

    whole = recommend(study, function_backend(study, axis), trials)
    found = recommend(study, function_backend(study, axis_with_losses), trials)
    assert found.feasible
    assert found == whole


def test_evaluations_of_a_check_that_are_lost_again_and_again(study, make_trial, function_backend):
    lost = Outcome(EvaluationState.LOST, reason="axis gone")
    backend = function_backend(study, lambda **_: lost)
    with pytest.raises(RunError, match="3 test runs of the check in a row were lost"):
        recommend(study, backend, flattering(make_trial))


def test_what_crashed_in_its_check_is_not_the_answer_where_others_did_not(
    study, make_trial, function_backend, failed
):
    trials = flattering(make_trial)[:4]
    best = trials[-1].parameters["x"]

    def axis_that_crashes(x, load, seed):
        return failed("axis: stalled") if x == best else {"error": 1.0, "peak": 3.0}

    answer = recommend(study, function_backend(study, axis_that_crashes), trials)
    assert not answer.feasible
    assert answer.checked[0] == trials[-1].number
    assert not answer.candidate.trial.failed_again


def test_a_set_that_was_run_in_several_trials_has_one_check(
    study, make_trial, function_backend, failed
):
    """Of several, one would pass by luck, though the first has crashed."""
    trials = flattering(make_trial)[:4]
    best = trials[-1]
    trials += [replace(best, number=number) for number in (4, 5, 6)]

    def axis_that_crashes_once(x, load, seed):
        calls.append(x)
        first = x == best.parameters["x"] and calls.count(x) == 1
        return failed("axis: stalled") if first else {"error": 1.0, "peak": 0.1}

    calls = []
    answer = recommend(study, function_backend(study, axis_that_crashes_once), trials)
    assert answer.candidate.trial.parameters != best.parameters
    assert len({number for number in answer.checked if number >= 3}) == 1
