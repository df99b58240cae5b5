"""Repetitions before the answer, on a function whose feasible optimum is known."""

import dataclasses

import numpy as np
import pytest
from answering import settle
from functions import Watcher

from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.errors import RunError
from bo_tuner.method_names import BOUNDARY
from bo_tuner.methods.boundary.judging import judgements, required_of, runs_until
from bo_tuner.methods.boundary.repetition import NEAR
from bo_tuner.methods.boundary.settling import with_known_repetitions, with_repetitions
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.repetitions import DRAWN_EVALUATIONS, WORST_EVALUATIONS
from bo_tuner.models.constraints import CONFIDENT
from bo_tuner.models.estimates import estimated
from bo_tuner.trials import (
    CHECKS,
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    Trial,
    TrialState,
    WorstCase,
    count_checks,
    count_evaluations,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate
from bo_tuner.tuning.loop import Tuning

ALGORITHM = METHODS[BOUNDARY]
REPETITIONS, OWN_RUNS = ALGORITHM.repetitions, ALGORITHM.own_runs.doubtful
PEAK = {"kind": "worst_case", "metric": "peak", "upper": 1.0}


def axis(x, load, seed):
    """Cost falls with x, and the peak exceeds 1 for x > 0.6, under the largest load, 2, only."""
    rng = np.random.default_rng(seed)
    return {
        "error": 2.0 - x + 0.2 * (load - 1.5) + rng.normal(0.0, 0.02),
        "peak": 0.4 + 0.5 * x * load - 0.25 * (2.0 - load) + rng.normal(0.0, 0.05),
    }


@pytest.fixture(scope="module")
def study_of(make_study):
    def make(peak=PEAK, **sections):
        return make_study(
            parameters={
                "x": {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.0}
            },
            budget={"trials": 10, "initial_trials": 5},
            constraints={} if peak is None else {"peak": peak},
            **sections,
        )

    return make


@pytest.fixture(scope="module")
def study(study_of):
    return study_of()


@pytest.fixture(scope="module")
def trials(study, function_backend):
    tuning = Tuning(study, Driver(function_backend(study, axis)), ALGORITHM)
    return list(tuning)


@pytest.fixture(scope="module")
def settled(study, trials, function_backend):
    watcher = Watcher()
    backend = function_backend(study, axis)
    found = settle(study, backend, trials, most=25, observer=watcher)
    return found, watcher


def test_a_trial_is_a_new_parameter_set_and_repetitions_come_on_top(trials, settled):
    _, watcher = settled
    assert len({trial.parameters["x"] for trial in trials}) == 10
    known = {trial.number: trial for trial in trials}
    assert 0 < len(watcher.evaluations) <= 25
    assert len(watcher.steps) == len(watcher.evaluations)
    for number in {evaluation.trial for evaluation in watcher.evaluations}:
        of_trial = [e for e in watcher.evaluations if e.trial == number]
        first = len(known[number].evaluations)
        assert [e.index for e in of_trial] == list(range(first, first + len(of_trial)))
        assert {e.parameters["x"] for e in of_trial} == {known[number].parameters["x"]}
    assert len({e.seed for e in watcher.evaluations}) == len(watcher.evaluations)


def test_runs_are_where_the_limit_is_most_doubtful(settled):
    _, watcher = settled
    assert {e.stage for e in watcher.evaluations} == {Stage.CHECK_WORST}
    loads = [e.context["load"] for e in watcher.evaluations]
    assert np.mean(np.array(loads) > 1.9) > 0.6
    # In the other corner an answer was run once.
    elsewhere = [e.trial for e in watcher.evaluations if e.context["load"] <= 1.9]
    assert len(elsewhere) == len(set(elsewhere))
    assert elsewhere


def test_the_answer_has_runs_of_its_own_there(settled):
    found, _ = settled
    trial = found.candidate.trial
    assert found.feasible
    assert trial.number in found.checked
    assert 0.4 < trial.parameters["x"] <= 0.61
    worst = trial.worst_cases["peak"]
    near = [abs(e.context["load"] - worst.context["load"]) <= NEAR for e in trial.evaluations]
    assert sum(near) >= OWN_RUNS
    # At the largest load the mean is 0.4 + x; four runs alone have an error of 0.025.
    assert worst.value == pytest.approx(0.4 + trial.parameters["x"], abs=0.05)
    assert worst.observed == max(e.outcome.metrics["peak"] for e in trial.evaluations)


def test_without_repetitions_left_the_answer_is_one_that_has_runs_of_its_own(
    study, trials, function_backend
):
    first, second, *_ = ALGORITHM.ranking.rank(study, trials)
    assert first.believed_feasible
    assert second.believed_feasible
    backend = function_backend(study, axis)
    answer = settle(study, backend, trials, most=0)
    assert answer.candidate.trial.number == first.trial.number
    number, x = second.trial.number, second.trial.parameters["x"]
    loads = [2.0] * OWN_RUNS + [1.0]
    own = [
        dataclasses.replace(
            trials[number].evaluations[0],
            index=len(trials[number].evaluations) + k,
            stage=Stage.CHECK_WORST,
            context={"load": load},
            outcome=Outcome(EvaluationState.COMPLETE, axis(x, load, k)),
        )
        for k, load in enumerate(loads)
    ]
    known = list(trials)
    known[number] = with_repetitions(trials[number], own)
    again = ALGORITHM.ranking.rank(study, known)
    assert again[0].trial.number != number
    (with_own_runs,) = [c for c in again if c.trial.number == number]
    assert with_own_runs.believed_feasible
    answer = settle(study, backend, known, most=0)
    ranked = [c.trial.number for c in answer.ranked]
    others = [c.trial.number for c in again if c is not with_own_runs]
    assert (answer.candidate.trial.number, ranked) == (number, [number, *others])


@pytest.mark.parametrize("most", [8, 14, 20, 25])
def test_what_is_better_than_the_answer_is_named(study, trials, function_backend, most):
    """And an answer that is not shown to keep its limits is never chosen over one that is."""
    found = settle(study, function_backend(study, axis), trials, most=most)
    known = {candidate.trial.number: candidate for candidate in found.ranked}
    better = [known[item.trial] for item in found.passed_over]
    assert all(c.score < found.candidate.score for c in better)
    assert [c.score for c in better] == sorted(c.score for c in better)
    # Beyond x = 0.65 all runs exceed the limit, and the cost falls with x.
    assert all(
        found.candidate.trial.parameters["x"] < c.trial.parameters["x"] < 0.65 for c in better
    )
    for item in found.passed_over:
        assert 0.5 <= item.feasibility == known[item.trial].feasibility
        assert item.shown == known[item.trial].believed_feasible
    if found.feasible:
        assert found.candidate.believed_feasible
    else:
        assert not any(c.believed_feasible for c in found.ranked)


def test_a_better_one_without_runs_of_its_own_is_named(study, trials, function_backend):
    first, second, *_ = ALGORITHM.ranking.rank(study, trials)
    number = second.trial.number
    own = [
        dataclasses.replace(
            trials[number].evaluations[0],
            index=len(trials[number].evaluations) + k,
            stage=Stage.CHECK_WORST,
            context={"load": load},
            outcome=Outcome(EvaluationState.COMPLETE, axis(second.trial.parameters["x"], load, k)),
        )
        for k, load in enumerate([2.0] * OWN_RUNS + [1.0])
    ]
    known = list(trials)
    known[number] = with_repetitions(trials[number], own)
    answer = settle(study, function_backend(study, axis), known, most=0)
    assert answer.candidate.trial.number == number
    named = {item.trial: item.shown for item in answer.passed_over}
    assert named[first.trial.number]


def test_a_record_of_the_repetitions_leads_to_the_same_answer(study, trials, settled):
    found, watcher = settled

    class Nothing:
        name = "nothing"

        def run(self, evaluations):
            assert not list(evaluations), "asked for a run that is not on record"
            return iter(())

    recorded = RecordedEvaluations(Nothing(), study, watcher.evaluations)
    assert settle(study, recorded, trials, most=25) == found


def test_repetitions_that_trials_have_count_and_are_not_made_again(
    study, trials, settled, function_backend
):
    found, watcher = settled
    known = with_known_repetitions(trials, watcher.evaluations, more=True)
    again = Watcher()
    backend = function_backend(study, axis)
    once_more = settle(study, backend, known, most=25, observer=again)
    assert not again.evaluations
    assert (once_more.candidate, once_more.ranked) == (found.candidate, found.ranked)
    assert sorted(once_more.checked) == sorted(found.checked)
    assert count_evaluations(known) == count_evaluations(trials)
    assert count_checks(known) == len(watcher.evaluations)
    assert [trial.unchecked for trial in known] == trials


def test_a_trial_knows_the_repetitions_that_were_recorded_before_it(trials, settled):
    """Not those after the last trial: the search for the answer takes its way anew."""
    _, watcher = settled
    runs = [evaluation for trial in trials for evaluation in trial.evaluations]
    later = [e for e in runs if e.trial == trials[-1].number]
    early = [e for e in runs if e.trial != trials[-1].number]
    mine = len(watcher.evaluations) // 2
    before, after = watcher.evaluations[:mine], watcher.evaluations[mine:]
    record = [*early, *before, *later, *after]
    for more, expected in ((False, before), (True, watcher.evaluations)):
        known = with_known_repetitions(trials, record, more=more)
        found = [e for trial in known for e in trial.evaluations if e.stage in CHECKS]
        assert sorted(e.seed for e in found) == sorted(e.seed for e in expected)


def test_the_rank_after_repetitions_is_that_of_the_answer(study, trials, settled):
    """A reader of the record ranks the trials with their repetitions, and finds the same."""
    found, watcher = settled
    extended = [
        with_repetitions(trial, [e for e in watcher.evaluations if e.trial == trial.number])
        for trial in trials
    ]
    best = ALGORITHM.ranking.rank(study, extended)[0]
    assert best.trial.number == found.candidate.trial.number
    assert best.feasibility == found.candidate.feasibility


def test_a_parameter_set_is_judged_when_its_runs_have_doubled(make_trial):
    """Whoever looks after each run, and stops when it looks well, is wrong too often."""
    trial = make_trial(0, {"x": 0.5}, [1.0])
    (evaluation,) = trial.evaluations
    again = dataclasses.replace(evaluation, stage=Stage.CHECK_WORST)
    found = {}
    for count in (0, 1, 2, 3, 4, 7, 8, 40):
        repeated = with_repetitions(trial, [again] * count)
        found[count] = (judgements(repeated), runs_until(repeated, judgements(repeated) + 1))
    assert found == {
        0: (0, 2),
        1: (0, 1),
        2: (1, 2),
        3: (1, 1),
        4: (2, 4),
        7: (2, 1),
        8: (3, 8),
        40: (5, 24),
    }
    assert required_of(trial) == CONFIDENT
    assert required_of(with_repetitions(trial, [again] * 8)) == 1.0 - (1.0 - CONFIDENT) / 4.0


def test_none_are_left(study, trials, function_backend):
    backend = function_backend(study, axis)
    found = settle(study, backend, trials, most=0)
    assert backend.calls == []
    assert found.checked == ()


def test_without_limits_nothing_is_in_doubt(study_of, function_backend):
    study = study_of(peak=None)
    backend = function_backend(study, axis)
    trials = list(Tuning(study, Driver(backend), ALGORITHM))
    runs = len(backend.calls)
    assert settle(study, backend, trials, most=20).feasible
    assert len(backend.calls) == runs


def test_a_chance_constraint_is_doubtful_in_drawn_contexts(study_of, function_backend):
    chance = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.8}
    study = study_of(peak=chance)
    backend, watcher = function_backend(study, axis), Watcher()
    trials = list(Tuning(study, Driver(backend), ALGORITHM))
    settle(study, backend, trials, most=6, observer=watcher)
    assert {e.stage for e in watcher.evaluations} <= {Stage.CHECK_DRAWN}
    loads = [e.context["load"] for e in watcher.evaluations]
    assert len(set(loads)) == len(loads)


