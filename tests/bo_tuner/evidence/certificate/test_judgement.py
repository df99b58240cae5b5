"""The verdict of a certificate: what passes, how often it passes wrongly, and what it compares."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from certified import CHANCE, LIMIT, collect
from draws_needed import draws_needed_without_event
from scipy import stats

from bo_tuner.errors import RunError
from bo_tuner.evidence.certificate.findings import Evidence, Failure
from bo_tuner.evidence.certificate.judgement import judge, most_draws_needed
from bo_tuner.evidence.certificate.winners_curse import training_gaps
from bo_tuner.evidence.reasons import Assumption, Reason, Why
from bo_tuner.evidence.words.reasons import reason
from bo_tuner.methods.registry import METHODS
from bo_tuner.numerics.bounded_means import log_wealth
from bo_tuner.numerics.two_kinds import runs_to_see
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

MANY = runs_to_see(0.975) + 8
"""Runs in a context with which a mean without a range may be shown."""
DRAWS_NEEDED = draws_needed_without_event(0.04, 0.05)


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


def nowhere(peaks):
    """Evidence of a study without contexts."""
    found = [dataclasses.replace(evaluation(p, Stage.CHECK_WORST), context={}) for p in peaks]
    return Evidence({"gain": 0.5}, tuple(found), repeated=(tuple(found),))


def normal(count, mean, deviation):
    return stats.norm.ppf((np.arange(count) + 0.5) / count, mean, deviation)


def noisy(count, mean, deviation):
    """The same in random order."""
    return np.random.default_rng(1).permutation(normal(count, mean, deviation)).tolist()


class TestChance:
    @pytest.mark.parametrize(
        ("violations", "draws", "passed"),
        [
            (0, DRAWS_NEEDED - 1, False),
            (0, DRAWS_NEEDED, True),
            (1, DRAWS_NEEDED, False),
            (1, 400, True),
            (40, 400, False),
        ],
    )
    def test_the_bound_decides(self, make_study, violations, draws, passed):
        study = make_study(**CHANCE)
        found = judge(study, evidence([2.0] * violations + [0.5] * (draws - violations)), 0.95)
        (constraint,) = found.constraints
        assert found.passed is constraint.passed is passed
        assert (constraint.violation_bound <= 0.04) is passed
        assert (constraint.violations, constraint.draws) == (violations, draws)
        assert constraint.allowed == pytest.approx(0.04)

    def test_the_limit_itself_is_within(self, make_study):
        found = judge(make_study(**CHANCE), evidence([LIMIT] * 100), 0.95)
        assert found.constraints[0].violations == 0
        assert found.passed

    def test_too_few_draws_are_told(self, make_study):
        found = judge(make_study(**CHANCE), evidence([0.5] * 25), 0.95)
        assert not found.passed
        assert found.constraints[0].reason == Reason(Why.SHARE, needed=DRAWS_NEEDED)
        assert most_draws_needed(make_study(**CHANCE), 0.95) == (DRAWS_NEEDED, "peak")
        assert most_draws_needed(make_study(), 0.95) == (runs_to_see(0.975), "peak")
        # In every context as many runs are needed, and there are no more than draws.
        worst = {"peak": CHANCE["constraints"]["peak"] | {"kind": "worst_case"}}
        assert most_draws_needed(make_study(constraints=worst), 0.95) == (DRAWS_NEEDED, "peak")


class TestWorstCase:
    def test_draws_refute_only_what_they_show(self, make_study):
        """A single run above a limit on the mean is no violation of it; a mean above it is."""
        held = judge(make_study(), evidence([0.5] * 99 + [1.01], [noisy(MANY, 0.55, 0.05)]), 0.95)
        assert held.passed
        assert held.constraints[0].violations == 1
        found = judge(make_study(), evidence([1.2, 1.3] * 20, [noisy(20, 0.55, 0.05)]), 0.95)
        (peak,) = found.constraints
        assert (peak.violations, peak.reason) == (40, Reason(Why.DRAWS))

    def test_noise_in_the_worst_context_refutes_nothing(self, make_study):
        values = noisy(MANY, 0.9, 0.1)
        found = judge(make_study(), evidence([0.5] * 100, [values]), 0.95)
        (worst,) = found.constraints[0].worst
        assert worst.beyond > 0
        assert found.passed
        # Wider than the interval for a number of values that was fixed before.
        fixed = stats.ttest_1samp(values, 0, alternative="less").confidence_interval(0.95).high
        assert fixed < worst.mean.upper < LIMIT

    def test_a_mean_below_the_limit_must_be_shown(self, make_study):
        """The same mean, but so uncertain that it may be above."""
        values = noisy(MANY, 0.9, 0.6)
        found = judge(make_study(), evidence([0.5] * 100, [values]), 0.95)
        assert not found.passed
        assert found.constraints[0].reason == Reason(Why.MEAN_IN_CONTEXT)
        assert not found.constraints[0].refuted

    def test_every_candidate_counts(self, make_study):
        """One with a smaller mean, but a bound beyond the limit."""
        wide, narrow = noisy(MANY, 0.8, 0.7), noisy(2 * MANY, 0.9, 0.01)
        found = judge(make_study(), evidence([0.5] * 100, [narrow, wide]), 0.95)
        worst = found.constraints[0].worst
        assert [w.shown for w in worst] == [True, False]
        assert not found.passed
        # The first is the worst one, whose mean a screen has for the worst case.
        assert [w.mean.value for w in worst] == pytest.approx([0.9, 0.8])

    @pytest.mark.parametrize("lower", [False, True])
    def test_the_bound_that_decides_need_not_be_that_of_the_worst_mean(self, make_study, lower):
        """Both keep the limit; the one with the worse mean is known better."""
        sure, doubtful = noisy(2 * MANY, 0.605, 0.01), noisy(MANY, 0.57, 0.15)
        limit = {"upper": LIMIT}
        if lower:
            sure, doubtful = ([1.0 - value for value in values] for values in (sure, doubtful))
            limit = {"lower": 0.1}
        study = make_study(constraints={"peak": {"kind": "worst_case", "metric": "peak"} | limit})
        (found,) = judge(study, evidence([0.5] * 100, [sure, doubtful]), 0.95).constraints
        assert found.passed
        assert [w.evaluations for w in found.worst] == [2 * MANY, MANY]
        bounds = [w.mean.lower if lower else w.mean.upper for w in found.worst]
        widest = bounds[1]
        assert widest == (min if lower else max)(bounds)
        assert found.reason == Reason(Why.MEAN_IN_CONTEXT, place=1)

    def test_without_contexts_none_is_named(self, make_study):
        (found,) = judge(
            make_study(contexts={}), nowhere(noisy(MANY, 0.55, 0.05)), 0.95
        ).constraints
        assert found.passed
        assert reason(found).startswith("mean over noise at most 0.")

    def test_it_needs_a_look_at_the_worst_context(self, make_study):
        assert not judge(make_study(), evidence([0.5] * 100, []), 0.95).passed

    @pytest.mark.parametrize(("above", "passed"), [(0, True), (12, False)])
    def test_a_limit_on_single_runs_counts_them(self, make_study, above, passed):
        """The mean is within it by far in both cases."""
        limit = {"kind": "worst_case", "metric": "peak", "upper": LIMIT, "probability": 0.85}
        study = make_study(constraints={"peak": limit})
        found = judge(study, evidence([0.5] * 30, [[1.1] * above + [0.0] * (60 - above)]), 0.95)
        (worst,) = found.constraints[0].worst
        assert worst.mean.upper < LIMIT
        assert found.passed is passed is (worst.violation_bound <= 0.15)
        assert worst.beyond == above
        assert found.constraints[0].reason == Reason(Why.SHARE_IN_CONTEXT)

    def test_a_limit_on_single_runs_needs_none_for_a_bound_of_the_mean(self, make_study):
        """That bound decides nothing there, in whatever context has the fewest runs."""
        limit = {"kind": "worst_case", "metric": "peak", "upper": LIMIT, "probability": 0.5}
        study = make_study(constraints={"peak": limit})
        runs = [noisy(MANY, 0.55, 0.05), noisy(8, 0.55, 0.05)]
        (found,) = judge(study, evidence([0.5] * 30, runs), 0.95).constraints
        assert all(math.isfinite(context.mean.upper) for context in found.worst)
        (on_mean,) = judge(make_study(), evidence([0.5] * 29 + [1.1], runs), 0.95).constraints
        bounded = {w.evaluations: math.isfinite(w.mean.upper) for w in on_mean.worst}
        assert bounded == {MANY: True, 8: False}

    def test_few_runs_that_agree_do_not_show_a_mean(self, make_study):
        """A run in ten is 20, the others 0: a mean of 2 that five runs show as 0 in most cases.

        With the 20 that was drawn, bets on runs of 0 that the mean is below 1 win at most
        1 / (20 - 1) of the wealth with each.
        """
        draws = [0.0] * 29 + [20.0]
        found = judge(make_study(), evidence(draws, [[0.0] * 5]), 0.95)
        (peak,) = found.constraints
        assert peak.reason == Reason(Why.MEAN_IN_CONTEXT)
        assert not math.isfinite(peak.worst[0].mean.upper)
        fewest = next(
            n for n in range(1, 500) if log_wealth([0.0] * n, 1.0, 20.0)[-1] >= math.log(40.0)
        )
        assert fewest > math.log(40.0) / math.log(1.0 + 1.0 / 19.0)
        for count, passed in ((fewest - 1, False), (fewest, True)):
            found = judge(make_study(), evidence(draws, [[0.0] * count]), 0.95)
            assert found.passed is passed
        # What equal runs seemed to show is not shown once one differs.
        found = judge(make_study(), evidence(draws, [[*[0.0] * 40, 20.0]]), 0.95)
        assert not found.passed

    @pytest.mark.slow
    @pytest.mark.parametrize("probability", [None, 0.85])
    @pytest.mark.parametrize("margin", [0.0, 0.1])
    def test_how_often_it_passes(self, make_study, function_backend, probability, margin):
        """Rarely at the limit; a standard deviation within it nearly always."""
        limit = {"kind": "worst_case", "metric": "peak", "upper": LIMIT}
        if probability:
            limit["probability"] = probability
        study = make_study(constraints={"peak": limit}, contexts={})
        deviation = 0.1
        mean = LIMIT - margin - deviation * stats.norm.ppf(probability or 0.5)
        rng = np.random.default_rng(8)
        backend = function_backend(
            study, lambda **_: {"error": 1.0, "peak": rng.normal(mean, deviation)}
        )
        runs = 20
        found = [collect(study, backend, 100, tuned=0.5)[0] for _ in range(runs)]
        passed = sum(judge(study, item, 0.95).passed for item in found)
        assert passed <= 4 if margin == 0.0 else passed >= 18


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
                (
                    (
                        *[evaluation(0.5), evaluation(0.51)] * 5,
                        *(failed if where == "repeated" else ()),
                    ),
                ),
            ),
            0.95,
        )
        assert not found.passed
        assert found.failures == 1
        assert found.first_failure == Failure("axis: stalled", {"load": 1.5}, 7)

    def test_it_counts_as_a_violation(self, make_study):
        found = judge(make_study(**CHANCE), evidence([0.5] * 293 + [None] * 7), 0.95)
        (constraint,) = found.constraints
        assert (constraint.violations, constraint.failures) == (0, 7)
        violating = judge(make_study(**CHANCE), evidence([0.5] * 293 + [2.0] * 7), 0.95)
        assert constraint.violation_bound == violating.constraints[0].violation_bound
        assert not found.passed

    def test_all_fail(self, make_study):
        found = judge(make_study(), evidence([None] * 5, [[None, None]]), 0.95)
        assert not found.passed
        assert math.isnan(found.objective.value)
        assert math.isnan(found.constraints[0].extreme)

    def test_three_lost_in_a_row_end_it(self, make_study, function_backend, failed):
        study = make_study()
        states = itertools.chain(["lost", "lost", "complete", "lost"], itertools.repeat("lost"))

        def function(**_):
            if next(states) == "lost":
                return failed("gone", EvaluationState.LOST)
            return {"error": 1.0, "peak": 0.5}

        backend = function_backend(study, function)
        with pytest.raises(RunError, match="3 test runs in a row were lost with their nodes: gone"):
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
        found = judge(study, evidence([0.5] * 300, [[0.7, 0.7] * 10]), 0.95)
        ranked = METHODS["IV"].ranking.rank(study, trials)
        predicted = next(c.objective for c in ranked if c.trial is winner)
        objective, worst = training_gaps(study, winner, predicted, found)
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
        # Of a mean in the worst context nothing is observed.
        assert math.isnan(worst.observed)
        assert (worst.predicted, worst.validated) == (0.6, pytest.approx(0.7))
        assert worst.value == pytest.approx(0.1)


LIMITS = {
    "peak": {"kind": "worst_case", "metric": "peak", "upper": LIMIT},
    "error": {"kind": "worst_case", "metric": "error", "upper": LIMIT},
}


class TestUnvisitedContexts:
    """One limit is refuted in the first context, so that the others are not run any more."""

    def test_no_limit_is_shown_without_a_run_in_each_context(self, make_study):
        study = make_study(constraints=LIMITS)
        runs = [
            evaluation(2.0 + 0.01 * (k % 5), Stage.CHECK_WORST, error=0.1 + 0.01 * (k % 5))
            for k in range(MANY)
        ]
        drawn = (evaluation(0.5, error=0.1),)
        found = Evidence(
            {"gain": 0.5},
            drawn,
            repeated=(tuple(runs),),
            unvisited={"error": 3},
            unseen=frozenset(["error"]),
        )
        by_name = {c.name: c for c in judge(study, found, 0.95).constraints}
        assert not by_name["peak"].passed
        assert by_name["peak"].reason.why in (Why.REFUTED_IN_CONTEXT, Why.MEAN_IN_CONTEXT)
        assert not by_name["error"].passed
        assert by_name["error"].reason == Reason(Why.NOT_RUN, not_run=3)
        # The context that was run is the worst one of the other limit.
        assert by_name["error"].worst == ()
        assert by_name["peak"].worst[0].evaluations == MANY
        visited = dataclasses.replace(found, unvisited={}, unseen=frozenset())
        by_name = {c.name: c for c in judge(study, visited, 0.95).constraints}
        assert by_name["error"].passed
        assert by_name["error"].worst[0].evaluations == MANY

    def test_a_limit_that_its_own_contexts_decide_says_why(self, make_study):
        """One violation of few runs is hopeless, but no proof: the next contexts are not run."""
        study = make_study(constraints={"peak": LIMITS["peak"] | {"probability": 0.96}})
        runs = [evaluation(peak, Stage.CHECK_WORST) for peak in [0.5] * 9 + [2.0]]
        found = Evidence({"gain": 0.5}, (evaluation(0.5),), (), (tuple(runs),), {"peak": 2})
        (peak,) = judge(study, found, 0.95).constraints
        assert not peak.passed
        assert (peak.worst[0].beyond, peak.worst[0].evaluations) == (1, 10)
        assert peak.reason == Reason(Why.SHARE_IN_CONTEXT)

    def test_they_are_counted(self, make_study, function_backend):
        """The peak is beyond its limit for large loads, the error for small ones alone."""

        def axis(gain, load, seed):
            noise = np.random.default_rng(seed).normal(0.0, 0.3)
            return {"error": 0.6 + (load < 1.02), "peak": 0.35 * load + noise}

        study = make_study(constraints=LIMITS)
        (found,) = collect(study, function_backend(study, axis), 400, tuned=0.5)
        assert found.repeated
        assert not judge(study, found, 0.95).passed
        assert found.unvisited
        by_name = {c.name: c for c in judge(study, found, 0.95).constraints}
        for name, count in found.unvisited.items():
            assert count > 0
            assert not by_name[name].passed
            refuted = by_name[name].reason.why is Why.REFUTED_IN_CONTEXT
            seen = name not in found.unseen or refuted
            assert bool(by_name[name].worst) is seen


class TestRange:
    """A limit on a mean, of a metric whose range is declared."""

    def study(self, make_study, high):
        study = make_study()
        metrics = dict(study.metrics)
        metrics["peak"] = dataclasses.replace(metrics["peak"], range=(0.0, high))
        return dataclasses.replace(study, metrics=metrics)

    def test_bets_decide(self, make_study):
        """Some 80 runs at 0.5 exclude rare ones at 3, not at 300, whatever the noise is."""
        runs = evidence([0.5] * 40, [noisy(MANY, 0.5, 0.1)])
        for high, passed in ((3.0, True), (300.0, False)):
            found = judge(self.study(make_study, high), runs, 0.95)
            assert found.passed is passed
            (worst,) = found.constraints[0].worst
            assert (worst.mean.upper <= LIMIT) is passed
            assert found.constraints[0].assumption is None
        told = judge(make_study(), runs, 0.95)
        assert told.passed
        assert told.constraints[0].assumption == Assumption("peak")

    def test_a_lower_limit_is_the_mirror_image(self, make_study):
        limit = {"kind": "worst_case", "metric": "peak", "lower": -LIMIT}
        study = make_study(constraints={"peak": limit})
        metrics = dict(study.metrics)
        metrics["peak"] = dataclasses.replace(metrics["peak"], range=(-3.0, 0.0))
        study = dataclasses.replace(study, metrics=metrics)
        mirrored = judge(study, evidence([-0.5] * 40, [[-0.4, -0.6] * 15]), 0.95)
        upper = judge(self.study(make_study, 3.0), evidence([0.5] * 40, [[0.4, 0.6] * 15]), 0.95)
        assert mirrored.passed
        bounds = [f.constraints[0].worst[0].mean for f in (mirrored, upper)]
        assert bounds[0].lower == pytest.approx(-bounds[1].upper)

    def test_skewed_runs_show_less_than_symmetric_ones(self, make_study):
        """Both with a mean of 0.92 and a deviation of 0.2, and some runs beyond the limit."""
        rng = np.random.default_rng(3)
        quantiles = (np.arange(120) + 0.5) / 120
        skewed = stats.lognorm.ppf(quantiles, 1.2)
        both = []
        for values in (stats.norm.ppf(quantiles), skewed):
            scaled = 0.92 + 0.2 * (values - values.mean()) / values.std()
            runs = rng.permutation(scaled).tolist()
            both.append(judge(make_study(), evidence([0.5] * 40, [runs]), 0.95))
        assert [found.passed for found in both] == [True, False]
