"""A context counts by its own runs, and by as many as the limit takes anywhere."""

import dataclasses
import itertools

import numpy as np
import pytest
from certified import CHANCE, collect

from bo_tuner.evidence.certificate.certification import most_evaluations
from bo_tuner.evidence.certificate.claim import claimed
from bo_tuner.evidence.certificate.independent_search import most_candidates
from bo_tuner.evidence.certificate.judgement import judge
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.reasons import Why
from bo_tuner.evidence.words.certificate import price
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.numerics.sequential import draws_needed
from bo_tuner.numerics.two_kinds import runs_to_see
from bo_tuner.study.ranges import OutOfRange

SINGLE_RUN = {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.85}
ON_MEAN = {"kind": "worst_case", "metric": "peak", "upper": 1.0}
TERRAIN = {
    "node": "axis",
    "distribution": "discrete",
    "values": ["road", "gravel", "mud"],
    "probabilities": [0.9, 0.09, 0.01],
}
TOOL = {"node": "axis", "distribution": "discrete", "values": [1.0, 1.01, 9.0]}
LOAD = {"node": "axis", "distribution": "uniform", "bounds": [1.0, 2.0]}
NEEDED = draws_needed(0.15, 0.95)


def certified(study, function_backend, peak, most=300):
    """A certificate of a peak by context and generator."""

    def function(gain, seed, **context):
        return {"error": 1.0, "peak": peak(context, np.random.default_rng(seed))}

    (found,) = collect(study, function_backend(study, function), most, tuned=0.5)
    return found, judge(study, found, 0.95)


def by_context(verdict):
    (limit,) = verdict.constraints
    return {tuple(worst.context.values()): worst.evaluations for worst in limit.worst}


def test_every_combination_of_discrete_values_has_its_own_runs(make_study, function_backend):
    """Far within the limit, and although some are drawn once in 300 draws."""
    study = make_study(
        contexts={"terrain": TERRAIN, "tool": TOOL}, constraints={"peak": SINGLE_RUN}
    )
    found, verdict = certified(study, function_backend, lambda _, rng: 0.1 + 0.01 * rng.normal())
    assert verdict.passed
    assert found.search == ()
    every = itertools.product(TERRAIN["values"], TOOL["values"])
    assert by_context(verdict) == dict.fromkeys(every, NEEDED)
    most = most_evaluations(study, [Subject("tuned", {"gain": 0.5})], 300)
    assert (most.searched, most.repeated) == (0, 9 * 300)


@pytest.mark.parametrize("limit", [SINGLE_RUN, ON_MEAN])
def test_one_that_is_hardly_drawn_decides(make_study, function_backend, limit):
    """In mud alone 40 % of the runs are at 4 times the limit, beside a mean of 0.1."""
    study = make_study(contexts={"terrain": TERRAIN, "load": LOAD}, constraints={"peak": limit})

    def peak(context, rng):
        bad = context["terrain"] == "mud" and rng.random() < 0.4
        return (4.0 if bad else 0.1) + 0.01 * rng.normal()

    found, verdict = certified(study, function_backend, peak)
    assert not verdict.passed
    assert "mud" in {group[0].context["terrain"] for group in found.repeated}


def test_each_combination_is_looked_at_where_the_others_are_the_worst(make_study, function_backend):
    """The peak is the largest at the smallest load in mud, else at the largest."""
    study = make_study(
        contexts={"terrain": TERRAIN, "load": LOAD}, constraints={"peak": SINGLE_RUN}
    )

    def peak(context, rng):
        slope = -0.3 if context["terrain"] == "mud" else 0.3
        return 0.4 + slope * (context["load"] - 1.5) + 0.01 * rng.normal()

    _, verdict = certified(study, function_backend, peak)
    counts = by_context(verdict)
    assert verdict.passed
    for terrain, worst in (("road", 2.0), ("gravel", 2.0), ("mud", 1.0)):
        assert any(t == terrain and abs(x - worst) < 0.05 for t, x in counts)
    assert min(counts.values()) >= NEEDED
    assert len(counts) <= most_candidates(study.context_space())


def test_all_corners_of_a_small_box(make_study, function_backend):
    """No model of the mean tells in which corner the noise is the largest."""
    study = make_study(contexts={"load": LOAD, "wear": LOAD}, constraints={"peak": SINGLE_RUN})
    _, verdict = certified(study, function_backend, lambda _, rng: 0.1 + 0.01 * rng.normal())
    corners = list(itertools.product((1.0, 2.0), repeat=2))
    for corner in corners:
        assert any(np.allclose(corner, known, atol=0.03) for known in by_context(verdict))
    assert set(by_context(verdict).values()) == {NEEDED}


