"""Limits that are kept by far: by what a few runs, or all runs together, may show them."""

import dataclasses

import numpy as np
import pytest
from certified import CHANCE, collect
from scipy import stats

from bo_tuner.evidence.certificate.economy import (
    BEHIND,
    CLEAR,
    FEW,
    LEAST_DRAWS,
    confirms,
    is_far_from,
    is_shown_by_all,
)
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.numerics.sequential import draws_needed
from bo_tuner.study.constraint import Constraint

UPPER = Constraint(name="peak", kind="chance", metric="peak", upper=1.0, probability=0.96)
LOWER = Constraint(name="peak", kind="chance", metric="peak", lower=-1.0, probability=0.96)
SINGLE_RUN = {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.85}


def spread(count, mean, deviation):
    """Values with exactly this mean and standard deviation."""
    values = stats.norm.ppf((np.arange(count) + 0.5) / count)
    return mean + deviation * values / values.std(ddof=1)


class TestConfirms:
    def test_the_margin_decides(self):
        deviation = 0.1
        near, far = (1.0 - k * CLEAR * deviation for k in (0.99, 1.01))
        assert not confirms(UPPER, spread(FEW, near, deviation))
        assert confirms(UPPER, spread(FEW, far, deviation))
        assert confirms(LOWER, -spread(FEW, far, deviation))

    def test_fewer_runs_or_one_beyond_confirm_nothing(self):
        assert not confirms(UPPER, np.full(FEW - 1, 0.1))
        assert not confirms(UPPER, np.array([0.1] * FEW + [1.1]))
        assert confirms(UPPER, np.full(FEW, 0.1))


class TestFar:
    def test_cantelli_at_twice_the_deviation(self):
        """4 % are beyond at most where the limit is sqrt(24) deviations away."""
        for factor, far in ((0.99, False), (1.01, True)):
            margin = 2.0 * np.sqrt(24.0) * 0.01 * factor
            draws = spread(LEAST_DRAWS, 1.0 - margin, 0.01)
            assert is_far_from(UPPER, draws, np.array([])) is far
            assert is_far_from(LOWER, -draws, np.array([])) is far

    def test_few_draws_or_any_run_beyond(self):
        assert not is_far_from(UPPER, np.full(LEAST_DRAWS - 1, 0.1), np.array([]))
        assert not is_far_from(UPPER, np.full(LEAST_DRAWS, 0.1), np.array([1.1]))

    def test_all_runs_together_are_as_many_as_draws_alone(self):
        draws, needed = np.full(LEAST_DRAWS, 0.1), draws_needed(0.04, 0.95)
        for count, shown in ((needed - 1, False), (needed, True)):
            others = np.full(count - LEAST_DRAWS, 0.2)
            assert is_shown_by_all(UPPER, draws, others, 0.95) is shown


class TestCertificate:
    def both(self, make_study, **certificate):
        limits = {"time": CHANCE["constraints"]["peak"] | {"metric": "error"}, "peak": SINGLE_RUN}
        return make_study(constraints=limits, certificate=certificate)

    def certified(self, study, function_backend, top, noise=0.02, base=0.0):
        """The peak increases with the load; the error is a tenth of its limit."""

        def function(load, seed, **_):
            rng = np.random.default_rng(seed)
            peak = base + (top - base) * (load - 1.0) + noise * rng.standard_normal()
            return {"error": 0.1 + 0.001 * rng.standard_normal(), "peak": peak}

        (found,) = collect(study, function_backend(study, function), 300, tuned=0.5)
        return found, judge(study, found, 0.95)

    def test_a_limit_kept_by_far_takes_few_runs(self, make_study, function_backend):
        found, verdict = self.certified(self.both(make_study), function_backend, 0.5)
        assert verdict.passed
        assert verdict.least == draws_needed(0.04, 0.95) + draws_needed(0.15, 0.95)
        assert verdict.evaluations <= 1.5 * verdict.least
        time, peak = verdict.constraints
        times = round(verdict.evaluations / verdict.least, 1)
        assert verdict.price == (
            f"{verdict.evaluations} runs, {times:g} times the fewest that can show these limits "
            f"({verdict.least})"
        )
        assert verdict.assumptions[0] == f"time: with an assumption: {time.assumptions[0]}"
        assert len(found.drawn) < draws_needed(0.04, 0.95)
        assert time.violation_bound <= time.allowed
        assert "count with the" in time.assumptions[0]
        # Alone the worst context has as many runs as the limit needs.
        assert [w.evaluations for w in peak.worst] == [draws_needed(0.15, 0.95)]
        assert {w.evaluations for w in peak.modelled} == {FEW}
        assert "a model over the contexts" in peak.assumptions[0]

    def test_free_of_assumptions_nothing_is_saved(self, make_study, function_backend):
        study = self.both(make_study, distribution_free=True)
        found, verdict = self.certified(study, function_backend, 0.5)
        assert verdict.passed
        assert len(found.drawn) == draws_needed(0.04, 0.95)
        for constraint in verdict.constraints:
            assert constraint.assumptions == constraint.modelled == ()
        needed = draws_needed(0.15, 0.95)
        assert {w.evaluations for w in verdict.constraints[1].worst} == {needed}

    @pytest.mark.parametrize("top", [1.02, 1.3])
    def test_what_is_broken_fails(self, make_study, function_backend, top):
        _, verdict = self.certified(self.both(make_study), function_backend, top)
        assert not verdict.passed

    def test_contexts_behind_the_worst_one_take_fewer_runs(self, make_study, function_backend):
        """None of them is clear."""
        found, verdict = self.certified(self.both(make_study), function_backend, 0.94, 0.04, 0.91)
        assert verdict.passed
        behind = found.ranking["peak"].behind
        assert behind
        peak, fewest = verdict.constraints[1], draws_needed(0.15, BEHIND)
        assert [w.evaluations for w in peak.worst if w.context not in behind]
        for context in peak.modelled:
            if context.context in behind:
                assert context.evaluations >= fewest
        assert "with a confidence of 80 %" in peak.assumptions[-1]

    def test_a_run_outside_the_declared_range_is_a_fail(self, make_study, function_backend):
        study = make_study()
        metrics = dict(study.metrics)
        metrics["peak"] = dataclasses.replace(metrics["peak"], range=(0.0, 1.5))
        study = dataclasses.replace(study, metrics=metrics)
        runs = iter(range(1000))

        def function(**_):
            return {"error": 1.0, "peak": -0.1 if next(runs) == 3 else 0.5}

        (found,) = collect(study, function_backend(study, function), 100, tuned=0.5)
        verdict = judge(study, found, 0.95)
        assert not verdict.passed
        assert verdict.reasons[0].startswith("peak was -0.1, outside its range [0, 1.5]")
        assert len(found.evaluations) == 4