def test_a_run_that_fails_ends_the_hopes_of_its_parameter_set(
    study, trials, function_backend, failed
):
    backend = function_backend(study, lambda **_: failed("axis: stalled"))
    found = settle(study, backend, trials, most=40)
    # Each candidate in doubt fails once; not one is asked twice, and none is the answer.
    assert found.candidate.trial.number not in found.checked
    assert len(backend.calls) == len(set(found.checked)) == len(found.checked)


def test_lost_nodes_end_the_run(study, trials, function_backend):
    backend = function_backend(study, lambda **_: Outcome(EvaluationState.LOST, reason="axis gone"))
    watcher = Watcher()
    with pytest.raises(RunError, match="3 repetitions in a row were lost"):
        settle(study, backend, trials, most=40, observer=watcher)
    # Those on record do not end the run again when it is resumed with the nodes back.
    resumed = RecordedEvaluations(function_backend(study, axis), study, watcher.evaluations)
    assert settle(study, resumed, trials, most=40) is not None


def test_all_trials_failed(study, make_trial, function_backend):
    trials = [make_trial(k, {"x": k / 10}) for k in range(4)]
    backend = function_backend(study, axis)
    assert settle(study, backend, trials, most=20) is None


def test_a_lost_run_tells_nothing_of_the_trial(trials, settled):
    _, watcher = settled
    lost = dataclasses.replace(
        watcher.evaluations[0], outcome=Outcome(EvaluationState.LOST, reason="axis gone")
    )
    trial = trials[lost.trial]
    assert with_repetitions(trial, [lost]).state is TrialState.COMPLETE


