"""What is shown when the time for a certificate ends, against a closed form."""

import math

import pytest
from certified import CHANCE
from scipy import integrate, optimize

from bo_tuner.evidence.certificate.certification import Certification
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.words.so_far import so_far
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.gate import Gate


def kept(count):
    """Lower bound of the share of runs within a limit, of which none of `count` was beyond.

    E = ∫_0^p ((1 - q) / (1 - p))^count / (2 √(p q)) dq = 20.
    """

    def evidence(p):
        # q = s² takes the root out of the integral.
        found, _ = integrate.quad(lambda s: ((1 - s * s) / (1 - p)) ** count, 0.0, math.sqrt(p))
        return found / math.sqrt(p)

    return 1.0 - optimize.brentq(lambda p: evidence(p) - 20.0, 1e-6, 0.9)


def timed(study, backend, runs):
    """The certification, and its evidence when the time ends after so many runs."""

    def over():
        return len(backend.calls) >= runs

    driver = Driver(backend, gate=Gate(time_is_up=over))
    certification = Certification(study, driver, confidence=0.95, finishing=over)
    return certification, certification.collect([Subject("tuned", {"gain": 0.5})], 300)[0]


def quiet(study, function_backend):
    return function_backend(study, lambda **_: {"error": 1.0, "peak": 0.5})


def test_a_share_of_the_runs(make_study, function_backend):
    study = make_study(**CHANCE)
    certification, evidence = timed(study, quiet(study, function_backend), 12)
    assert certification.cut_short
    assert len(evidence.drawn) == 12
    head, peak = so_far(study, evidence, 0.95)
    assert head == "12 test runs, nothing refutes it; shown with 95 % confidence:"
    share = math.floor(100.0 * kept(12)) / 100.0
    assert peak == f"peak: at least {share:g} of the runs are below 1, asked 0.96"


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        (33, "in random contexts; the search for its worst one is not done"),
        (60, "in 1 of "),
    ],
)
def test_a_limit_in_every_context(make_study, function_backend, runs, said):
    limit = {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.95}
    study = make_study(constraints={"peak": limit})
    certification, evidence = timed(study, quiet(study, function_backend), runs)
    assert certification.cut_short
    assert len(evidence.evaluations) == runs
    _, peak = so_far(study, evidence, 0.95)
    assert said in peak
    assert "asked 0.95" in peak


def test_no_run_is_begun_once_it_is_over(make_study, function_backend):
    study = make_study(**CHANCE)
    backend = quiet(study, function_backend)
    certification, evidence = timed(study, backend, 0)
    assert certification.cut_short
    assert not backend.calls
    assert [*so_far(study, evidence, 0.95)] == ["nothing is shown by 0 test runs"]


def test_time_that_ends_with_the_verdict_cuts_nothing_short(make_study, function_backend):
    study = make_study(**CHANCE)
    whole, evidence = timed(study, quiet(study, function_backend), 1000)
    again, same = timed(study, quiet(study, function_backend), len(evidence.evaluations))
    assert not whole.cut_short
    assert not again.cut_short
    assert same.evaluations == evidence.evaluations
