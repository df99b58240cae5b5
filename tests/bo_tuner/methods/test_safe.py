"""The method safe, on functions whose limit is known: what it tries, and what it never tries."""

import dataclasses
import itertools

import numpy as np
import pytest
from functions import Watcher

from bo_tuner.method_names import SAFE
from bo_tuner.methods.registry import METHODS, method_of
from bo_tuner.methods.safe.stage_one import NO_SAFE_START, START_REFUSED
from bo_tuner.methods.safe.trust import FIRST, IN_A_ROW, trust_after
from bo_tuner.plans import EventKind
from bo_tuner.study.limits import is_within_limits, kept_by
from bo_tuner.study.safe_search import SafeSearch
from bo_tuner.trials import EvaluationState, Outcome, Stage
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Answer, Gate
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import conclude

METHOD = METHODS[SAFE]
NODE = {"node": "axis"}
TRAVEL = 0.1


def ramp(x, load, seed, **_):
    """The cost falls with x, and the peak reaches 1 at x = 0.6 in the worst context, load = 2."""
    rng = np.random.default_rng(seed)
    return {
        "error": 2.0 - x + rng.normal(0.0, 0.01),
        "peak": 0.4 + 0.5 * x * load + rng.normal(0.0, 0.01),
    }


def number(default=0.1, **keys):
    return NODE | {"type": "double", "bounds": [0.0, 1.0], "default": default} | keys


@pytest.fixture(scope="module")
def study_of(make_study):
    def make(parameters=None, trials=12, start=("default",), **sections):
        budget = {"trials": trials, "initial_trials": 4, "validation_draws": 3}
        return make_study(
            parameters=parameters or {"x": number()},
            budget=budget,
            start=list(start),
            safe_search={"travel": TRAVEL},
            **sections,
        )

    return make


@pytest.fixture(scope="module")
def tune(function_backend):
    """Function that carries out the trials of a study, and returns them with what was observed."""

    def run(study, function, trials=()):
        watcher = Watcher()
        driver = Driver(function_backend(study, function), watcher)
        tuning = Tuning(study, driver, METHOD, trials=trials)
        for _ in tuning:
            pass
        return tuning, watcher

    return run


@pytest.fixture(scope="module")
def whole(study_of, tune):
    study = study_of()
    return study, tune(study, ramp)[0].trials


class TestStart:
    def test_runs_in_all_corners_first(self, whole):
        _, trials = whole
        loads = [e.context["load"] for e in trials[0].evaluations if e.stage is Stage.SEARCH]
        assert {1.0, 2.0} <= set(loads)

    def test_a_start_that_breaks_a_limit_ends_the_search_at_once(self, study_of, tune):
        """Nor is it run again, since nothing is known to be safe."""
        study = study_of({"x": number(0.9)})
        tuning, _ = tune(study, lambda **told: ramp(**told) | {"peak": 1.5})
        assert [len(trial.evaluations) for trial in tuning.trials] == [1]
        assert tuning.plan.standstill == NO_SAFE_START

    def test_it_is_on_record(self, study_of, tune):
        study = study_of({"x": number(0.9)})
        _, watcher = tune(study, lambda **told: ramp(**told) | {"peak": 1.5})
        (event,) = watcher.events
        assert (event.kind, event.tasks, event.detail) == (EventKind.STANDSTILL, 1, NO_SAFE_START)

    def test_one_that_is_safe_suffices(self, study_of, tune):
        study = study_of({"x": number(0.9)}, trials=4, start=("default", {"x": 0.1}))
        tuning, _ = tune(study, ramp)
        within = [is_within_limits(study, trial) for trial in tuning.trials]
        assert within == [False, True, True, True]
        assert all(trial.parameters["x"] < 0.3 for trial in tuning.trials[1:])

    def test_an_unsafe_default_is_not_run_in_the_validation(self, study_of, function_backend):
        study = study_of({"x": number(0.9)}, trials=3, start=({"x": 0.1},))
        driver = Driver(function_backend(study, ramp))
        tuning = Tuning(study, driver, METHOD)
        list(tuning)
        conclusion = conclude(study, driver, METHOD, tuning.trials)
        assert conclusion.default.draws == 0
        assert conclusion.tuned.draws == 3


