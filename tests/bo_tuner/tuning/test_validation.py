"""Validation: the same fresh draws for all, and constraints counted as the study says."""

import itertools
import math

import numpy as np
import pytest
from functions import Watcher

from bo_tuner.backends.recorded import RecordedEvaluations
from bo_tuner.errors import RunError
from bo_tuner.methods.registry import METHODS
from bo_tuner.trials import EvaluationState, Stage
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.validation import ValidationPlan


def figures(error=lambda k: 1.0, peak=lambda k: 0.5):
    count = itertools.count()

    def function(**_):
        k = next(count)
        return {"error": error(k), "peak": peak(k)}

    return function


def validate(study, driver, candidates):
    plan = ValidationPlan(study, candidates)
    driver.complete(plan)
    return plan.results


def judge(make_study, function_backend, function, draws=25, **sections):
    study = make_study(**sections).replace(validation_draws=draws)
    (result,) = validate(study, Driver(function_backend(study, function)), [{"gain": 0.5}])
    return result


def chance(probability):
    constraint = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": probability}
    return {"constraints": {"peak": constraint}}


class TestDraws:
    def test_all_parametrizations_get_the_same(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, figures())
        watcher = Watcher()
        default, tuned = validate(
            study,
            Driver(backend, watcher),
            [{"gain": 0.25}, {"gain": 0.75}],
        )
        told = {gain: [c for c in backend.calls if c["gain"] == gain] for gain in (0.25, 0.75)}
        drawn = [[(c["load"], c["seed"]) for c in calls] for calls in told.values()]
        assert drawn[0] == drawn[1]
        assert len(set(drawn[0])) == study.budget.validation_draws == default.draws == tuned.draws
        assert {evaluation.stage for evaluation in watcher.evaluations} == {Stage.VALIDATION}
        # Each is first by turns: what changes with the runs is no difference between the two.
        by_turns = [0.25, 0.75, 0.75, 0.25, 0.25, 0.75, 0.75, 0.25, 0.25, 0.75]
        assert [e.parameters["gain"] for e in watcher.evaluations] == by_turns
        assert watcher.steps == [2, 4, 6, 8, 10]

    def test_they_are_fresh(self, make_study, function_backend):
        """No context and no noise of the training comes again."""
        study = make_study()
        training = function_backend(study, figures())
        list(Tuning(study, Driver(training), METHODS["IV"]))
        backend = function_backend(study, figures())
        validate(study, Driver(backend), [{"gain": 0.25}])
        for key in ("load", "seed"):
            assert not {c[key] for c in training.calls} & {c[key] for c in backend.calls}

    def test_they_follow_the_distribution(self, make_study, function_backend):
        study = make_study().replace(validation_draws=400)
        backend = function_backend(study, figures())
        validate(study, Driver(backend), [{"gain": 0.25}])
        loads = [call["load"] for call in backend.calls]
        # Uniform on [1, 2]: the mean is 1.5 with a standard error of 1 / sqrt(12 * 400).
        assert abs(np.mean(loads) - 1.5) < 4 / math.sqrt(12 * 400)


class TestChance:
    @pytest.mark.parametrize(
        ("probability", "draws", "above", "holds"),
        [
            (0.96, 25, 1, True),
            (0.96, 25, 2, False),
            (0.9, 10, 1, True),  # 1 - 0.9 is a little less than 0.1 in floating point
            (0.9, 10, 2, False),
            (0.9, 9, 1, False),
            (0.7, 10, 3, True),
            (0.99, 25, 1, False),
            (0.99, 25, 0, True),
        ],
    )
    def test_share(self, make_study, function_backend, probability, draws, above, holds):
        peak = figures(peak=lambda k: 1.5 if k < above else 0.5)
        found = judge(make_study, function_backend, peak, draws, **chance(probability))
        (check,) = found.constraints.values()
        assert check.violations == above
        assert check.agrees is holds
        assert found.feasible is holds
        assert check.worst == (1.5 if above else 0.5)

    def test_the_limit_itself_is_within(self, make_study, function_backend):
        found = judge(make_study, function_backend, figures(peak=lambda k: 1.0), **chance(0.999))
        assert found.feasible


