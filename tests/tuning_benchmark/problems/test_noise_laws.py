"""The laws of noise against numerical integration, and problems that have them."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import lognorm, norm

from bo_tuner.errors import StudyError
from tuning_benchmark.experiments.optima import optimum_of
from tuning_benchmark.judging.evaluator import Evaluator
from tuning_benchmark.judging.truth import Effort, Truth
from tuning_benchmark.problems.closed_form import LOGARITHMIC, ClosedForm
from tuning_benchmark.problems.noise_laws import BIMODAL, LAWS, LOGNORMAL, SPIKES

JUDGE = "tuning_benchmark.judging.closed_form:Judge"
MIXTURES = [BIMODAL, SPIKES]


def problem(law, **others):
    noise = "constant" if law == LOGNORMAL else "heteroscedastic"
    return ClosedForm(parameters=3, contexts=2, noise=noise, law=law, **others)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_has_mean_0_and_standard_deviation_1(name):
    law = LAWS[name]

    def moment(power):
        return quad(lambda z: float(law.of_normal(z)) ** power * norm.pdf(z), -8, 8, limit=400)[0]

    assert moment(1) == pytest.approx(0.0, abs=1e-4)
    assert moment(2) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("name", LAWS)
def test_noise_of_a_quantile_is_kept_with_its_probability(name):
    levels = np.array([1e-4, 0.2, 0.5, 0.79, 0.85, 0.95, 0.99, 0.9999])
    assert LAWS[name].kept(LAWS[name].of_normal(norm.ppf(levels))) == pytest.approx(levels)


def test_spikes_are_rare_and_far():
    noise = LAWS[SPIKES].of_normal(np.random.default_rng(0).standard_normal(20_000))
    assert np.mean(noise > 2.0) == pytest.approx(0.05, abs=0.006)


@pytest.mark.parametrize("name", [LOGNORMAL, *MIXTURES])
@pytest.mark.parametrize("probability", [0.85, 0.95, 0.99])
def test_runs_at_the_optimum_keep_the_limit_as_often_as_promised(name, probability):
    form = problem(name, probability=probability)
    assert ((form.optimum > 0.0) & (form.optimum < 1.0)).all()
    assert form.kept(form.optimum) == pytest.approx(probability, abs=1e-9)
    assert np.mean(form.runs(form.optimum) <= 1.0) == pytest.approx(probability, abs=1e-3)
    # No context is worse, of many, by the law's own distribution function.
    w = np.random.default_rng(3).uniform(-1.0, 1.0, (20_000, 2))
    mean, deviation = form.metric(form.optimum, w), form.deviation(form.optimum, w)
    if name == LOGNORMAL:
        kept = lognorm.cdf(1.0, LOGARITHMIC, scale=mean * np.exp(-(LOGARITHMIC**2) / 2.0))
    else:
        kept = LAWS[name].kept((1.0 - mean) / deviation)
    assert kept.min() >= probability - 1e-9
    step = form.constants.D * 1e-3
    assert form.kept(form.optimum + step) < probability < form.kept(form.optimum - step)


@pytest.mark.parametrize("name", [LOGNORMAL, *MIXTURES])
def test_the_mean_of_runs_is_the_metric_and_the_optimum_on_the_frontier(name):
    form = problem(name)
    assert form.worst(form.optimum)[0] == pytest.approx(1.0, abs=1e-9)
    assert form.best == pytest.approx(float(form.frontier(1.0)), abs=1e-9)
    u, w = np.array([0.3, 0.6, 0.5]), np.array([0.4, -0.7])
    z = norm.ppf((np.arange(100_000) + 0.5) / 100_000)
    sample = form.observed(u, np.tile(w, (len(z), 1)), z)
    assert sample.mean() == pytest.approx(float(form.metric(u, w)), rel=1e-4)
    assert sample.std() == pytest.approx(float(form.deviation(u, w)), rel=1e-2)
    assert optimum_of({}, form.study()).at(1.0) == pytest.approx(form.best, rel=1e-5)


@pytest.mark.parametrize("name", [LOGNORMAL, *MIXTURES])
def test_the_node_draws_from_the_law_and_the_truth_knows_it(name):
    form = problem(name, probability=0.85)
    study = form.study()
    evaluator, context = Evaluator(study), {"w1": 0.3, "w2": -0.2}
    default = study.search_space().defaults
    stress = [evaluator.metrics(default, context, seed)["stress"] for seed in range(400)]
    u, w = form.point(default), np.array([0.3, -0.2])
    median = np.median(
        form.observed(u, np.tile(w, (2001, 1)), norm.ppf(np.linspace(0, 1, 2003)[1:-1]))
    )
    # Within three standard errors of a sample's share.
    assert np.mean(np.array(stress) <= median) == pytest.approx(0.5, abs=3 * 0.5 / 20)
    truth = Truth(study, JUDGE, Effort(drawn=50, grid=3, real_evaluations=0))
    verdict = truth.verdict(default)
    assert verdict.worst_kept == pytest.approx(form.kept(u), abs=1e-3)


@pytest.mark.parametrize(
    ("others", "key"),
    [
        ({"law": "cauchy", "noise": "constant"}, "law"),
        ({"law": BIMODAL}, "noise"),
        ({"law": LOGNORMAL, "noise": "heteroscedastic"}, "law"),
        ({"law": LOGNORMAL, "noise": "constant", "steep": True}, "law"),
    ],
)
def test_a_law_that_the_truth_does_not_hold_for_is_refused(others, key):
    with pytest.raises(StudyError, match=key):
        ClosedForm(parameters=2, contexts=1, **others)
