"""A simulator that is declared free of noise: one run a context, and faults where it has some."""

from collections import Counter

import numpy as np
import pytest
from certified import CHANCE

from bo_tuner.errors import StudyError
from bo_tuner.evidence.certificate.certification import Certification, most_evaluations
from bo_tuner.evidence.certificate.draws import REPEATS
from bo_tuner.evidence.certificate.independent_search import most_candidates
from bo_tuner.evidence.certificate.judgement import judge, least_evaluations
from bo_tuner.evidence.certificate.outlook import outlook
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.declarations import contradicted
from bo_tuner.evidence.reasons import Assumption, Reason, Why
from bo_tuner.methods.registry import METHODS
from bo_tuner.numerics.sequential import draws_needed
from bo_tuner.study.limits import refuted
from bo_tuner.study.noiseless import Noisy, noise_in
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.validation import ValidationPlan

MEAN = {"peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0}}
RUNS = {"peak": MEAN["peak"] | {"probability": 0.99}}


def quiet(gain, load, **_):
    return {"error": gain, "peak": 0.4 * load}


def noisy(gain, load, seed, **_):
    noise = np.random.default_rng(seed).standard_normal()
    return {"error": gain, "peak": 0.4 * load + 0.01 * noise}


def certified(study, function_backend, function=quiet):
    backend = function_backend(study, function)
    certification = Certification(study, Driver(backend), confidence=0.95)
    (evidence,) = certification.collect([Subject("tuned", {"gain": 0.5})], 500)
    return evidence, judge(study, evidence, 0.95)


@pytest.mark.parametrize("constraints", [MEAN, RUNS])
def test_one_run_in_each_context(make_study, function_backend, constraints):
    study = make_study(constraints=constraints, noise="none")
    evidence, findings = certified(study, function_backend)
    assert findings.passed
    assert [len(group) for group in evidence.repeated] == [1] * len(evidence.repeated)
    assert 1 < len(evidence.repeated) <= most_candidates(study.context_space())
    assert len({e.seed for e in evidence.drawn}) == 1
    assert findings.constraints[0].assumption == Assumption("peak", repeats=REPEATS)
    worst = findings.constraints[0].worst[0]
    # The largest load is 2.
    assert worst.mean.value == pytest.approx(0.8, abs=1e-3)
    assert worst.mean.upper == worst.mean.value
    assert least_evaluations(study, 0.95) == 1
    most = most_evaluations(study, [Subject("tuned", {"gain": 0.5})], 500)
    assert (most.drawn, most.repeated) == (503, most_candidates(study.context_space()))
    assert findings.evaluations <= outlook(study, 500, 0.95).high


@pytest.mark.parametrize("constraints", [MEAN, RUNS])
def test_one_run_beyond_the_limit_decides(make_study, function_backend, constraints):
    """At the largest load only, which no draw meets."""
    study = make_study(constraints=constraints, noise="none")
    evidence, findings = certified(
        study,
        function_backend,
        lambda load, **_: {"error": 1.0, "peak": 0.4 * load + 0.3 * (load > 1.995)},
    )
    assert not findings.passed
    assert sum(map(len, evidence.repeated)) <= most_candidates(study.context_space())
    assert all(e.outcome.metrics["peak"] < 1.0 for e in evidence.drawn)


def test_a_draw_beyond_the_limit_decides(make_study, function_backend):
    study = make_study(constraints=MEAN, noise="none")
    evidence, findings = certified(
        study, function_backend, lambda load, **_: {"error": 1.0, "peak": load}
    )
    assert not findings.passed
    assert len(evidence.evaluations) == REPEATS + len(evidence.drawn)
    assert sum(e.outcome.metrics["peak"] > 1.0 for e in evidence.drawn) == 1


def test_over_contexts_it_takes_draws_all_the_same(make_study, function_backend):
    study = make_study(**CHANCE, noise="none")
    evidence, findings = certified(study, function_backend)
    assert findings.passed
    assert len(evidence.drawn) == draws_needed(0.04, 0.95)
    assert findings.constraints[0].assumption is None


def test_without_contexts_one_run_decides(make_study, function_backend):
    study = make_study(**CHANCE, noise="none", contexts={})
    evidence, findings = certified(study, function_backend, lambda **_: {"error": 1.0, "peak": 0.5})
    assert findings.passed
    assert (len(evidence.drawn), len(evidence.repeats)) == (1, REPEATS)
    assert findings.constraints[0].reason == Reason(Why.WITHOUT_NOISE)


@pytest.mark.parametrize("constraints", [MEAN, CHANCE["constraints"]])
def test_noise_is_a_fault_of_the_declaration(make_study, function_backend, constraints):
    study = make_study(constraints=constraints, noise="none")
    evidence, findings = certified(study, function_backend, noisy)
    assert not findings.passed
    assert len(evidence.evaluations) == REPEATS + 1
    first, other = evidence.drawn[0], evidence.repeats[0]
    values = first.outcome.metrics["peak"], other.outcome.metrics["peak"]
    assert findings.contradiction == Noisy("peak", values, (first.seed, other.seed))


def test_a_run_repeats_nothing_but_its_first(make_study, function_backend):
    """Trials, the answer and the validation."""
    study = make_study(constraints=MEAN, noise="none").replace(trials=8)
    backend = function_backend(study, quiet)
    driver = Driver(backend)
    trials = list(Tuning(study, driver, METHODS["boundary"]))
    search = METHODS["boundary"].answer_search(study, trials, None)
    driver.complete(search)
    assert search.answer is not None
    driver.complete(ValidationPlan(study, [search.answer.candidate.trial.parameters]))
    first, second = backend.calls[:2]
    assert {**first, "seed": 0} == {**second, "seed": 0}
    assert first["seed"] != second["seed"]
    places = Counter(
        tuple(sorted((k, v) for k, v in c.items() if k != "seed")) for c in backend.calls
    )
    assert sorted(places.values())[-2:] == [1, 2]


def test_a_noisy_run_is_named(make_study, function_backend):
    study = make_study(constraints=MEAN, noise="none").replace(trials=5)
    trials = list(Tuning(study, Driver(function_backend(study, noisy)), METHODS["boundary"]))
    runs = [e for trial in trials for e in trial.evaluations]
    (found,) = contradicted(study, runs)
    assert (type(found.how), found.how.metric) == (Noisy, "peak")
    assert noise_in(make_study(constraints=MEAN), runs) is None


def test_rounding_is_no_noise(make_study, function_backend):
    study = make_study(constraints=MEAN, noise="none")

    def rounded(seed, load, **_):
        return {"error": 1.0, "peak": 0.4 * load * (1.0 + 1e-15 * (seed % 3))}

    _, findings = certified(study, function_backend, rounded)
    assert findings.contradiction is None


def test_a_single_run_refutes_a_limit_or_not(make_study):
    (limit,) = make_study(constraints=MEAN).constraints.values()
    assert refuted(limit, [1.1])
    assert not refuted(limit, [0.9])


@pytest.mark.parametrize("noise", ["low", "", 0, False])
def test_another_declaration_is_refused(make_study, noise):
    with pytest.raises(StudyError) as error:
        make_study(noise=noise)
    assert error.value.path == ("noise",)
