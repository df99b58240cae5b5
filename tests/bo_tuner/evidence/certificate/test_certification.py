"""The evaluations of a certificate: fresh, where they tell most, and as few as said before."""

import math

import numpy as np
import pytest
from certified import CHANCE, LIMIT, collect
from scipy import stats

from bo_tuner.evidence.certificate.certification import (
    Certification,
    MostEvaluations,
    most_evaluations,
)
from bo_tuner.evidence.certificate.draws import LEAST_DRAWS
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.methods.registry import METHODS
from bo_tuner.numerics.two_kinds import runs_to_see
from bo_tuner.trials import EvaluationState
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.validation import ValidationPlan

PLANE = {
    "contexts": {
        name: {"node": "axis", "distribution": "uniform", "bounds": [0.0, 1.0]}
        for name in ("load", "wear")
    }
}


class TestEvaluations:
    def test_the_same_draws_for_both_and_fresh_ones(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        default, tuned = collect(study, backend, 30, default=0.25, tuned=0.75)
        seen = [[(c.context["load"], c.seed) for c in item.drawn] for item in (default, tuned)]
        assert seen[0] == seen[1]
        assert len(set(seen[0])) == LEAST_DRAWS == 30
        # Each is first by turns: what changes with the runs is no difference between the two.
        gains = [call["gain"] for call in backend.calls[:8]]
        assert gains == [0.25, 0.75, 0.75, 0.25, 0.25, 0.75, 0.75, 0.25]
        before = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        list(Tuning(study, Driver(before), METHODS["IV"]))
        Driver(before).complete(ValidationPlan(study, [{"gain": 0.25}]))
        for key in ("load", "seed"):
            drawn = {c.context[key] if key == "load" else c.seed for c in tuned.drawn}
            assert not drawn & {call[key] for call in before.calls}
        seeds = [c.seed for c in tuned.evaluations]
        assert len(set(seeds)) == len(seeds)

    def test_they_follow_the_distribution(self, make_study, function_backend):
        study = make_study(constraints={}, seed=2)
        backend = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        attempts = [
            Certification(study, Driver(backend), confidence=0.95, attempt=k) for k in range(1, 14)
        ]
        found, *others = [a.collect([Subject("", {"gain": 0.5})], 99)[0] for a in attempts]
        loads = [c.context["load"] for item in (found, *others) for c in item.drawn]
        # Each attempt has own draws.
        assert len(set(loads)) == 13 * LEAST_DRAWS
        assert stats.kstest(loads, stats.uniform(1.0, 1.0).cdf).pvalue > 1e-3
        assert found.search == found.repeated == ()

    @pytest.mark.parametrize("height", [0.9, 1.2])
    def test_a_peak_that_draws_do_not_meet(self, make_study, function_backend, height):
        """A corner with 0.1 % of the draws: 80 draws keep the limit, the search tells."""
        study = make_study(**PLANE)

        def function(load, wear, **_):
            distance = math.hypot(load - 1.0, wear)
            return {"error": 1.0, "peak": height * math.exp(-0.5 * (distance / 0.12) ** 2)}

        (found,) = collect(study, function_backend(study, function), 80, tuned=0.5)
        verdict = judge(study, found, 0.95)
        (constraint,) = verdict.constraints
        assert constraint.violations == 0
        worst = constraint.worst[0]
        assert worst.context == {"load": pytest.approx(1.0), "wear": pytest.approx(0.0, abs=1e-9)}
        assert worst.mean.value == pytest.approx(height, rel=1e-3)
        assert worst.evaluations <= runs_to_see(0.975)
        assert verdict.passed is (height < LIMIT)

    @pytest.mark.parametrize("height", [0.2, 0.99, 2.0])
    def test_no_more_than_it_says_before(self, make_study, function_backend, height):
        """Clearly kept, hardly kept (which no number of runs shows here), clearly violated."""
        study = make_study(**PLANE)
        rng = np.random.default_rng(3)

        def function(load, wear, **_):
            return {"error": 1.0, "peak": height * load * wear + 0.2 * rng.standard_normal()}

        backend = function_backend(study, function)
        subject = Subject("tuned", {"gain": 0.5}, ({"load": 0.9, "wear": 0.9},))
        most = most_evaluations(study, [subject], 80)
        # Four corners, a design of twelve, one suspected, four rounds of five; nine contexts.
        assert most == MostEvaluations(80, 4 + 12 + 1 + 20, 9 * 80)
        assert most.total == 80 + 37 + 720
        (found,) = Certification(study, Driver(backend), confidence=0.95).collect([subject], 80)
        assert len(found.drawn) <= most.drawn
        assert len(found.search) <= most.searched
        assert sum(map(len, found.repeated)) <= most.repeated
        assert len(backend.calls) == len(found.evaluations)
        assert (height == 2.0) is (len(found.evaluations) < 110)

    def test_the_most_without_contexts_and_with_two_subjects(self, make_study):
        study = make_study(contexts={})
        both = [Subject("default", {"gain": 0.1}), Subject("tuned", {"gain": 0.5})]
        assert most_evaluations(study, both, 40) == MostEvaluations(80, 0, 80)
        assert most_evaluations(make_study(**CHANCE), both, 40) == MostEvaluations(80, 0, 0)

    def test_the_suspected_context_of_each_constraint_is_looked_at(
        self, make_study, function_backend
    ):
        names = ("error", "peak", "jerk")
        study = make_study(
            **PLANE,
            metrics={name: {"node": "axis"} for name in names},
            constraints={
                name: {"kind": "worst_case", "metric": name, "upper": 10.0} for name in names
            },
        )
        rng = np.random.default_rng(1)

        def function(load, wear, **_):
            """The highest point is none of the corners; the largest observation is elsewhere."""
            bump = 2.0 * math.exp(-8.0 * ((load - 0.6) ** 2 + (wear - 0.5) ** 2))
            return {name: bump + 0.6 * rng.normal() for name in names}

        suspected = tuple(
            {"load": load, "wear": wear} for load, wear in ((0.1, 0.2), (0.9, 0.1), (0.35, 0.65))
        )
        subject = Subject("tuned", {"gain": 0.5}, suspected)
        backend = function_backend(study, function)
        (found,) = Certification(study, Driver(backend), confidence=0.95).collect([subject], 80)
        repeated = [here[0].context for here in found.repeated]
        for context in suspected:
            assert any(other == pytest.approx(context) for other in repeated)

    def test_a_failure_in_the_search_ends_it(self, make_study, function_backend, failed):
        study = make_study(**PLANE)

        def function(load, wear, **_):
            if load == wear == 1.0:
                return failed("stalled")
            return {"error": 1.0, "peak": 0.5}

        backend = function_backend(study, function)
        (found,) = collect(study, backend, 40, tuned=0.5)
        last = found.search[-1]
        assert backend.calls[-1] | last.context == backend.calls[-1]
        assert last.outcome.state is EvaluationState.FAILED
        assert found.repeated == ()
        assert not judge(study, found, 0.95).passed

    def test_nothing_varies(self, make_study, function_backend):
        study = make_study(contexts={})
        backend = function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})
        (found,) = collect(study, backend, runs_to_see(0.975), tuned=0.5)
        assert judge(study, found, 0.95).passed
        assert len(found.repeated) == 1