def test_the_claim(make_study, function_backend):
    """Proven in all of the discrete contexts, in those searched of others; a mean with its if."""

    def quiet(_, rng):
        return 0.1 + 0.01 * rng.normal()

    claims = []
    for contexts, limit, declared in (
        ({"terrain": TERRAIN}, ON_MEAN, [0.0, 2.0]),
        ({"load": LOAD}, SINGLE_RUN, None),
        ({"load": LOAD}, ON_MEAN, None),
    ):
        metrics = {"error": {"node": "axis"}, "peak": {"node": "axis", "range": declared}}
        if declared is None:
            del metrics["peak"]["range"]
        study = make_study(contexts=contexts, constraints={"peak": limit}, metrics=metrics)
        _, verdict = certified(study, function_backend, quiet)
        assert verdict.passed
        claims.append(in_words(claimed(study, verdict)))
    assert claims == [
        "proven to stay within all limits",
        "proven to stay within all limits in the contexts searched, peak in 85 % of the runs",
        "shown to stay within all limits in the contexts searched, if no rare runs are far beyond "
        "the peak of the others",
    ]


def test_runs_beyond_a_limit_that_permits_some_are_in_the_claim(make_study, function_backend):
    study = make_study(**CHANCE)
    numbers = iter(range(10_000))
    _, verdict = certified(
        study, function_backend, lambda *_: 1.1 if next(numbers) == 3 else 0.5, 1000
    )
    assert verdict.passed
    (peak,) = verdict.constraints
    assert in_words(claimed(study, verdict)) == (
        "proven to stay within all limits, peak in 96 % of the runs "
        f"(1 of {peak.draws} test runs above it)"
    )


def test_two_kinds_of_runs_need_a_range(make_study, function_backend):
    """Half of the runs are at 0.2, the others at 0.4: without a range that says little."""

    def peak(_, rng):
        return (0.2 if rng.random() < 0.5 else 0.4) + 0.005 * rng.normal()

    for declared in (None, [0.0, 2.0]):
        metrics = {"error": {"node": "axis"}, "peak": {"node": "axis"}}
        if declared is not None:
            metrics["peak"]["range"] = declared
        study = make_study(constraints={"peak": ON_MEAN}, metrics=metrics)
        _, verdict = certified(study, function_backend, peak)
        assert verdict.passed is (declared is not None)
        if declared is None:
            (limit,) = verdict.constraints
            assert limit.reason.why is Why.TWO_KINDS_IN_CONTEXT
            assert not limit.refuted


def test_a_mean_without_a_range_takes_the_runs_that_show_a_rare_kind(make_study, function_backend):
    study = make_study(constraints={"peak": ON_MEAN})
    _, verdict = certified(study, function_backend, lambda _, rng: 0.1 + 0.01 * rng.normal())
    assert set(by_context(verdict).values()) == {runs_to_see(0.975)}


def test_the_price(make_study, function_backend):
    limits = {"time": CHANCE["constraints"]["peak"] | {"metric": "error"}, "peak": SINGLE_RUN}
    study = make_study(constraints=limits)
    found, verdict = certified(study, function_backend, lambda _, rng: 0.1 + 0.01 * rng.normal())
    assert verdict.passed
    assert all(limit.assumption is None for limit in verdict.constraints)
    assert verdict.least == draws_needed(0.04, 0.95) + NEEDED
    assert len(found.drawn) == draws_needed(0.04, 0.95)
    times = round(verdict.evaluations / verdict.least, 1)
    assert price(verdict) == (
        f"{verdict.evaluations} test runs, {times:g} times the fewest that can show these limits "
        f"({verdict.least})"
    )


def test_a_run_outside_the_declared_range_is_a_fail(make_study, function_backend):
    study = make_study()
    metrics = dict(study.metrics)
    metrics["peak"] = dataclasses.replace(metrics["peak"], range=(0.0, 1.5))
    study = dataclasses.replace(study, metrics=metrics)
    runs = iter(range(1000))
    found, verdict = certified(
        study, function_backend, lambda *_: -0.1 if next(runs) == 3 else 0.5, 100
    )
    assert not verdict.passed
    assert verdict.contradiction == OutOfRange("peak", -0.1, 0.0, 1.5)
    assert len(found.evaluations) == 4
