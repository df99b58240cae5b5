"""What was known before counts against a PASS, never for it, and is looked at again."""

import dataclasses
import math

import numpy as np
import pytest
from certified import CHANCE, LIMIT
from judged_runs import certify

from bo_tuner.evidence.certificate.certification import Certification, most_evaluations
from bo_tuner.evidence.certificate.decisions import decide_draws
from bo_tuner.evidence.certificate.earlier import earlier_evidence
from bo_tuner.evidence.certificate.findings import (
    NOTHING,
    Earlier,
    Evidence,
    Refutation,
    RefutingRuns,
)
from bo_tuner.evidence.certificate.independent_search import CARRIED, most_candidates, worst_of_all
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.reasons import Reason, Why
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Uniform
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage
from bo_tuner.tuning.driver import Driver

SINGLE = {
    "constraints": {
        "peak": {"kind": "worst_case", "metric": "peak", "upper": LIMIT, "probability": 0.9}
    }
}
PLANE = {
    "contexts": {
        name: {"node": "axis", "distribution": "uniform", "bounds": [0.0, 1.0]}
        for name in ("load", "wear")
    }
}
PARAMETERS = {"gain": 0.5}
SPIKE = {"load": 0.377, "wear": 0.613}


def runs(peaks, stage, load=1.5):
    outcomes = [Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": p}) for p in peaks]
    return tuple(
        Evaluation(0, k, stage, PARAMETERS, {"load": load}, k, outcome)
        for k, outcome in enumerate(outcomes)
    )


def judged(study, drawn, repeated=(), before=()):
    """Judge draws and runs in one context, after earlier ones."""
    here = (runs(repeated, Stage.CHECK_WORST),) if len(repeated) else ()
    found = Evidence(
        PARAMETERS,
        runs(drawn, Stage.VALIDATION),
        repeated=here,
        earlier=Earlier(evaluations=tuple(before), certified=True),
    )
    return judge(study, found, 0.95)


MANY = 120
"""Runs in a context at most."""


class TestDraws:
    """At most 4 % of the draws may violate the limit."""

    @pytest.mark.parametrize(("fresh", "passed"), [(200, False), (479, False), (480, True)])
    def test_all_draws_together_must_not_contradict(self, make_study, fresh, passed):
        """20 of 20 violated it: they are 4 % of 500."""
        before = runs([2.0] * 20, Stage.VALIDATION)
        found = judged(make_study(**CHANCE), [0.5] * fresh, before=before)
        assert found.passed is passed
        if not passed:
            reason = found.constraints[0].reason
            assert (reason.why, reason.earlier) == (Why.EARLIER, 20)
            assert reason.together == pytest.approx(20 / (20 + fresh))

    def test_earlier_ones_show_nothing(self, make_study):
        before = runs([0.5] * 1000, Stage.VALIDATION)
        assert not judged(make_study(**CHANCE), [0.5] * 50, before=before).passed

    def test_they_go_on_until_they_do_not_contradict(self, make_study):
        study = make_study(**CHANCE)
        earlier = Earlier(evaluations=runs([2.0] * 20, Stage.VALIDATION))
        drawn = runs([0.5] * 480, Stage.VALIDATION)
        assert decide_draws(study, drawn[:479], 900, 0.95) is True
        assert decide_draws(study, drawn[:479], 900, 0.95, earlier) is None
        assert decide_draws(study, drawn, 900, 0.95, earlier) is True
        assert decide_draws(study, drawn[:400], 400, 0.95, earlier) is False


class TestRunsInAContext:
    @pytest.mark.parametrize(("fresh", "passed"), [(120, False), (161, True)])
    def test_of_a_mean(self, make_study, fresh, passed):
        """32 runs with a mean of 1.5, and n with 0.9: together 1 for n = 160."""
        values = np.linspace(0.88, 0.92, fresh)
        before = runs([1.4, 1.6] * 16, Stage.CHECK_WORST)
        found = judged(make_study(), [0.5] * 30, values, before)
        assert judged(make_study(), [0.5] * 30, values).passed
        assert found.passed is passed
        (worst,) = found.constraints[0].worst
        assert worst.earlier == 32
        assert worst.together == pytest.approx((48.0 + values.sum()) / (32 + fresh))
        if not passed:
            assert found.constraints[0].reason == Reason(Why.EARLIER_IN_CONTEXT)

    @pytest.mark.parametrize(("fresh", "passed"), [(95, False), (100, True)])
    def test_of_single_runs(self, make_study, fresh, passed):
        """All 11 violated it, 10 % of 110; those of other contexts do not count here."""
        before = (
            *runs([2.0] * 11, Stage.CHECK_WORST),
            *runs([2.0] * 50, Stage.CHECK_WORST, load=1.1),
        )
        assert judged(make_study(**SINGLE), [0.5] * 30, [0.5] * fresh, before).passed is passed
        assert judged(make_study(**SINGLE), [0.5] * 30, [0.5] * fresh).passed

    @pytest.mark.slow
    def test_never_for_a_pass(self, make_study):
        """Whatever was before, a PASS is one without it, too."""
        rng = np.random.default_rng(4)
        passed = 0
        for study in (make_study(), make_study(**SINGLE), make_study(**CHANCE)):
            for _ in range(40):
                fresh = rng.normal(rng.uniform(0.5, 1.1), 0.1, 120)
                old = rng.normal(rng.uniform(0.2, 1.2), 0.1, 60)
                before = (*runs(old, Stage.CHECK_WORST), *runs(old, Stage.VALIDATION))
                if judged(study, fresh, fresh, before).passed:
                    passed += 1
                    assert judged(study, fresh, fresh).passed
        assert passed > 10


class TestWhatIsLookedAtAgain:
    """A spike that no search finds: 0.01 wide in a plane."""

    def collect(self, make_study, function_backend, earlier):
        study = make_study(**PLANE)
        rng = np.random.default_rng(2)

        def function(load, wear, **_):
            distance = math.hypot(load - SPIKE["load"], wear - SPIKE["wear"])
            spike = 0.8 * math.exp(-0.5 * (distance / 0.01) ** 2)
            return {"error": 1.0, "peak": 0.4 + spike + 0.02 * rng.normal()}

        subject = Subject("tuned", PARAMETERS, earlier=earlier)
        backend = function_backend(study, function)
        (found,) = Certification(study, Driver(backend), confidence=0.95).collect([subject], MANY)
        return found, judge(study, found, 0.95), most_evaluations(study, [subject], MANY)

    def test_where_it_failed(self, make_study, function_backend):
        found, verdict, _ = self.collect(make_study, function_backend, NOTHING)
        assert verdict.passed
        refuted = Refutation((SPIKE,), "0001")
        earlier = Earlier((refuted,), certified=True)
        found, verdict, most = self.collect(make_study, function_backend, earlier)
        assert not verdict.passed
        assert found.repeated[0][0].context == SPIKE
        assert len(found.repeated) == 1
        assert verdict.constraints[0].worst[0].mean.value == pytest.approx(1.2, abs=0.05)
        places = most_candidates(make_study(**PLANE).context_space()) + CARRIED
        assert most.repeated == (1 + places) * MANY

    def test_the_worst_by_all_runs(self, make_study, function_backend):
        """A single earlier run there, of which nobody took note."""
        outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": 1.2})
        seen = Evaluation(0, 0, Stage.SEARCH, PARAMETERS, SPIKE, 1, outcome)
        earlier = Earlier(evaluations=(seen,), certified=True)
        found, verdict, _ = self.collect(make_study, function_backend, earlier)
        assert SPIKE in [here[0].context for here in found.repeated]
        assert not verdict.passed


def test_the_worst_of_all_are_few_and_apart():
    """Eleven steps between the bounds: neighbours count as one."""
    space = ContextSpace({"load": Uniform(bounds=(0.0, 11.0))})
    contexts = [{"load": float(k)} for k in range(12) for _ in range(5)]
    values = [context["load"] for context in contexts]
    found = worst_of_all(space, contexts, values, [{"load": 11.0}], np.random.default_rng(1))
    assert found == [{"load": 9.0}, {"load": 7.0}, {"load": 5.0}]
    assert len(found) == CARRIED


class TestOfARun:
    def test_its_certificates_and_its_own_runs(self, run):
        """One that failed in the context of its draws, and one of another parameter set."""
        certify(run, [(1.0, 0.5)] * 120, [(1.0, 1.5 + 0.01 * k) for k in range(120)], repeated=120)
        trial = run.trials[run.summary["trial"]]
        found = earlier_evidence(run, trial.parameters, "inprocess")
        (refuted,) = found.refutations
        assert refuted.certificate == "0001"
        assert refuted.contexts == ({"load": 1.5},)
        assert not refuted.findings.constraints[0].passed
        assert found.certified
        own = [e for e in run.evaluations if e.parameters == trial.parameters]
        assert len(found.evaluations) == len(own) + 240
        assert sum(e.outcome.metrics["peak"] >= 1.5 for e in found.at({"load": 1.5})) == 240
        other = next(t for t in run.trials if t.parameter_set != trial.parameter_set)
        assert not earlier_evidence(run, other.parameters, "inprocess").refutations

    def test_runs_of_another_backend_are_other_measurements(self, run):
        """The contexts are looked at on any."""
        certify(run, [(1.0, 0.5)] * 120, [(1.0, 1.5 + 0.01 * k) for k in range(120)], repeated=120)
        trial = run.trials[run.summary["trial"]]
        found = earlier_evidence(run, trial.parameters, "ros")
        assert found.contexts == [{"load": 1.5}]
        assert found.evaluations == ()

    def test_what_the_run_itself_refuted(self, run):
        """Ten runs around 2 in a context, where the limit on the mean is 1."""
        trial = run.trials[run.summary["trial"]]
        more = [
            dataclasses.replace(e, parameters=trial.parameters)
            for e in runs(np.linspace(1.9, 2.1, 10), Stage.CHECK_WORST, load=1.25)
        ]
        changed = dataclasses.replace(run, evaluations=(*run.evaluations, *more))
        assert not earlier_evidence(run, trial.parameters, "inprocess").contexts
        found = earlier_evidence(changed, trial.parameters, "inprocess")
        assert found.contexts == [{"load": 1.25}]
        assert not found.certified
        assert found.refutations[0].runs == RefutingRuns("peak", runs=10, contexts=1)

    def test_a_run_that_was_cut_short_is_no_evidence(self, run):
        """It neither violates a limit nor keeps it; one that failed counts."""
        trial = run.trials[run.summary["trial"]]
        known = earlier_evidence(run, trial.parameters, "inprocess")
        (one,) = runs([0.5], Stage.DRAWN)
        outcomes = [
            Outcome.cut_short(1.0, {"error": 2.0}, "error at least 2"),
            Outcome(EvaluationState.FAILED, reason="stalled"),
        ]
        more = [
            dataclasses.replace(one, parameters=trial.parameters, outcome=outcome)
            for outcome in outcomes
        ]
        changed = dataclasses.replace(run, evaluations=(*run.evaluations, *more))
        found = earlier_evidence(changed, trial.parameters, "inprocess")
        assert found.evaluations == (*known.evaluations, more[1])

    @pytest.mark.parametrize("suffix", [".json", "_evaluations.csv"])
    def test_one_that_cannot_be_read_is_named(self, run, suffix):
        certify(run, [(1.0, 0.5)] * 120, [(1.0, 1.5)] * 120)
        (run.path / "certificates" / f"0001{suffix}").write_text("{")
        trial = run.trials[run.summary["trial"]]
        found = earlier_evidence(run, trial.parameters, "inprocess")
        (line,) = found.unread
        assert (".json: not a readable" if suffix == ".json" else f"0001{suffix} does not") in line
        # The certificate itself says where it failed.
        assert (found.contexts == [{"load": 1.5}]) is (suffix != ".json")