class TestSearch:
    def test_breaks_no_limit_and_comes_near_it(self, whole):
        """The largest x that is feasible is 0.6; noise of 0.01 keeps runs off the last 0.03."""
        study, trials = whole
        assert all(is_within_limits(study, trial) for trial in trials)
        assert 0.5 < max(trial.parameters["x"] for trial in trials) < 0.6

    def test_each_trial_is_within_reach_of_one_that_kept_the_limits(self, whole):
        study, trials = whole
        for trial in trials[1:]:
            kept = [t.parameters["x"] for t in kept_by(study, trials[: trial.number])]
            assert min(abs(trial.parameters["x"] - x) for x in kept) <= TRAVEL + 1e-9

    def test_a_parameter_has_a_travel_of_its_own(self, study_of, tune):
        study = study_of({"x": number(travel=0.02), "y": number()}, trials=7)
        trials = tune(study, lambda y, **told: ramp(**told))[0].trials
        for trial in trials[1:]:
            kept = [t.parameters["x"] for t in kept_by(study, trials[: trial.number])]
            assert min(abs(trial.parameters["x"] - x) for x in kept) <= 0.02 + 1e-9

    def test_the_first_steps_change_one_number_a_little(self, study_of, tune):
        study = study_of({"x": number(), "y": number(0.8)}, trials=3)
        trials = tune(study, lambda y, **told: ramp(**told))[0].trials
        start, *steps = [(t.parameters["x"], t.parameters["y"]) for t in trials]
        assert steps == [pytest.approx((0.11, 0.8)), pytest.approx((0.1, 0.79))]
        assert start == (0.1, 0.8)

    def test_a_choice_changes_only_where_all_else_is_equal(self, study_of, tune):
        choice = NODE | {"type": "string", "choices": ["p", "q", "r"], "default": "p"}
        study = study_of({"x": number(), "law": choice}, trials=9)
        trials = tune(study, lambda law, **told: ramp(**told))[0].trials
        for trial in trials[1:]:
            law, x = trial.parameters["law"], trial.parameters["x"]
            before = [t.parameters for t in trials[: trial.number]]
            assert any(p["law"] == law or p["x"] == pytest.approx(x) for p in before)

    def test_a_trial_ends_with_the_run_that_breaks_a_limit(self, study_of, tune):
        count = itertools.count()
        study = study_of(trials=2)

        def breaks(**told):
            # The start has two drawn contexts, two corners, and a search that finds no other.
            return ramp(**told) | ({"peak": 2.0} if next(count) == 6 else {})

        trials = tune(study, breaks)[0].trials
        assert [len(trial.evaluations) for trial in trials] == [5, 2]

    def test_continues_as_if_it_had_not_been_interrupted(self, whole, tune):
        study, trials = whole
        assert tune(study, ramp, trials[:7])[0].trials == trials

    def test_no_parameter_set_that_broke_a_limit_is_a_candidate(self, whole):
        study, trials = whole
        broken = dataclasses.replace(
            trials[5],
            evaluations=(
                *trials[5].evaluations[:-1],
                dataclasses.replace(
                    trials[5].evaluations[-1],
                    outcome=Outcome(EvaluationState.COMPLETE, {"error": 0.1, "peak": 1.1}),
                ),
            ),
        )
        known = [*trials[:5], broken, *trials[6:]]
        ranked = METHOD.ranking.rank(study, known)
        assert {c.trial.number for c in ranked} == {t.number for t in known} - {5}


class Refusing:
    """Refuses the proposals of some numbers, in the order in which they are asked about."""

    def __init__(self, refused):
        self.refused = refused
        self.asked = []

    def concerns(self, task):
        return not task.recorded

    def ask(self, task, question, wait):
        self.asked.append(dict(task.parameters))
        return Answer(len(self.asked) - 1 not in self.refused, False, "")


