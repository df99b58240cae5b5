"""Covariates of contexts: their number, and expectations of 0 by many draws."""

import numpy as np
import pytest

from bo_tuner.evidence.context_covariates import covariates
from bo_tuner.evidence.observed import Observed
from bo_tuner.evidence.quantities import quantities
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Beta, Discrete, TruncatedNormal, Uniform

UNIFORM = Uniform(bounds=(0.0, 4.0))


def space(*items, integers=()):
    return ContextSpace({f"w{k}": item for k, item in enumerate(items)}, integers)


def drawn(of, count, seed=1):
    rows = of.draw(count, np.random.default_rng(seed))
    return [of.to_dict(row) for row in rows]


@pytest.mark.parametrize(
    ("of", "count", "columns"),
    [
        # u, u², u³; from 20 draws on, with one for each five.
        (space(UNIFORM), 25, 3),
        (space(UNIFORM), 20, 3),
        (space(UNIFORM), 19, 0),
        # Squares and the product.
        (space(UNIFORM, UNIFORM), 25, 5),
        (space(UNIFORM, UNIFORM), 20, 2),
        (space(UNIFORM, UNIFORM), 45, 9),
        (space(*[UNIFORM] * 4), 25, 4),
        (space(*[UNIFORM] * 6), 25, 0),
        # Two values have one difference, three texts have two.
        (space(Discrete(values=(1.0, 2.0))), 100, 1),
        (space(Discrete(values=("ice", "sand", "mud"))), 100, 2),
        (space(), 25, 0),
        (space(UNIFORM), 0, 0),
        (space(*[UNIFORM] * 40), 200, 40),
    ],
)
def test_their_number_follows_from_draws_and_variables(of, count, columns):
    assert covariates(of, drawn(of, count)).shape == (count, columns)


@pytest.mark.parametrize(
    "of",
    [
        space(UNIFORM, TruncatedNormal(bounds=(0.0, 1.0), mean=0.9, standard_deviation=0.3)),
        space(Beta(bounds=(0.0, 1.0), a=1.0, b=3.0), Discrete(values=("ice", "sand", "mud"))),
        space(Uniform(bounds=(0.0, 5.0)), Discrete(values=(False, True)), integers=("w0",)),
    ],
)
def test_each_has_an_expectation_of_0(of):
    found = covariates(of, drawn(of, 100_000))
    errors = found.std(axis=0) / np.sqrt(len(found))
    assert found.shape[1] >= 3
    assert (np.abs(found.mean(axis=0)) < 4.5 * errors).all()


def observed(study, offset):
    """25 draws of a metric of which the context explains all but 10 % of the variance."""
    of, rng = study.context_space(), np.random.default_rng(8)
    contexts = drawn(of, 25)
    load = of.rows(contexts)[:, 0]
    error = offset * (load / load.std() + rng.standard_normal(25) / 3.0)
    metrics = [{"error": float(value), "peak": 0.0} for value in error]
    return Observed(dict(enumerate(metrics)), 25, contexts=dict(enumerate(contexts)))


def test_a_difference_that_the_context_explains_has_a_narrow_interval(make_study):
    """Half widths of 1.96 / √25 and a third of that, in standard deviations, about."""
    study = make_study(constraints={})
    default, tuned = observed(study, 2.0), observed(study, 3.0)
    (error,) = [q for q in quantities(study, default, tuned, {}, {}, {}) if q.metric == "error"]
    half = 0.5 * (error.difference.high - error.difference.low)
    assert 0.08 < half < 0.22
    assert error.tuned - error.default == pytest.approx(error.difference.mean)
    known = error.default
    # Where draws failed, the contexts of the others are no sample of their distribution.
    fewer = {k: m for k, m in tuned.drawn.items() if k}
    failed = Observed(fewer, 25, contexts=tuned.contexts)
    (error,) = [q for q in quantities(study, default, failed, {}, {}, {}) if q.metric == "error"]
    assert 0.3 < 0.5 * (error.difference.high - error.difference.low) < 0.6
    # What the other set did is no matter of the default's own draws.
    assert error.default == known
    assert [estimate.adjusted for estimate in error.estimates] == [True, False]