def test_the_number_of_repetitions(study, study_of):
    """A sixth of the trials' evaluations, and at least those of a check of one candidate."""
    least = DRAWN_EVALUATIONS + WORST_EVALUATIONS
    assert REPETITIONS.most(study, 20) == least
    assert REPETITIONS.most(study, 300) == 50
    assert REPETITIONS.most(study, 300, made=20) == 30
    assert REPETITIONS.most(study, 300, made=45) == least
    assert REPETITIONS.most(study_of(peak=None), 20) == DRAWN_EVALUATIONS


@pytest.mark.parametrize("name", [BOUNDARY, "IV"])
def test_what_failed_when_it_was_run_again_is_no_candidate_of_a_pooled_run(study, trials, name):
    method = METHODS[name]
    best = method.ranking.rank(study, trials)[0].trial.number
    again = dataclasses.replace(
        trials[best].evaluations[0],
        index=len(trials[best].evaluations),
        stage=Stage.CHECK_DRAWN,
        outcome=Outcome(EvaluationState.FAILED, reason="axis: stalled"),
    )
    known = method.checked(study, trials, [*trials[best].evaluations, again])
    assert known[best].evaluations == (*trials[best].evaluations, again)
    numbers = [candidate.trial.number for candidate in method.ranking.rank(study, known)]
    assert (best in numbers) is (name != BOUNDARY)


