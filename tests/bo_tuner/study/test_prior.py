"""What is believed of the best values of parameters."""

import numpy as np
import pytest
from scipy.stats import truncnorm

import bo_tuner as bt
from bo_tuner.acquisition.acquisition import LEAST_BELIEF, Acquisition, WithPrior
from bo_tuner.errors import StudyError
from bo_tuner.methods.registry import METHODS, problem_of
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.search_space import SearchSpace


def parameter(name="k", **given):
    return Parameter(
        name=name, **{"type": "double", "bounds": [1.0, 10.0], "default": 5.0, **given}
    )


def believed(space, values):
    return space.log_prior(space.cube_of({"k": value} for value in values))


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_number_within_a_deviation(scale):
    """Whatever the scale: SciPy's truncated normal, relative to where it is largest."""
    space = SearchSpace([parameter(prior={"around": 2.0, "within": 1.5}, scale=scale)])
    values = np.array([1.0, 2.0, 3.5, 9.0])
    expected = truncnorm(-1.0 / 1.5, 8.0 / 1.5, 2.0, 1.5).logpdf(values)
    assert believed(space, values) == pytest.approx(expected - expected[1])


def test_a_factor_is_a_deviation_of_the_logarithm():
    space = SearchSpace([parameter(prior={"around": 2.0, "within": "1.5x"})])
    found = believed(space, [2.0, 3.0, 2.0 / 1.5, 4.5])
    assert found == pytest.approx([0.0, -0.5, -0.5, -2.0])


def test_what_is_not_active_counts_as_uniform():
    mode = Parameter(name="mode", type="boolean", default=False)
    prior = {"around": 2.0, "within": 1.5}
    space = SearchSpace([mode, parameter(prior=prior, when={"mode": True})])
    absent = space.log_prior(space.to_cube({"mode": False})[None])[0]
    # Over the range, the density has the mean that a uniform one has.
    values = np.linspace(1.0, 10.0, 2001)
    sets = space.cube_of({"mode": True, "k": value} for value in values)
    assert np.exp(space.log_prior(sets)).mean() == pytest.approx(np.exp(absent), rel=1e-3)


def test_of_one_that_an_equality_eliminates():
    a, b = (parameter(n, bounds=[0, 1], default=0.5) for n in "ab")
    c = parameter("c", bounds=[0, 1], default=0.0, prior={"around": 0.5, "within": 0.25})
    space = SearchSpace([a, b, c], where=["a + b + c == 1"])
    points = space.cube_of([{"a": 0.25, "b": 0.25}, {"a": 0.5, "b": 0.25}])
    assert space.log_prior(points) == pytest.approx([0.0, -0.5])


def test_the_acquisition_is_the_product_of_the_paper():
    """Hvarfner et al. (2022, Eq. 6): α π^(β/n)."""
    x = np.linspace(0.0, 1.0, 11)[:, None]
    rule = WithPrior(
        lambda *_, **__: Acquisition(lambda x: np.log1p(x[:, 0])),
        lambda x: -8.0 * x[:, 0] ** 2,
        0.25,
    )
    made = rule(None, 0.0, avoid=0.5, reinterpolate=True)
    expected = (1.0 + x[:, 0]) * np.exp(-8.0 * x[:, 0] ** 2) ** 0.25
    assert np.exp(made(x)) == pytest.approx(expected)
    far = WithPrior(rule.rule, lambda x: np.full(len(x), -1e4), 1.0)
    assert far(None, 0.0, avoid=0.5, reinterpolate=True)(x[:1]) == pytest.approx(
        [np.log(LEAST_BELIEF)]
    )


