"""Lower limits and several worst cases through a whole run: the answer is known in closed form."""

import dataclasses

import numpy as np
import pytest

from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.context_tolerance import context_tolerances
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.reasons import Why
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.limits import (
    judge_sample,
    refuted,
    tightest,
    violated,
    worst_case_holds,
)
from bo_tuner.trials import EvaluationState, Outcome
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer

NODE = {"node": "axis"}
WORST = {"kind": "worst_case"}
SECTIONS = {
    "metrics": {"error": NODE, "peak": NODE, "force": NODE},
    "constraints": {
        "peak": WORST | {"metric": "peak", "upper": 1.0},
        "force": WORST | {"metric": "force", "lower": 0.15},
    },
}
BUDGET = {"trials": 14, "initial_trials": 6, "drawn_contexts": 2, "search_evaluations": 4}


def noise(seed):
    return 0.005 * np.random.default_rng(seed).normal()


def gripper(target):
    """Peak gain x load and force gain / load, load from 1 to 2: feasible for 0.3 to 0.5."""

    def figures(gain, load, seed):
        return {
            "error": (gain - target) ** 2 + 0.1,
            "peak": gain * load + noise(seed),
            "force": gain / load + noise(seed + 1),
        }

    return figures


def tune(study, backend, algorithm):
    trials = list(Tuning(study, Driver(backend), METHODS[algorithm]))
    return trials, choose_answer(study, Driver(backend), METHODS[algorithm], trials)


@pytest.mark.parametrize("algorithm", ["IV", "V"])
@pytest.mark.parametrize(
    ("target", "best"),
    [
        pytest.param(0.0, 0.3, id="the lower limit is active"),
        pytest.param(1.0, 0.5, id="the upper limit is active"),
    ],
)
def test_the_answer_lies_at_the_active_limit(make_study, function_backend, algorithm, target, best):
    study = make_study(**SECTIONS).replace(**BUDGET)
    backend = function_backend(study, gripper(target))
    trials, found = tune(study, backend, algorithm)
    assert found.feasible
    gain = found.candidate.trial.parameters["gain"]
    assert abs(gain - best) < 0.05
    assert 0.29 < gain < 0.51
    for trial in trials:
        assert set(trial.worst_cases) == {"peak", "force"}
        searched = [e for e in trial.evaluations if e.stage == "search"]
        assert len(searched) <= study.budget.search_evaluations
    constraint, worst = tightest(study, found.candidate.trial)
    assert constraint.name == ("force" if target == 0.0 else "peak")
    assert worst.context["load"] == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("algorithm", ["I", "IV", "V", "boundary"])
def test_a_run_with_a_lower_limit_mirrors_one_with_an_upper(
    make_study, function_backend, algorithm
):
    """A lower limit on -m is an upper limit on m: all trials are the same."""
    runs = []
    for sign, side in ((1.0, "upper"), (-1.0, "lower")):
        limit = WORST | {"metric": "peak", side: sign * 0.8, "probability": 0.9}
        study = make_study(constraints={"peak": limit}).replace(trials=8, initial_trials=4)

        def figures(gain, load, seed, sign=sign):
            peak = gain * load + noise(seed)
            return {"error": (gain - 0.9) ** 2 + 0.1 * load, "peak": sign * peak}

        runs.append(tune(study, function_backend(study, figures), algorithm))
    (trials, found), (mirrored, mirror) = runs
    for here, there in zip(trials, mirrored, strict=True):
        assert there.parameters["gain"] == pytest.approx(here.parameters["gain"])
        a, b = here.worst_cases["peak"], there.worst_cases["peak"]
        assert (-b.value, -b.observed) == pytest.approx((a.value, a.observed))
        assert (b.noise, dict(b.context)) == (pytest.approx(a.noise), pytest.approx(a.context))
    assert mirror.candidate.trial.number == found.candidate.trial.number
    assert mirror.feasible is found.feasible


class TestLimits:
    @pytest.mark.parametrize("probability", [None, 0.8])
    def test_judgements_mirror_each_other(self, make_study, make_trial, probability):
        given = {} if probability is None else {"probability": probability}
        studies = [
            make_study(constraints={"peak": WORST | {"metric": "peak", side: value} | given})
            for side, value in (("upper", 1.0), ("lower", -1.0))
        ]
        above, below = (study.constraints["peak"] for study in studies)
        values = 0.9 + 0.2 * np.random.default_rng(0).normal(size=30)
        for count in range(2, 31):
            some = values[:count]
            here, there = judge_sample(above, some), judge_sample(below, -some)
            assert there == dataclasses.replace(here, worst=-here.worst)
            assert refuted(above, some) is refuted(below, -some)
        for worst in (0.7, 0.9, 0.99, 1.01):
            trial = make_trial(0, {"gain": 0.5}, [1.0], worst=worst, noise=0.1)
            mirror = make_trial(0, {"gain": 0.5}, [1.0], worst=-worst, noise=0.1)
            estimates = trial.worst_cases["peak"], mirror.worst_cases["peak"]
            assert worst_case_holds(above, estimates[0]) is worst_case_holds(below, estimates[1])
            assert violated(studies[0], trial) == violated(studies[1], mirror)


