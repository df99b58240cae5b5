"""Runs that are cut short: when, and what becomes of their trials."""

import dataclasses
import math

import numpy as np
import pytest
from cut_short_runs import GROWS, EndingBackend, short_study
from functions import NODE

from bo_tuner.methods.boundary.hopeless import DEVIATIONS, hopeless_beyond
from bo_tuner.methods.registry import METHODS, problem_of
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.optimizers.base import Hopeless, Proposal
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.study.safe_search import SafeSearch
from bo_tuner.trials import CHECKS, EvaluationState, Stage, TrialState
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.journaling import JournalObserver
from bo_tuner.tuning.loop import TrialTask, Tuning
from bo_tuner.tuning.summary import choose_answer

BOUNDARY = METHODS["boundary"]


def machine(gain, load, seed):
    """With a gain beyond 1 / load the peak is beyond its limit of 1; the error falls with it."""
    noise = 0.01 * math.sin(7.0 * seed)
    return {"error": 1.2 - gain + 0.1 * load + noise, "peak": gain * load * (1.0 + noise)}


def tuned(study, backend):
    return list(Tuning(study, Driver(backend), BOUNDARY))


@pytest.fixture(scope="module")
def made():
    """A study, its backend and its trials."""
    study = short_study()
    backend = EndingBackend(study, machine)
    return study, backend, tuned(study, backend)


@pytest.fixture(scope="module")
def models(made):
    """The models of all trials."""
    study, _, trials = made
    return PooledModels()(study, trials, rng=np.random.default_rng(0))


class TestTrials:
    def test_some_are_cut_short_and_none_has_failed(self, made):
        _, _, trials = made
        states = {trial.state for trial in trials}
        assert states == {TrialState.COMPLETE, TrialState.CUT_SHORT}

    def test_one_ends_with_the_run_that_was_cut(self, made):
        for trial in made[2]:
            cut = [e.outcome.state is EvaluationState.CUT_SHORT for e in trial.evaluations]
            assert not any(cut[:-1])
            assert cut[-1] == (trial.state is TrialState.CUT_SHORT)
            if cut[-1]:
                assert trial.reason == trial.evaluations[-1].outcome.reason
                assert trial.worst_cases == {}

    def test_its_bounds_are_of_metrics_that_grow_and_below_their_values(self, made):
        _, _, trials = made
        cut = [e for t in trials if t.state is TrialState.CUT_SHORT for e in t.evaluations[-1:]]
        for evaluation in cut:
            known = evaluation.outcome.notes.at_least
            assert known.keys() == {"error", "peak"}
            whole = machine(
                evaluation.parameters["gain"], **evaluation.context, seed=evaluation.seed
            )
            assert all(value <= whole[name] for name, value in known.items())
            assert evaluation.outcome.metrics == {}
            assert any(known[name] > most for name, most in evaluation.beyond.items())

    def test_none_is_cut_that_may_be_the_answer(self, made):
        """At a gain of 0.5 the limit holds in every context, with an expected error of 0.85."""
        for trial in made[2]:
            if trial.state is TrialState.CUT_SHORT and trial.parameters["gain"] < 0.5:
                assert trial.evaluations[-1].outcome.notes.at_least["error"] > 0.85

    def test_the_first_ones_run_to_their_end(self, made):
        """Without models nobody knows what noise explains."""
        first = [planned for planned in made[1].planned if planned.trial < 2]
        assert all(not planned.beyond for planned in first)

    def test_none_is_cut_where_nothing_is_believed_feasible(self):
        """How far each is beyond the limit leads to where it is kept."""

        def hopeless(gain, load, seed):
            noise = 0.01 * math.sin(7.0 * seed)
            return {"error": 1.0 + noise, "peak": (2.0 + 5.0 * gain) * load * (1.0 + noise)}

        trials = tuned(study := short_study(), EndingBackend(study, hopeless))
        assert len(trials) == study.budget.trials
        assert {trial.state for trial in trials} == {TrialState.COMPLETE}

    def test_those_of_the_search_for_the_answer_too(self, made):
        study, _, trials = made
        backend = EndingBackend(study, machine)
        choose_answer(study, Driver(backend), BOUNDARY, trials)
        assert backend.planned
        assert all(planned.stage in CHECKS and not planned.beyond for planned in backend.planned)

    def test_the_answer_keeps_the_limit(self, made):
        study, _, trials = made
        answer = choose_answer(study, Driver(EndingBackend(study, machine)), BOUNDARY, trials)
        assert answer.feasible
        assert 0.35 < answer.candidate.trial.parameters["gain"] < 0.5

    def test_a_resumed_run_goes_on_as_it_would_have(self, made, tmp_path):
        study, _, trials = made
        backend = EndingBackend(study, machine)
        with Journal(tmp_path / "journal.sqlite", {}) as journal:
            again = Tuning(study, Driver(backend, JournalObserver(journal)), BOUNDARY)
            for trial in again:
                journal.record_trial(trial)
                if trial.number == 7:
                    break
        known = read_journal(tmp_path / "journal.sqlite").trials
        assert list(known) == trials[:8]
        assert any(trial.state is TrialState.CUT_SHORT for trial in known)
        rest = Tuning(study, Driver(EndingBackend(study, machine)), BOUNDARY, trials=known)
        assert list(rest) == trials[8:]

    def test_one_ends_with_a_whole_run_that_shows_the_same(self):
        """Also by a metric that does not grow, and so cuts nothing short."""
        study = short_study(metrics={"error": GROWS, "peak": NODE})
        hopeless = Hopeless({"peak": 1.05})
        for gain, runs in ((0.9, 1), (0.4, 2)):
            proposal = Proposal({"gain": gain}, "initial", hopeless=hopeless)
            task = TrialTask(study, BOUNDARY, 0, proposal, [], 0.0)
            made = []
            while len(made) < 2 and (planned := task.ask()) is not None:
                assert planned.beyond == {}
                made.append(EndingBackend(study, machine).outcome(planned))
                task.tell(dataclasses.replace(planned, outcome=made[-1]))
            assert len(made) == runs
            assert all(outcome.complete for outcome in made)