class TestWorstCase:
    @pytest.mark.parametrize(("above", "holds"), [(3, True), (4, False)])
    def test_as_many_as_a_coincidence_allows(self, make_study, function_backend, above, holds):
        """Of ten draws, P(X >= 4) = 0.050 if each violates by 0.15, and P(X >= 3) = 0.18."""
        peak = figures(peak=lambda k: 1.1 if k < above else 0.5)
        limit = {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.851}
        study = make_study(constraints={"peak": limit}).replace(validation_draws=10)
        (found,) = validate(study, Driver(function_backend(study, peak)), [{"gain": 0.5}])
        assert found.constraints["peak"].violations == above
        assert found.feasible is holds

    @pytest.mark.parametrize(("level", "holds"), [(0.99, True), (1.5, False)])
    def test_a_limit_on_the_mean_is_refuted_by_the_mean(
        self, make_study, function_backend, level, holds
    ):
        """Half of the draws violate it either way."""
        found = judge(make_study, function_backend, figures(peak=lambda k: level + 0.4 * (-1) ** k))
        assert found.feasible is holds

    def test_no_constraints(self, make_study, function_backend):
        found = judge(make_study, function_backend, figures(), constraints={})
        assert found.feasible
        assert found.constraints == {}


class TestFailures:
    @pytest.mark.parametrize("state", [EvaluationState.FAILED, EvaluationState.LOST])
    def test_one_failed_evaluation_is_not_feasible(
        self, make_study, function_backend, failed, state
    ):
        plain = figures(error=float)
        count = itertools.count()

        def function(**values):
            figure = plain(**values)
            return failed("no", state) if next(count) == 4 else figure

        found = judge(make_study, function_backend, function, draws=5)
        assert (found.failures, found.lost) == (
            (1, 0) if state is EvaluationState.FAILED else (0, 1)
        )
        assert not found.feasible
        # The rest still counts.
        assert found.constraints["peak"].count == 4
        assert found.constraints["peak"].agrees

    def test_all_fail(self, make_study, function_backend, failed):
        found = judge(make_study, function_backend, lambda **_: failed("no"), draws=5)
        assert found.failures == found.draws == 5
        assert not found.feasible
        assert not found.constraints["peak"].agrees
        assert math.isnan(found.constraints["peak"].worst)

    def test_three_lost_in_a_row_end_it(self, make_study, function_backend, failed):
        """Nodes that never come back would keep it waiting for each of its evaluations."""
        states = iter(["lost", "lost", "complete", "lost", "lost", "failed", *["lost"] * 9])
        plain = figures()

        def function(**values):
            state = EvaluationState(next(states))
            return plain(**values) if state is EvaluationState.COMPLETE else failed("gone", state)

        study = make_study()
        backend = function_backend(study, function)
        with pytest.raises(RunError, match="3 test runs in a row were lost with their nodes: gone"):
            validate(study, Driver(backend), [{"gain": 0.5}, {"gain": 0.25}])
        assert len(backend.calls) == 9

    def test_those_on_record_do_not_end_a_run_that_is_resumed(
        self, make_study, function_backend, failed
    ):
        """They ended the session before; the nodes may be back."""
        study, watcher = make_study(), Watcher()
        lost = function_backend(study, lambda **_: failed("gone", EvaluationState.LOST))
        with pytest.raises(RunError):
            validate(study, Driver(lost, watcher), [{"gain": 0.5}])
        resumed = function_backend(study, figures())
        backend = RecordedEvaluations(resumed, study, watcher.evaluations)
        (found,) = validate(study, Driver(backend), [{"gain": 0.5}])
        assert found.lost == len(watcher.evaluations) == 3
        assert len(resumed.calls) == study.budget.validation_draws - 3