def broken_limits(found):
    """The limits that are not kept by what their runs show, and not by how little they show.

    A certificate ends with the first limit that is not kept, when another may have few runs, or
    none in some of its contexts.
    """
    return {c.name for c in found.constraints if c.refuted}


class TestEvidence:
    """Fresh draws and the certificate, on gains that are within the limits and beyond each."""

    @pytest.mark.parametrize(("gain", "broken"), [(0.4, set()), (0.27, {"force"}), (0.6, {"peak"})])
    def test_each_limit_has_its_own_verdict(self, make_study, function_backend, gain, broken):
        study = make_study(**SECTIONS)
        backend = function_backend(study, gripper(0.0))
        (evidence,) = Certification(study, Driver(backend), confidence=0.95).collect(
            [Subject("tuned", {"gain": gain})], 300
        )
        found = judge(study, evidence, 0.95)
        assert broken_limits(found) == broken
        assert found.passed is (not broken)
        for constraint in found.constraints:
            refuted = constraint.reason.why is Why.REFUTED_IN_CONTEXT
            assert refuted is (constraint.name in broken), constraint.reason
        peak, force = found.constraints
        assert (peak.side, force.side) == ("upper", "lower")
        assert peak.extreme == max(e.outcome.metrics["peak"] for e in evidence.drawn)
        assert force.extreme == min(e.outcome.metrics["force"] for e in evidence.drawn)
        if not broken:
            # The mean over noise in the worst context, load 2 for both.
            for item, expected in ((peak, 2.0 * gain), (force, gain / 2.0)):
                worst = item.worst[0]
                assert worst.context == {"load": 2.0}
                assert worst.mean.value == pytest.approx(expected, abs=0.005)
                assert worst.mean.lower < expected < worst.mean.upper

    def test_both_limits_of_one_metric(self, make_study, function_backend):
        """The force goes from gain / 2 to gain."""
        both = {"grip": WORST | {"metric": "force", "lower": 0.15, "upper": 0.5}}
        study = make_study(metrics=SECTIONS["metrics"], constraints=both)
        backend = function_backend(study, gripper(0.0))
        for gain, broken in ((0.4, set()), (0.25, {"grip_lower"}), (0.6, {"grip_upper"})):
            (evidence,) = Certification(study, Driver(backend), confidence=0.95).collect(
                [Subject("tuned", {"gain": gain})], 300
            )
            found = judge(study, evidence, 0.95)
            assert broken_limits(found) == broken
            assert found.passed is (not broken)

    def test_a_chance_constraint_with_a_lower_limit(self, make_study, function_backend):
        """A force of 0.4 / load keeps 0.22 up to load 1.82: in 82 % of the draws."""
        for probability, passes in ((0.7, True), (0.95, False)):
            limit = {"kind": "chance", "metric": "force", "lower": 0.22}
            study = make_study(
                metrics=SECTIONS["metrics"],
                constraints={"force": limit | {"probability": probability}},
            )
            backend = function_backend(study, gripper(0.0))
            (evidence,) = Certification(study, Driver(backend), confidence=0.95).collect(
                [Subject("tuned", {"gain": 0.4})], 300
            )
            assert judge(study, evidence, 0.95).passed is passes

    def test_drift_to_a_lower_limit(self, make_study, function_backend):
        """With gain 0.27, the force is at its limit at load 1.8."""
        study = make_study(**SECTIONS)
        backend = function_backend(study, gripper(0.0))
        (evidence,) = Certification(study, Driver(backend), confidence=0.95).collect(
            [Subject("tuned", {"gain": 0.4})], 300
        )
        values = [
            dataclasses.replace(
                e,
                outcome=Outcome(
                    EvaluationState.COMPLETE,
                    {"error": 1.0, "peak": 0.5, "force": 0.27 / e.context["load"]},
                ),
            )
            for e in evidence.evaluations
        ]
        of_peak, of_force = context_tolerances(study, values)
        assert (of_peak.constraint, of_force.constraint) == ("peak", "force")
        (load,) = of_force.variables
        assert load.up.limit.median == pytest.approx(1.8, abs=0.02)
        assert of_force.worst.median == pytest.approx(0.135, abs=0.002)
        assert load.relief.median == pytest.approx(0.27 / 1.5 - 0.135, abs=0.002)
        assert of_force.relieved == "higher"