HARTMANN = {
    "alpha": np.array([1.0, 1.2, 3.0, 3.2]),
    "a": np.array([[3, 10, 30], [0.1, 10, 35], [3, 10, 30], [0.1, 10, 35]]),
    "p": 1e-4
    * np.array([[3689, 1170, 2673], [4699, 4387, 7470], [1091, 8732, 5547], [381, 5743, 8828]]),
}
LOWEST, AT = -3.86278, (0.114614, 0.555649, 0.852547)
"""Minimum of Hartmann's function of three variables (Surjanovic and Bingham 2013)."""
FAR = (0.8, 0.1, 0.25)


def hartmann(given, context, seed):
    x = np.array([given[name] for name in "xyz"])
    weights = np.exp(-(HARTMANN["a"] * (x - HARTMANN["p"]) ** 2).sum(axis=1))
    return {"cost": -float(HARTMANN["alpha"] @ weights)}


def study_of(around, seed=1, trials=13, **sections):
    priors = [None if around is None else {"around": at, "within": 0.1} for at in around or "xyz"]
    return bt.Study(
        name="belief",
        parameters={
            name: bt.Double(0.0, 1.0, default=0.5, prior=prior)
            for name, prior in zip("xyz", priors, strict=True)
        },
        metrics=["cost"],
        objective="cost",
        budget=bt.Budget(trials=trials, initial_trials=6, validation_draws=1),
        noise="none",
        seed=seed,
        **sections,
    )


def regret(around, trials, seeds):
    """Return the median, over seeds, of how far the best trial is from the minimum."""
    found = []
    for seed in seeds:
        result = study_of(around, seed, trials).optimize(hartmann, progress=False)
        found.append(result.trials()["mean.cost"].min() - LOWEST)
    return float(np.median(found))


def test_a_good_one_helps():
    """With the same initial design, after seven trials of the search."""
    assert regret(AT, 13, (1, 2, 3)) < 0.5 * regret(None, 13, (1, 2, 3))


@pytest.mark.slow
def test_a_misleading_one_is_recovered_from():
    """Whatever it holds for unlikely, what is much better there is found."""
    assert regret(FAR, 40, (1, 2, 3)) < 0.02


def test_other_methods_refuse_it_by_name():
    study = study_of(AT).checked
    assert not problem_of("boundary", study)
    for name in METHODS.keys() - {"boundary", "safe"}:
        assert problem_of(name, study) == (
            f"{name} has no use for a prior, and the study has one of 'x'; expected boundary"
        )
    limits = {"low": bt.Chance("cost", upper=0.0, probability=0.9)}
    safe = study_of(AT, constraints=limits, safe_search=True).checked
    assert problem_of("safe", safe).startswith("safe has no use for a prior")


def test_a_file_has_it(tmp_path):
    study = study_of(AT)
    path = tmp_path / "study.yaml"
    path.write_text(study.to_yaml())
    assert bt.Study.from_yaml(path) == study


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"prior": {"around": 20.0, "within": 1.0}},
            "prior.around: 20 lies outside the bounds [1.0, 10.0]",
        ),
        ({"prior": {"around": 2.0, "within": 0.0}}, "prior.within: expected above 0, found 0"),
        (
            {"prior": {"around": 2.0, "within": "0.5x"}},
            "prior.within: expected a number, or a factor above 1 such as 2x, found text '0.5x'",
        ),
        (
            {"prior": {"around": 2.0, "within": "2x"}, "bounds": [0.0, 10.0]},
            "prior.within: a factor needs bounds above 0",
        ),
        ({"prior": {"around": 2.0}}, "prior.within: missing"),
        (
            {"bounds": None, "choices": [1.0, 5.0], "prior": {"around": 2.0, "within": 1.0}},
            "prior: a parameter with choices has no prior; leave it out",
        ),
        (
            {"bounds": None, "default": None, "fixed": 2.0, "prior": {"around": 2.0, "within": 1}},
            "prior: a fixed parameter has no prior; leave it out",
        ),
    ],
)
def test_what_cannot_be(given, said):
    with pytest.raises(StudyError) as caught:
        parameter(**given)
    assert str(caught.value) == said
