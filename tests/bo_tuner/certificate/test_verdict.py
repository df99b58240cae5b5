"""The certificate: what passes, how often it passes wrongly, and what it compares."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from bo_tuner.certificate.certification import REPEATS, Certification, Subject
from bo_tuner.certificate.evidence import Evidence
from bo_tuner.certificate.verdict import judge, most_draws_needed
from bo_tuner.certificate.winners_curse import training_gaps
from bo_tuner.errors import RunError
from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.optimizers.ranking import rank
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.validation import validate

LIMIT = 1.0
CHANCE = {
    "constraints": {
        "peak": {"kind": "chance", "metric": "peak", "upper": LIMIT, "probability": 0.96}
    }
}
PLANE = {
    "contexts": {
        name: {"node": "axis", "distribution": "uniform", "bounds": [0.0, 1.0]}
        for name in ("load", "wear")
    }
}


def evaluation(peak, stage=Stage.VALIDATION, error=1.0, load=1.5):
    """An evaluation with this peak; a failed one without."""
    outcome = Outcome(EvaluationState.FAILED, reason="axis: stalled")
    if peak is not None:
        outcome = Outcome(EvaluationState.COMPLETE, {"error": error, "peak": peak})
    return Evaluation(0, 0, stage, {"gain": 0.5}, {"load": load}, 7, outcome)


def evidence(peaks, repeated=((0.5, 0.6),)):
    return Evidence(
        {"gain": 0.5},
        tuple(evaluation(peak) for peak in peaks),
        repeated=tuple(
            tuple(evaluation(p, Stage.CHECK_WORST) for p in peaks) for peaks in repeated
        ),
    )


def collect(study, backend, draws, **subjects):
    items = [Subject(name, {"gain": gain}) for name, gain in subjects.items()]
    return Certification(study, backend).collect(items, draws)


class TestChance:
    @pytest.mark.parametrize(
        ("violations", "draws", "passed"),
        # From binomial tails: P(X <= 6) = 0.044 and P(X <= 7) = 0.087 for 300 draws at 0.04.
        [(0, 73, False), (0, 74, True), (6, 300, True), (7, 300, False), (0, 300, True)],
    )
    def test_the_bound_decides(self, make_study, violations, draws, passed):
        study = make_study(**CHANCE)
        found = judge(study, evidence([2.0] * violations + [0.5] * (draws - violations)), 0.95)
        (constraint,) = found.constraints
        assert bool(stats.binom.cdf(violations, draws, 0.04) <= 0.05) is passed
        assert found.passed is constraint.passed is passed
        assert (constraint.violations, constraint.draws) == (violations, draws)
        assert constraint.allowed == pytest.approx(0.04)
        assert bool(found.reasons) is not passed

    def test_the_limit_itself_is_within(self, make_study):
        found = judge(make_study(**CHANCE), evidence([LIMIT] * 100), 0.95)
        assert found.constraints[0].violations == 0
        assert found.passed

    def test_too_few_draws_are_told(self, make_study):
        found = judge(make_study(**CHANCE), evidence([0.5] * 25), 0.95)
        assert not found.passed
        assert "74 draws without any are needed" in found.reasons[0]
        assert most_draws_needed(make_study(**CHANCE), 0.95) == (74, "peak")
        assert most_draws_needed(make_study(), 0.95) == (1, "")

    @pytest.mark.parametrize("probability", [0.04, 0.005])
    def test_how_often_it_passes(self, make_study, probability):
        """At the limit in at most one of twenty, well within it nearly always."""
        study = make_study(**CHANCE)
        rng = np.random.default_rng(20)
        fine, bad = evaluation(0.5), evaluation(2.0)
        runs = 400
        passed = 0
        for _ in range(runs):
            draws = [bad if violates else fine for violates in rng.random(300) < probability]
            passed += judge(study, Evidence({}, tuple(draws)), 0.95).passed
        expected = stats.binom.cdf(6, 300, probability)
        assert expected <= 0.05 or probability < 0.01
        assert abs(passed / runs - expected) <= 4.0 * math.sqrt(expected * (1 - expected) / runs)


class TestWorstCase:
    def test_one_draw_is_enough(self, make_study):
        found = judge(make_study(), evidence([0.5] * 99 + [1.01]), 0.95)
        assert not found.passed
        assert found.reasons == ("peak: 1 of 100 draws violate the limit or fail (none may)",)

    def test_noise_in_the_worst_context_refutes_nothing(self, make_study):
        values = [0.9 + 0.15 * x for x in stats.norm.ppf((np.arange(20) + 0.5) / 20)]
        found = judge(make_study(), evidence([0.5] * 100, [values]), 0.95)
        (worst,) = found.constraints[0].worst
        assert worst.above > 0
        assert found.passed
        upper = stats.ttest_1samp(values, 0, alternative="less").confidence_interval(0.95).high
        assert worst.mean.upper == pytest.approx(upper)

    def test_a_mean_below_the_limit_must_be_shown(self, make_study):
        """The same mean, but so uncertain that it may be above."""
        values = [0.9 + 0.5 * x for x in stats.norm.ppf((np.arange(20) + 0.5) / 20)]
        found = judge(make_study(), evidence([0.5] * 100, [values]), 0.95)
        assert not found.passed
        assert "may be" in found.reasons[0]

    def test_every_candidate_counts(self, make_study):
        """One with a smaller mean, but a bound beyond the limit."""
        found = judge(make_study(), evidence([0.5] * 100, [[0.9, 0.9], [0.4, 1.2]]), 0.95)
        assert found.constraints[0].worst[0].mean.value == pytest.approx(0.9)
        assert not found.passed

    def test_it_needs_a_look_at_the_worst_context(self, make_study):
        assert not judge(make_study(), evidence([0.5] * 100, []), 0.95).passed

    @pytest.mark.parametrize("mean", [1.0, 0.9])
    def test_how_often_it_passes(self, make_study, mean):
        """With the worst mean at the limit in at most one of twenty, however many candidates."""
        study = make_study()
        rng = np.random.default_rng(8)
        draws = [evaluation(0.5)] * 10
        runs, passed = 400, 0
        for _ in range(runs):
            repeated = tuple(
                tuple(evaluation(value) for value in rng.normal(at, 0.1, 20))
                for at in (mean, 0.7, mean)
            )
            passed += judge(study, Evidence({}, tuple(draws), (), repeated), 0.95).passed
        if mean == 1.0:
            assert passed / runs <= 0.05 + 4.0 * math.sqrt(0.05 * 0.95 / runs)
        else:
            # One standard deviation of distance, what the tuner aims at, passes nearly always.
            assert passed / runs > 0.95


class TestFailures:
    @pytest.mark.parametrize("where", ["draw", "search", "repeated"])
    def test_one_failed_evaluation_fails(self, make_study, where):
        whole = [evaluation(0.5)] * 100
        failed = (evaluation(None),)
        found = judge(
            make_study(),
            Evidence(
                {},
                (*whole, *(failed if where == "draw" else ())),
                failed if where == "search" else (),
                ((evaluation(0.5), evaluation(0.5), *(failed if where == "repeated" else ())),),
            ),
            0.95,
        )
        assert not found.passed
        assert found.failures == 1
        assert "first: axis: stalled (context load 1.5; seed 7)" in found.reasons[0]

    def test_it_counts_as_a_violation(self, make_study):
        found = judge(make_study(**CHANCE), evidence([0.5] * 293 + [None] * 7), 0.95)
        (constraint,) = found.constraints
        assert (constraint.violations, constraint.failures) == (0, 7)
        expected = stats.binomtest(7, 300, alternative="less").proportion_ci(0.95, "exact").high
        assert constraint.violation_bound == pytest.approx(expected)
        assert not constraint.passed

    def test_all_fail(self, make_study):
        found = judge(make_study(), evidence([None] * 5, [[None, None]]), 0.95)
        assert not found.passed
        assert math.isnan(found.objective.value)
        assert math.isnan(found.constraints[0].largest)

    def test_three_lost_in_a_row_end_it(self, make_study, function_backend, failed):
        study = make_study()
        states = itertools.chain(["lost", "lost", "complete", "lost"], itertools.repeat("lost"))

        def function(**_):
            if next(states) == "lost":
                return failed("gone", EvaluationState.LOST)
            return {"error": 1.0, "peak": 0.5}

        backend = function_backend(study, function)
        with pytest.raises(
            RunError, match="3 evaluations in a row were lost with their nodes: gone"
        ):
            collect(study, backend, 50, default=0.5, tuned=0.2)
        assert len(backend.calls) == 6


class TestObjective:
    @pytest.mark.parametrize("direction", ["minimize", "maximize"])
    def test_the_tail_is_on_the_bad_side(self, make_study, direction):
        study = make_study(objective={"metric": "error", "direction": direction})
        drawn = tuple(evaluation(0.5, error=float(value)) for value in range(1, 101))
        found = judge(study, Evidence({}, drawn, (), ((evaluation(0.5), evaluation(0.5)),)), 0.95)
        assert found.objective.value == pytest.approx(50.5)
        assert found.tail == pytest.approx(98.0 if direction == "minimize" else 3.0)

    def test_nothing_to_keep(self, make_study):
        assert judge(make_study(constraints={}), evidence([9.0] * 5), 0.95).passed


class TestEvaluations:
    def test_the_same_draws_for_both_and_fresh_ones(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        default, tuned = collect(study, backend, 40, default=0.25, tuned=0.75)
        seen = [[(c.context["load"], c.seed) for c in item.drawn] for item in (default, tuned)]
        assert seen[0] == seen[1]
        assert len(set(seen[0])) == 40
        before = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        list(Tuning(study, before, ALGORITHMS["IV"]))
        validate(study, before, [{"gain": 0.25}])
        for key in ("load", "seed"):
            drawn = {c.context[key] if key == "load" else c.seed for c in tuned.drawn}
            assert not drawn & {call[key] for call in before.calls}
        seeds = [c.seed for c in tuned.evaluations]
        assert len(set(seeds)) == len(seeds)

    def test_they_follow_the_distribution(self, make_study, function_backend):
        study = make_study(constraints={})
        backend = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        (found,) = collect(study, backend, 400, tuned=0.5)
        loads = [c.context["load"] for c in found.drawn]
        assert stats.kstest(loads, stats.uniform(1.0, 1.0).cdf).pvalue > 1e-3
        assert found.search == found.repeated == ()

    @pytest.mark.parametrize("height", [0.9, 1.2])
    def test_a_peak_that_draws_do_not_meet(self, make_study, function_backend, height):
        """A corner with 0.1 % of the draws: 40 draws keep the limit, the search tells."""
        study = make_study(**PLANE)

        def function(load, wear, **_):
            distance = math.hypot(load - 1.0, wear)
            return {"error": 1.0, "peak": height * math.exp(-0.5 * (distance / 0.12) ** 2)}

        (found,) = collect(study, function_backend(study, function), 40, tuned=0.5)
        verdict = judge(study, found, 0.95)
        (constraint,) = verdict.constraints
        assert constraint.violations == 0
        worst = constraint.worst[0]
        assert worst.context == {"load": pytest.approx(1.0), "wear": pytest.approx(0.0, abs=1e-9)}
        assert worst.mean.value == pytest.approx(height, rel=1e-3)
        assert worst.evaluations == REPEATS
        assert verdict.passed is (height < LIMIT)

    def test_nothing_varies(self, make_study, function_backend):
        study = make_study(contexts={})
        backend = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        (found,) = collect(study, backend, 10, tuned=0.5)
        assert judge(study, found, 0.95).passed
        assert [len(evaluations) for evaluations in found.repeated] == [REPEATS]


class TestWinnersCurse:
    def test_gaps(self, make_study, make_trial):
        """Of trials with the same mean the luckiest wins; its gap is the luck it had."""
        study = make_study()
        rng = np.random.default_rng(4)
        trials = [
            make_trial(k, {"gain": float(g)}, rng.normal(1.0, 0.2, 5).tolist(), worst=0.6)
            for k, g in enumerate(np.linspace(0.0, 1.0, 30))
        ]
        winner = min(trials, key=lambda t: np.mean(t.observations("error")))
        found = judge(study, evidence([0.5] * 300, [[0.7] * 20]), 0.95)
        objective, worst = training_gaps(study, winner, rank(study, trials), found)
        shown = np.mean(winner.observations("error"))
        assert objective.observed == pytest.approx(shown)
        assert objective.validated == 1.0
        assert objective.value == pytest.approx(1.0 - shown)
        # The luckiest of 30 means with a deviation of 0.2 / sqrt(5): expected 2.04 of them.
        assert 0.1 < objective.value < 0.3
        expected = np.std(winner.observations("error"), ddof=1) / math.sqrt(5)
        assert objective.standard_error == pytest.approx(expected)
        # The surrogate has seen the others and is less impressed.
        assert shown < objective.predicted < 1.1
        assert (worst.observed, worst.validated) == (0.6, pytest.approx(0.7))
        assert worst.value == pytest.approx(0.1)