class TestBounds:
    """Of a study whose noise is known from runs at few places."""

    def bounds(self, made, models, lowest, **changes):
        study = dataclasses.replace(made[0], **changes)
        return hopeless_beyond(study, models, np.array([0.4]), lowest)

    def test_a_limit_in_every_context_is_as_far_beyond_as_noise_explains(self, made, models):
        bounds = self.bounds(made, models, 0.8)
        assert "peak" not in bounds.drawn
        margin = bounds.anywhere["peak"] - 1.0
        # Of a peak of 1.5 the noise has the standard deviation 0.01 · 1.5 / √2.
        assert 0.0 < margin < 6.0 * DEVIATIONS * 0.01

    def test_the_objective_is_held_against_the_best_one_where_the_context_was_drawn(
        self, made, models
    ):
        bounds = self.bounds(made, models, 0.8)
        assert bounds.drawn["error"] > 0.8
        assert "error" not in bounds.anywhere
        assert bounds.beyond(Stage.SEARCH).keys() == {"peak"}
        assert bounds.beyond(Stage.DRAWN).keys() == {"peak", "error"}

    def test_where_all_known_runs_keep_a_limit_noise_counts_all_the_same(self):
        """Of a metric on the logarithmic scale, whose noise is at most 1 % of it."""
        gain = {"type": "double", "bounds": [0.05, 0.45], "default": 0.2}
        study = short_study(
            metrics={"error": GROWS, "peak": GROWS | {"scale": "log"}},
            parameters={"gain": NODE | gain},
        )
        trials = tuned(study, EndingBackend(study, machine))
        models = PooledModels()(study, trials, rng=np.random.default_rng(0))
        bounds = hopeless_beyond(study, models, np.array([0.5]), 0.8)
        assert 1.002 < bounds.anywhere["peak"] < 1.2

    def test_the_lower_of_two_bounds_counts_in_a_context_that_was_drawn(self):
        bounds = Hopeless({"peak": 2.0}, {"peak": 1.5})
        assert bounds.beyond(Stage.DRAWN) == {"peak": 1.5}
        assert bounds.beyond(Stage.SEARCH) == {"peak": 2.0}


def test_failures_and_runs_that_are_cut_short_are_told_apart():
    """A crash is learnt as one, a run that was cut short is not."""

    def crashing(gain, load, seed):
        if gain > 0.8:
            return {"status": "failed", "reason": "crashed"}
        return machine(gain, load, seed)

    study = short_study()
    trials = tuned(study, EndingBackend(study, crashing))
    models = PooledModels()(study, trials, rng=np.random.default_rng(0))
    runs = [e for t in trials if t.state is not TrialState.CUT_SHORT for e in t.evaluations]
    assert len(models.crashes.labels) == len(runs)
    assert models.crashes.labels.sum() == sum(t.state is TrialState.FAILED for t in trials)


@pytest.mark.parametrize("name", ["I", "V", "safe"])
def test_methods_that_need_whole_runs_refuse_it(name):
    # Of the methods only the safe one takes a study that asks for a safe search.
    more = {"safe_search": SafeSearch()} if name == "safe" else {}
    others = "" if more else "; expected boundary"
    whole, cut = (dataclasses.replace(short_study(cut=cut), **more) for cut in (False, True))
    assert problem_of(name, cut) == (
        f"{name} needs whole runs, and the study has `budget.cut_short`{others}"
    )
    assert problem_of(name, whole) == ""
