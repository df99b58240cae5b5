"""The algorithm boundary, on functions whose feasible optimum is known."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.stats import norm

from bo_tuner.method_names import BOUNDARY
from bo_tuner.methods.boundary.settling import with_repetitions
from bo_tuner.methods.boundary.stage_one import AdaptedAvoidance, new_point
from bo_tuner.methods.registry import METHODS
from bo_tuner.trials import EvaluationState, Stage, TrialState, count_evaluations, pooled
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer

SEEDS = [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]

ALGORITHM = METHODS[BOUNDARY]
SCHEDULE = ALGORITHM.schedule
NODE = {"node": "axis"}
PEAK = {"kind": "worst_case", "metric": "peak", "upper": 1.0}
CHANCE = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}


def double(lower=0.0, upper=1.0):
    return NODE | {"type": "double", "bounds": [lower, upper], "default": lower}


def boundary(x, load, seed):
    """Cost falls with x, and the peak exceeds 1 for x > 0.6, under the largest load, 2, only.

    The noise on the peak grows with the load: 0.01 under the smallest, 0.05 under the largest.
    """
    rng = np.random.default_rng(seed)
    noise = 0.01 + 0.04 * (load - 1.0)
    return {
        "error": 2.0 - x + 0.2 * (load - 1.5) + rng.normal(0.0, 0.02),
        "peak": 0.4 + 0.5 * x * load - 0.25 * (2.0 - load) + rng.normal(0.0, noise),
    }


@pytest.fixture(scope="module")
def study_of(make_study):
    def make(parameters=None, evaluations=70, seed=1, initial=5, peak=PEAK, **sections):
        budget = {"trials": evaluations, "initial_trials": initial, "evaluations": evaluations}
        return make_study(
            parameters={"x": double()} if parameters is None else parameters,
            budget=budget,
            constraints={} if peak is None else {"peak": peak},
            seed=seed,
            **sections,
        )

    return make


@pytest.fixture(scope="module")
def tune(function_backend):
    """Function that runs a study to its end, and returns its trials and recommendation."""

    def run(study, function, trials=()):
        backend = function_backend(study, function)
        tuning = Tuning(study, Driver(backend), ALGORITHM, trials=trials)
        for _ in tuning:
            pass
        return tuning.trials, choose_answer(study, Driver(backend), ALGORITHM, tuning.trials)

    return run


@pytest.fixture(scope="module")
def run_of(study_of, tune):
    """Function that returns study, trials and recommendation of the run with a seed."""

    @functools.cache
    def run(seed):
        study = study_of(seed=seed)
        return study, *tune(study, boundary)

    return run


@pytest.fixture
def run(run_of):
    return run_of(1)


class TestAnswer:
    @pytest.mark.parametrize("seed", SEEDS)
    def test_is_feasible_and_close_to_the_limit(self, run_of, seed):
        """The limit is at x = 0.6; a slope of 1 and noise of 0.05 leave 0.01 after 30 runs."""
        _, _, best = run_of(seed)
        x = best.candidate.trial.parameters["x"]
        assert best.feasible
        assert 0.5 < x <= 0.61
        assert best.candidate.objective == pytest.approx(2.0 - x, abs=0.03)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_keeps_the_probability_of_a_run(self, study_of, tune, seed):
        """By the noise under the largest load; the common one is a little more than half of it."""
        study = study_of(seed=seed, peak=PEAK | {"probability": 0.9})
        _, best = tune(study, boundary)
        x = best.candidate.trial.parameters["x"]
        assert best.feasible
        # The uncertainty of 90 evaluations apart; the common noise, 0.03, would end at 0.78.
        assert norm.cdf((1.0 - 0.4 - x) / 0.05) >= 0.87
        assert x > 0.4
        assert best.candidate.trial.worst_cases["peak"].noise == pytest.approx(0.05, rel=0.4)

    def test_nothing_feasible_is_not_called_so(self, study_of, tune):
        def hopeless(x, load, seed):
            return boundary(x, load, seed) | {"peak": 1.5 + 0.1 * x}

        _, best = tune(study_of(evaluations=40), hopeless)
        assert not best.feasible
        assert best.candidate.feasibility < 0.5


class TestProtocol:
    def test_the_budget_is_in_evaluations(self, run):
        study, trials, _ = run
        counts = np.cumsum([len(trial.evaluations) for trial in trials])
        assert counts[-2] < 70 <= counts[-1] < 75
        assert study.budget.is_spent(len(trials), counts[-1])
        assert not study.budget.is_spent(len(trials) - 1, counts[-2])

    def test_each_trial_is_a_new_parameter_set(self, run):
        _, trials, _ = run
        assert len(pooled(trials)) == len(trials)

    def test_the_second_part_runs_new_points_in_their_worst_context(self, run):
        study, trials, _ = run
        later = [
            t
            for k, t in enumerate(trials)
            if not SCHEDULE.searches(study, k, count_evaluations(trials[:k]))
        ]
        assert len(later) >= 5
        for trial in later:
            stages = [evaluation.stage for evaluation in trial.evaluations]
            assert stages == [Stage.DRAWN, Stage.SEARCH, Stage.SEARCH]

    @pytest.mark.parametrize(
        ("peak", "sections", "planned"),
        [
            (CHANCE, {}, (3, 0)),
            (CHANCE, {"contexts": {}}, (3, 0)),
            (CHANCE, {"contexts": {}, "noise": "none"}, (1, 0)),
            (None, {}, (1, 0)),
            (PEAK, {}, (1, 2)),
        ],
        ids=["over contexts", "over noise", "a run tells all", "no limit", "worst case"],
    )
    def test_new_points_are_run_where_their_limits_are_doubtful(
        self, study_of, peak, sections, planned
    ):
        assert new_point(study_of(peak=peak, **sections)) == planned

    def test_the_evaluations_ahead_are_those_that_come(self, run):
        study, trials, _ = run
        made = [len(trial.evaluations) for trial in trials]
        first = study.budget.initial_trials
        done = sum(made[:first])
        ahead = list(SCHEDULE.evaluations_ahead(study, first, done, 4.0))
        searched = ahead.count(4.0)
        assert 0 < searched < len(ahead)
        assert ahead == [4.0] * searched + [3] * (len(ahead) - searched)
        assert sum(ahead[:-1]) < study.budget.evaluations - done <= sum(ahead)

    def test_evaluations_of_a_search_as_the_study_has_them(self, study_of, tune):
        study = study_of(evaluations=30)
        budget = dataclasses.replace(study.budget, drawn_contexts=4, search_evaluations=0)
        trials, _ = tune(dataclasses.replace(study, budget=budget), boundary)
        stages = [[e.stage for e in trial.evaluations] for trial in trials[:5]]
        assert stages == [[Stage.DRAWN] * 4] * 5

    @pytest.mark.parametrize("count", [3, 12, 20])
    def test_a_resumed_run_continues_as_if_uninterrupted(self, study_of, tune, run, count):
        _, trials, _ = run
        again, _ = tune(study_of(), boundary, trials[:count])
        assert again == trials

    def test_trials_alone_limit_the_run_too(self, study_of, tune):
        study = study_of()
        budget = dataclasses.replace(study.budget, trials=12, evaluations=None)
        trials, _ = tune(dataclasses.replace(study, budget=budget), boundary)
        assert len(trials) == 12


class TestCrashes:
    def crash(self, failed, x, load, seed):
        """No limit, but runs fail for x > 0.6 under large loads."""
        return failed("stalled") if x * load > 1.2 else boundary(x, load, seed) | {"peak": 0.0}

    @pytest.mark.parametrize("seed", SEEDS[:2])
    def test_few_trials_fail_although_the_optimum_is_at_the_edge(
        self, study_of, tune, failed, seed
    ):
        study = study_of(seed=seed, evaluations=70)
        trials, best = tune(study, lambda **given: self.crash(failed, **given))
        later = [trial for trial in trials if trial.number >= 5]
        share = np.mean([trial.state is TrialState.FAILED for trial in later])
        # The better the cost, the closer to the edge: without a model most trials crash there.
        assert share < 0.4
        assert 0.4 < best.candidate.trial.parameters["x"] <= 0.6

    def test_all_runs_fail(self, study_of, tune, failed):
        trials, best = tune(study_of(evaluations=20), lambda **_: failed("stalled"))
        assert len(trials) == 20
        assert best is None


class TestOtherStudies:
    def test_without_contexts(self, study_of, tune):
        study = study_of(contexts=None, evaluations=60)
        trials, best = tune(study, lambda x, seed: boundary(x, 2.0, seed))
        assert {len(trial.evaluations) for trial in trials[:5]} == {2}
        assert best.feasible
        assert 0.5 < best.candidate.trial.parameters["x"] <= 0.61

    def test_without_limits(self, study_of, tune):
        def bowl(x, load, seed):
            noise = np.random.default_rng(seed).normal(0.0, 0.02)
            return {"error": 1.0 + (x - 0.3) ** 2 + 0.2 * (load - 1.5) + noise, "peak": 0.0}

        _, best = tune(study_of(peak=None, evaluations=60), bowl)
        assert best.candidate.trial.parameters["x"] == pytest.approx(0.3, abs=0.1)
        # Without a limit nothing is in doubt.
        assert best.checked == ()

    def test_with_a_chance_constraint(self, study_of, tune):
        """P(peak <= 1) >= 0.8 over load and noise; x = 0.9 keeps it up to a load of 1.81."""
        chance = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.8}
        study = study_of(peak=chance, evaluations=50)
        _, best = tune(study, boundary)
        assert best.feasible
        assert 0.4 < best.candidate.trial.parameters["x"] < 0.9

    def test_with_integers_choices_and_an_order(self, study_of, tune):
        """The best: mode b, n = 4 of at most m, and x at the limit, 0.6."""
        parameters = {
            "x": double(),
            "n": NODE | {"type": "integer", "bounds": [1, 6], "default": 1},
            "m": NODE | {"type": "integer", "bounds": [1, 6], "default": 6},
            "mode": NODE | {"type": "string", "choices": ["a", "b", "c"], "default": "a"},
        }

        def mixed(x, n, m, mode, load, seed):
            found = boundary(x, load, seed)
            assert n <= m
            found["error"] += 0.05 * (n - 4) ** 2 + (0.0 if mode == "b" else 0.5)
            return found

        study = study_of(parameters, order=[["n", "m"]], evaluations=90, initial=10)
        _, best = tune(study, mixed)
        answer = best.candidate.trial.parameters
        assert best.feasible
        assert answer["mode"] == "b"
        assert answer["n"] in (3, 4, 5)
        assert answer["x"] <= 0.62
        assert best.checked


def lost_trial(make_trial, number, x):
    """A trial whose nodes were lost in its only evaluation."""
    trial = make_trial(number, {"x": x})
    (evaluation,) = trial.evaluations
    outcome = dataclasses.replace(evaluation.outcome, state=EvaluationState.LOST)
    return dataclasses.replace(
        trial, evaluations=(dataclasses.replace(evaluation, outcome=outcome),)
    )


def test_lost_trials_do_not_change_the_largest_probability_of_a_failure(make_study, make_trial):
    study = make_study(
        parameters={"x": {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.5}},
        budget={"trials": 30, "initial_trials": 3},
    )
    trials = [make_trial(number, {"x": number / 10}, [1.0]) for number in range(3)]
    trials += [lost_trial(make_trial, number, number / 20) for number in range(3, 13)]
    avoidance = AdaptedAvoidance()
    assert avoidance(study, trials) == avoidance.failing


class TestPooled:
    def test_joins_equal_parameter_sets(self, make_trial):
        first = make_trial(0, {"x": 0.5}, [1.0, 1.1], worst=0.4)
        other = make_trial(1, {"x": 0.6}, [1.0])
        again = make_trial(2, {"x": 0.5}, [1.2], worst=0.45)
        joint, alone = pooled([first, other, again])
        assert joint.number == 0
        assert joint.observations("error") == [1.0, 1.1, 1.2]
        assert joint.worst_cases["peak"].value == 0.45
        assert alone == other

    def test_a_crash_counts_for_all_runs_of_the_set(self, make_trial):
        (joint,) = pooled([make_trial(0, {"x": 0.5}, [1.0]), make_trial(1, {"x": 0.5})])
        assert joint.state is TrialState.FAILED
        assert joint.reason == "axis: stalled"

    def test_a_lost_node_does_not(self, make_trial):
        lost = lost_trial(make_trial, 1, 0.5)
        good = make_trial(0, {"x": 0.5}, [1.0])
        assert pooled([good, lost]) == [good]
        (joint,) = pooled([dataclasses.replace(lost, number=0), make_trial(1, {"x": 0.5}, [1.0])])
        assert joint.state is TrialState.COMPLETE
        # The one that is the result, if it is: a lost trial has no worst context, nor a bag.
        assert joint.number == 1

    def test_runs_of_a_set_whose_first_trial_was_lost_are_kept(self, make_trial):
        """They may be on record as repetitions of the lost one."""
        lost, good = lost_trial(make_trial, 0, 0.5), make_trial(3, {"x": 0.5}, [1.0, 1.1])
        (run,) = make_trial(0, {"x": 0.5}, [1.3]).evaluations
        run = dataclasses.replace(run, stage=Stage.CHECK_DRAWN, index=1)
        (joint,) = pooled([with_repetitions(lost, [run]), good])
        assert (joint.number, joint.state) == (3, TrialState.COMPLETE)
        assert joint.evaluations == (run, *good.evaluations)
        crash = dataclasses.replace(run, outcome=make_trial(0, {"x": 0.5}).evaluations[0].outcome)
        (joint,) = pooled([with_repetitions(lost, [run, crash]), good])
        assert (joint.state, joint.reason) == (TrialState.FAILED, "axis: stalled")
        assert joint.evaluations == (run, crash, *good.evaluations)

    def test_a_lost_repetition_leaves_the_other_runs(self, make_trial):
        good, again = make_trial(0, {"x": 0.5}, [1.0]), make_trial(2, {"x": 0.5}, [1.2])
        repeated = with_repetitions(good, lost_trial(make_trial, 0, 0.5).evaluations)
        (joint,) = pooled([repeated, again])
        assert joint.state is TrialState.COMPLETE
        assert joint.observations("error") == [1.0, 1.2]

    def test_one_candidate_for_each_set(self, run):
        study, trials, _ = run
        numbers = [candidate.trial.number for candidate in ALGORITHM.ranking.rank(study, trials)]
        assert sorted(numbers) == [trial.number for trial in pooled(trials)]