def test_without_its_checks_a_trial_is_what_it_was(study_of):
    """Else the advice to stop would change when a run goes on."""
    study = study_of()
    parameters = study.search_space().defaults
    metrics = {"error": 1.0, "peak": 0.5}
    done = Evaluation(
        0, 0, Stage.DRAWN, parameters, {}, 1, Outcome(EvaluationState.COMPLETE, metrics)
    )
    trial = Trial(0, parameters, "", TrialState.COMPLETE, evaluations=(done,))
    failed = Outcome(EvaluationState.FAILED, reason="axis: stalled")
    again = with_repetitions(
        trial, [dataclasses.replace(done, index=1, stage=Stage.CHECK_DRAWN, outcome=failed)]
    )
    assert again.state is TrialState.FAILED
    assert again.unchecked == trial
    of_run = dataclasses.replace(
        trial, state=TrialState.FAILED, reason="axis: gone", evaluations=()
    )
    assert of_run.unchecked == of_run


def test_worst_cases_stay_where_all_trials_have_failed_when_run_again(study_of):
    """No model of a limit is left to estimate them by, and the report is written all the same."""
    study = study_of()
    found = {"peak": WorstCase(0.9, {"load": 2.0}, 0.95, 0.01)}
    trial = Trial(0, study.search_space().defaults, "", TrialState.COMPLETE, worst_cases=found)
    failed = Outcome(EvaluationState.FAILED, reason="axis: stalled")
    again = Evaluation(0, 0, Stage.CHECK_DRAWN, trial.parameters, {"load": 2.0}, 1, failed)
    trial = with_repetitions(trial, [again])
    models = ALGORITHM.ranking.models(study, [trial])
    assert estimated(study, models, trial).worst_cases == found


@pytest.mark.parametrize("window", [1, 3])
def test_it_can_be_finished_early_and_that_be_repeated(study, trials, function_backend, window):
    watcher = Watcher()
    gate = Gate(time_is_up=lambda: len(watcher.evaluations) >= 2)
    search = ALGORITHM.answer_search(study, trials, 25)
    Driver(function_backend(study, axis), watcher, window=window, gate=gate).complete(search)
    # Those that were planned then are run to their end.
    assert search.finished == len(watcher.evaluations) <= 1 + window
    assert len(watcher.evaluations) >= 2
    assert search.answer is not None
    assert set(search.answer.checked) == {e.trial for e in watcher.evaluations}
    again = ALGORITHM.answer_search(study, trials, 25)
    again.finished = search.finished
    Driver(function_backend(study, axis), window=window).complete(again)
    assert again.answer == search.answer
