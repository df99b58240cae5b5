"""The sequence of trials and evaluations, on functions in place of machines."""

import itertools
import math

import pytest
from functions import NODE, Watcher

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.errors import RunError
from bo_tuner.methods.registry import METHODS
from bo_tuner.run_notes import Notes, Unusable
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import (
    EvaluationState,
    Outcome,
    Stage,
    TrialState,
    count_evaluations,
    count_trials,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import Tuning

IV = METHODS["IV"]


def smooth(gain, load, seed, **_):
    """A parabola; peak stays below its limit of 1."""
    return {"error": (gain - 0.3) ** 2 + 0.1 * load + 0.01 * math.sin(seed), "peak": 0.5 * load}


def trials_of(study, backend, method=IV, **options):
    return Tuning(study, Driver(backend), method, **options)


def run(study, backend, method=IV, **options):
    return list(trials_of(study, backend, method, **options))


@pytest.fixture(scope="module")
def whole(make_study, function_backend):
    """A run with its study and backend."""
    study = make_study()
    backend = function_backend(study, smooth)
    return study, backend, run(study, backend)


class TestEvaluations:
    def test_drawn_contexts_then_search(self, whole):
        study, _, trials = whole
        assert [trial.number for trial in trials] == list(range(study.budget.trials))
        for trial in trials:
            stages = [evaluation.stage for evaluation in trial.evaluations]
            assert stages == [Stage.DRAWN] * 2 + [Stage.SEARCH] * 2
            assert [evaluation.index for evaluation in trial.evaluations] == list(range(4))
            assert trial.state is TrialState.COMPLETE
            assert set(trial.worst_cases) == {"peak"}

    def test_the_node_receives_what_is_recorded(self, whole):
        _, backend, trials = whole
        told = [
            {**trial.parameters, **evaluation.context, "seed": evaluation.seed}
            for trial in trials
            for evaluation in trial.evaluations
        ]
        assert told == backend.calls

    def test_seeds_and_contexts(self, whole):
        evaluations = [evaluation for trial in whole[2] for evaluation in trial.evaluations]
        seeds = [evaluation.seed for evaluation in evaluations]
        assert len(set(seeds)) == len(seeds)
        assert all(0 <= seed < 2**31 for seed in seeds)
        assert all(1.0 <= evaluation.context["load"] <= 2.0 for evaluation in evaluations)
        drawn = [
            evaluation.context["load"]
            for evaluation in evaluations
            if evaluation.stage is Stage.DRAWN
        ]
        assert len(set(drawn)) == len(drawn)

    def test_draws_of_a_trial_do_not_depend_on_the_others(self, whole, function_backend, failed):
        """A trial that fails early takes no random numbers from those after it."""
        study, _, trials = whole
        count = itertools.count()

        def first_fails(**values):
            return failed("no") if next(count) == 0 else smooth(**values)

        disturbed = run(study, function_backend(study, first_fails))
        assert disturbed[0].state is TrialState.FAILED
        for pair in zip(trials[1:], disturbed[1:], strict=True):
            a, b = ([(c.context, c.seed) for c in trial.evaluations[:2]] for trial in pair)
            assert a == b

    def test_no_worst_case_no_search(self, make_study, function_backend):
        study = make_study(constraints={})
        trials = run(study, function_backend(study, smooth))
        assert {evaluation.stage for trial in trials for evaluation in trial.evaluations} == {
            Stage.DRAWN
        }
        assert not any(trial.worst_cases for trial in trials)

    def test_the_search_ends_at_a_violation(self, make_study, function_backend):
        study = make_study()
        # Every drawn evaluation is far above the limit already.
        backend = function_backend(study, lambda **v: smooth(**v) | {"peak": 5.0 * v["load"]})
        trial = next(iter(Tuning(study, Driver(backend), IV)))
        assert trial.state is TrialState.COMPLETE
        assert [evaluation.stage for evaluation in trial.evaluations] == [Stage.DRAWN] * 2
        assert trial.worst_cases["peak"].value > 1.0

    def test_the_nominal_method_takes_one_evaluation(self, make_study, function_backend):
        study = make_study()
        for trial in run(study, function_backend(study, smooth), METHODS["I"]):
            (evaluation,) = trial.evaluations
            assert evaluation.stage is Stage.NOMINAL
            assert evaluation.context == {"load": 1.5}
            assert trial.worst_cases["peak"].value == evaluation.outcome.metrics["peak"]

    def test_no_contexts(self, make_study, function_backend):
        study = make_study(contexts={})
        trials = run(study, function_backend(study, lambda gain, seed: smooth(gain, 1.0, seed)))
        for trial in trials:
            assert all(evaluation.context == {} for evaluation in trial.evaluations)
            assert trial.worst_cases["peak"].value == 0.5

    def test_observers_see_each_evaluation_at_once(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, smooth)

        class Prompt(Watcher):
            def evaluation(self, evaluation):
                super().evaluation(evaluation)
                assert len(backend.calls) == len(self.evaluations)

        watcher = Prompt()
        trial = next(iter(Tuning(study, Driver(backend, watcher), IV)))
        assert watcher.evaluations == list(trial.evaluations)
        assert {str(e.parameters) for e in watcher.evaluations} == {str(trial.parameters)}


class TestFailures:
    @pytest.mark.parametrize("at", [0, 1, 2, 3])
    def test_a_failed_evaluation_ends_its_trial_only(
        self, make_study, function_backend, failed, at
    ):
        study = make_study()
        count = itertools.count()

        def fails_once(**values):
            return failed("axis: stalled") if next(count) == at else smooth(**values)

        tuning = iter(Tuning(study, Driver(function_backend(study, fails_once)), IV))
        first, second = next(tuning), next(tuning)
        assert first.state is TrialState.FAILED
        assert first.reason == "axis: stalled"
        assert len(first.evaluations) == at + 1
        assert not first.worst_cases
        assert second.state is TrialState.COMPLETE

    def test_a_run_of_failures_is_complete(self, make_study, function_backend, failed):
        study = make_study()
        trials = run(study, function_backend(study, lambda **_: failed("no")))
        assert len(trials) == study.budget.trials
        assert {trial.state for trial in trials} == {TrialState.FAILED}

    def test_a_metric_that_is_not_finite(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, lambda **v: smooth(**v) | {"peak": math.nan})
        for trial in run(study, backend):
            assert trial.state is TrialState.FAILED
            assert trial.reason == "axis: metric peak is nan"
            assert trial.observations("error") == []

    @pytest.mark.parametrize("value", [0.0, -1.0])
    def test_no_logarithm_of_the_objective(self, make_study, function_backend, value):
        study = make_study(objective={"metric": "error", "scale": "log"})
        trial, *_ = run(study, function_backend(study, lambda **v: smooth(**v) | {"error": value}))
        assert trial.state is TrialState.FAILED
        assert trial.reason == f"metric error is {value}; its log scale needs a positive value"
        assert trial.evaluations[0].outcome.metrics == {}

    def test_a_run_that_diverged_is_a_failed_one(self, make_study, function_backend):
        """A finite number that the surrogates cannot take used to end the run, and every resume."""
        study = make_study().replace(trials=5, initial_trials=3)

        def diverging(gain, **values):
            said = smooth(gain=gain, **values)
            return said | {"error": 1e150} if gain > 0.5 else said

        trials = run(study, function_backend(study, diverging))
        assert len(trials) == 5
        for trial in trials:
            expected = TrialState.FAILED if trial.parameters["gain"] > 0.5 else TrialState.COMPLETE
            assert trial.state is expected
            if trial.state is TrialState.FAILED:
                assert trial.reason == "axis: metric error is 1e+150, beyond 1e+90"

    def test_three_lost_in_a_row_end_the_run(self, make_study, function_backend, failed):
        study = make_study()
        seen = []
        lost = failed("axis was ended by SIGKILL", EvaluationState.LOST)
        with pytest.raises(RunError, match=r"3 trials in a row .* axis was ended by SIGKILL"):
            iter_into(trials_of(study, function_backend(study, lambda **_: lost)), seen)
        # The third is handed out for the record before the run ends.
        assert [trial.number for trial in seen] == [0, 1, 2]
        assert all(trial.state is TrialState.FAILED for trial in seen)

    def test_so_do_three_that_others_disturbed(self, make_study, function_backend):
        study = make_study()
        reason = "axis: parameter gain is 1.0, expected 0.5 (changed by someone else)"
        disturbed = Outcome(EvaluationState.FAILED, {}, reason, notes=Notes(Unusable.DISTURBED))
        seen = []
        with pytest.raises(RunError, match=r"^3 trials in a row were disturbed: axis: p"):
            iter_into(trials_of(study, function_backend(study, lambda **_: disturbed)), seen)
        assert len(seen) == 3
        # Those on record ended an earlier session: whoever resumes it has the nodes again.
        again = trials_of(study, function_backend(study, lambda **_: disturbed), trials=seen)
        more = []
        with pytest.raises(RunError, match=r"^3 trials in a row were disturbed"):
            iter_into(again, more)
        assert [trial.number for trial in more] == [3, 4, 5]

    def test_so_do_three_that_could_not_be_prepared(self, make_study, function_backend):
        study = make_study()
        reason = "the preparation with the safe parameters failed: run.before[1]: 'v < 1' does not"
        unprepared = Outcome(EvaluationState.FAILED, {}, reason, notes=Notes(Unusable.UNPREPARED))
        assert unprepared.unusable
        seen = []
        with pytest.raises(RunError, match=r"^3 trials in a row could not be prepared: the prepar"):
            iter_into(trials_of(study, function_backend(study, lambda **_: unprepared)), seen)
        assert [trial.ending for trial in seen] == ["unprepared"] * 3
        assert all(trial.disturbed for trial in seen)

    def test_others_in_between_do_not(self, make_study, function_backend, failed):
        study = make_study().replace(trials=3, initial_trials=3)
        gone = ["lost"] * 4
        fates = iter([*gone, "failed", *gone, *["whole"] * 4, *gone, "failed"])

        def fate(**values):
            now = next(fates)
            return smooth(**values) if now == "whole" else failed(now, EvaluationState(now))

        trials = run(study, function_backend(study, fate))
        # Each was run twice, and none of them counts as one of the three.
        assert [trial.reason for trial in trials] == [
            "lost", "lost", "failed", "lost", "lost", "", "lost", "lost", "failed",
        ]  # fmt: skip

    @pytest.mark.parametrize("algorithm", METHODS)
    @pytest.mark.parametrize("at", [0, 1, 9])
    def test_a_loss_changes_nothing(self, make_study, function_backend, failed, algorithm, at):
        """The evaluation is run again in its place, and none is missing in the end."""
        study, algorithm = make_study().replace(trials=4), METHODS[algorithm]
        expected = run(study, function_backend(study, smooth), algorithm)
        at = min(at, sum(len(trial.evaluations) for trial in expected) - 1)
        count = itertools.count()

        def lost_once(**values):
            lost = failed("axis was ended by SIGKILL", EvaluationState.LOST)
            return lost if next(count) == at else smooth(**values)

        backend, watcher = function_backend(study, lost_once), Watcher()
        found = list(Tuning(study, Driver(backend, watcher), algorithm))
        assert found == expected
        # The loss is on record.
        assert [e.outcome.state for e in watcher.evaluations].count(EvaluationState.LOST) == 1

    def test_lost_trials_take_no_evaluations_of_the_budget(
        self, make_study, function_backend, failed
    ):
        study = make_study(constraints={}).replace(evaluations=6, initial_trials=3)
        fates = iter([True, False, False, *[True] * 10])

        def fate(**values):
            return smooth(**values) if next(fates) else failed("gone", EvaluationState.LOST)

        trials = run(study, function_backend(study, fate))
        # Two evaluations a trial; of the first one, the second was lost twice.
        assert [trial.ending for trial in trials] == ["lost", "complete", "complete", "complete"]
        assert count_trials(trials) == 3
        assert count_evaluations(trials) == 6


def iter_into(tuning, seen):
    for trial in tuning:
        seen.append(trial)


class TestRepetition:
    @pytest.mark.parametrize("algorithm", METHODS)
    def test_one_seed_one_run(self, make_study, function_backend, algorithm):
        study = make_study().replace(trials=4)
        first, second = (
            run(study, function_backend(study, smooth), METHODS[algorithm]) for _ in range(2)
        )
        assert first == second

    def test_a_recorded_metric_changes_nothing(self, make_study, function_backend):
        def trials(**metrics):
            study = make_study(metrics={"error": NODE, "peak": NODE} | metrics)
            found = {"error": 1.0, "peak": 0.5, "effort": 0.0}

            def run(gain, load, seed):
                moved = (gain - 0.3) ** 2 + 0.01 * load
                return found | {"error": moved, "peak": gain, "effort": 7.0 * gain + load}

            made = list(Tuning(study, Driver(function_backend(study, run)), METHODS["IV"]))
            return [(t.parameters, [(e.context, e.seed) for e in t.evaluations]) for t in made]

        assert trials(effort=NODE) == trials()

    def test_another_seed_another_run(self, make_study, function_backend):
        first, second = (
            next(iter(Tuning(study, Driver(function_backend(study, smooth)), IV)))
            for study in (make_study(seed=1), make_study(seed=2))
        )
        assert first.parameters != second.parameters
        assert first.evaluations[0].context != second.evaluations[0].context
        assert first.evaluations[0].seed != second.evaluations[0].seed

    def test_a_resumed_run_continues_as_if_uninterrupted(
        self, make_study, function_backend, tmp_path
    ):
        study = make_study(
            parameters={
                "gain": {"node": "axis", "type": "double", "bounds": [0, 1], "default": 0.5},
                "window": {"node": "axis", "type": "integer", "bounds": [1, 9], "default": 3},
            }
        ).replace(trials=10)

        def function(window, **values):
            figures = smooth(**values)
            return figures | {"error": figures["error"] + 0.01 * (window - 5) ** 2}

        with Journal(tmp_path / "journal.sqlite", {}) as journal:
            tuning = Tuning(
                study, Driver(function_backend(study, function), JournalObserver(journal)), IV
            )
            trials = []
            for trial in tuning:
                journal.record_trial(trial)
                trials.append(trial)
        recorded = read_journal(tmp_path / "journal.sqlite").trials
        for known in (1, 3, 6, 9):
            rest = run(study, function_backend(study, function), trials=recorded[:known])
            assert rest == trials[known:]

    def test_a_finished_run_has_nothing_left(self, whole, function_backend):
        study, _, trials = whole
        assert run(study, function_backend(study, smooth), trials=trials) == []


class TestMilling:
    """The shipped study in this process: the record repeats to the last bit."""

    @staticmethod
    def trials(seed):
        study = load_study("benchmark").replace(
            seed=seed, trials=3, initial_trials=2, drawn_contexts=2, search_evaluations=1
        )
        backend = InProcessBackend(study)
        backend.open()
        return run(study, backend)

    def test_one_seed_one_record(self):
        first = self.trials(3)
        assert first == self.trials(3)
        assert {trial.state for trial in first} == {TrialState.COMPLETE}
        assert first[0].parameters != self.trials(4)[0].parameters