@pytest.fixture(scope="module")
def refused(study_of, function_backend):
    """A run in which the second and the sixth proposal were refused, and what was asked."""
    study, gate, watcher = study_of(trials=8), Gate(), Watcher()
    gate.admission = Refusing({1, 5})
    driver = Driver(function_backend(study, ramp), watcher, gate=gate)
    trials = list(Tuning(study, driver, METHOD))
    return study, gate.admission.asked, trials, watcher.events


class TestRefusal:
    def test_is_not_run_and_does_not_count(self, refused):
        _, asked, trials, events = refused
        assert len(asked) == len(trials) + 2
        assert [t.parameters for t in trials] == [a for k, a in enumerate(asked) if k not in (1, 5)]
        assert [e.tasks for e in events if e.kind is EventKind.REFUSE] == [1, 4]

    def test_what_is_proposed_in_its_place_differs(self, refused):
        _, asked, trials, _ = refused
        later = [trial.parameters["x"] for trial in trials[4:]]
        # Half of the largest step at the trust of a quarter or a half.
        assert all(abs(x - asked[5]["x"]) > 0.5 * TRAVEL * FIRST for x in later)

    def test_a_run_that_continues_knows_of_it(self, refused, function_backend):
        study, asked, trials, _ = refused
        driver = Driver(function_backend(study, ramp))
        again = Tuning(study, driver, METHOD, trials=trials[:6], refused=[asked[1], asked[5]])
        assert [*trials[:6], *again] == trials

    def test_of_the_only_start_ends_the_search(self, study_of, function_backend):
        study, gate = study_of(trials=3), Gate()
        gate.admission = Refusing({0})
        tuning = Tuning(study, Driver(function_backend(study, ramp), gate=gate), METHOD)
        assert list(tuning) == []
        assert tuning.plan.standstill == START_REFUSED


class TestStandstill:
    def test_names_the_limit_that_is_in_the_way(self, study_of, tune):
        """With a noise as large as the margin no run can be sure to keep the limit."""
        study = study_of(trials=12)

        def noisy(x, load, seed, **_):
            return {"error": 2.0 - x, "peak": 0.7 + 0.25 * float(seed % 3 - 1)}

        tuning, _ = tune(study, noisy)
        assert len(tuning.trials) < 12
        assert "the limit peak" in tuning.plan.standstill
        assert "safe_search.risk" in tuning.plan.standstill


class TestTrust:
    def test_halves_with_a_broken_limit_and_doubles_after_several_without(self, whole):
        study, trials = whole
        within, metrics = trials[1], {"error": 1.0, "peak": 1.1}
        run = dataclasses.replace(
            within.evaluations[0], outcome=Outcome(EvaluationState.COMPLETE, metrics)
        )
        broken = dataclasses.replace(within, evaluations=(run,))
        assert trust_after(study, []) == FIRST
        assert trust_after(study, [broken]) == FIRST / 2.0
        assert trust_after(study, [within] * IN_A_ROW) == 2.0 * FIRST
        assert trust_after(study, [within] * (IN_A_ROW - 1) + [broken]) == FIRST / 2.0
        assert trust_after(study, [within] * 100) == 1.0

    def test_a_failure_counts_and_a_lost_run_does_not(self, whole):
        study, trials = whole

        def ended(state):
            run = dataclasses.replace(trials[1].evaluations[0], outcome=Outcome(state))
            return dataclasses.replace(trials[1], evaluations=(run,))

        assert trust_after(study, [ended(EvaluationState.FAILED)]) == FIRST / 2.0
        lost = dataclasses.replace(ended(EvaluationState.LOST), state=trials[1].state)
        assert not is_within_limits(study, lost)


class TestStudy:
    def test_with_safe_search_has_the_method(self, study_of, make_study):
        assert method_of(study_of()) == SAFE
        assert method_of(make_study()) != SAFE

    @pytest.mark.parametrize(("given", "expected"), [(True, SafeSearch()), (False, None)])
    def test_takes_a_word(self, make_study, given, expected):
        assert make_study(safe_search=given).safe_search == expected

    def test_without_a_limit_is_refused(self, make_study):
        assert "needs a limit" in METHOD.problem(make_study(constraints={}))
