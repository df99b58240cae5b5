"""Stage two of `boundary`, on a function whose worst context is known."""

import numpy as np
import pytest
from scipy.stats import norm

from bo_tuner.models.categories import Coding
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Uniform
from bo_tuner.worst_case.pooled_search import KnownRuns, PooledSearch

NOISE = 0.02
LIMIT = 2.5


def response(x, c):
    """Worst at c = 1, where it is 0.7 + x²; beyond x = 0.8 it explodes."""
    return 0.7 * c + x**2 + np.expm1(40.0 * np.maximum(x - 0.8, 0.0))


@pytest.fixture
def line():
    return ContextSpace({"c": Uniform(bounds=(0.0, 1.0))})


def pooled_search(line, x, *known, measured=None, deviations=0.0, evaluations=4, until_clear=False):
    return PooledSearch(
        line,
        np.array([x]),
        KnownRuns(*known, Coding((0,)), measured or {}),
        limit=LIMIT,
        deviations=deviations,
        evaluations=evaluations,
        models=PooledModels(),
        until_clear=until_clear,
    )


def searched(line, evaluations, *, exploded=0.0, until_clear=True):
    """A search at x = 0.5 after twelve runs, one of them at x = `exploded`."""
    rng = np.random.default_rng(1)
    x, c = rng.uniform(0.0, 0.75, (12, 1)), rng.random((12, 1))
    x[-1] = exploded
    y = response(x[:, 0], c[:, 0]) * (1.0 + NOISE * rng.standard_normal(12))
    search = pooled_search(line, 0.5, x, c, y, evaluations=evaluations, until_clear=until_clear)
    asked = []
    while not search.done(rng):
        context = search.ask(rng)
        asked.append(context["c"])
        value = response(0.5, context["c"]) * (1.0 + NOISE * rng.standard_normal())
        search.tell(context, value)
    return asked, search.worst_case(rng) if asked else None


def test_finds_the_worst_context(line):
    asked, worst = searched(line, 4, until_clear=False)
    assert len(asked) == 4
    assert worst.context["c"] == pytest.approx(1.0, abs=0.1)
    assert worst.value == pytest.approx(0.95, abs=0.05)
    assert worst.noise < 5 * NOISE


def test_ends_when_the_decision_is_clear(line):
    asked, _ = searched(line, 10)
    assert len(asked) < 10


def test_another_parameter_set_that_explodes_hides_nothing(line):
    """It is a thousand times the limit."""
    asked, worst = searched(line, 4, exploded=1.0, until_clear=False)
    assert response(1.0, 0.0) > 1000.0 * LIMIT
    assert np.max(asked) == pytest.approx(1.0, abs=0.1)
    assert worst.value == pytest.approx(0.95, abs=0.15)
    assert worst.value < LIMIT


def test_the_worst_case_of_runs_is_where_their_quantile_is(line):
    """The mean falls with c, from 0.2 to 0, where the noise is 0.3 rather than 0.01."""
    rng = np.random.default_rng(3)
    c = rng.random(200)
    y = 0.2 - 0.2 * c + np.where(c > 0.5, 0.3, 0.01) * rng.normal(size=200)
    contexts = []
    for deviations in (0.0, float(norm.ppf(0.95))):
        x = np.full((200, 1), 0.5)
        search = pooled_search(line, 0.5, x, c[:, None], y, deviations=deviations)
        search.tell({"c": 0.0}, 0.2)
        contexts.append(search.worst_case(np.random.default_rng(0)).context["c"])
    of_mean, of_runs = contexts
    assert of_mean < 0.5 < of_runs


def test_a_worst_case_that_explodes_is_in_the_unit_of_the_metric(line):
    rng = np.random.default_rng(2)
    x, c = rng.uniform(0.0, 0.75, (12, 1)), rng.random((12, 1))
    search = pooled_search(line, 1.0, x, c, response(x[:, 0], c[:, 0]))
    truth = response(1.0, 1.0)
    for value in (0.98 * truth, truth, 1.02 * truth):
        search.tell({"c": 1.0}, value)
    worst = search.worst_case(rng)
    assert worst.value == pytest.approx(truth, rel=0.1)
    assert worst.observed == pytest.approx(1.02 * truth)


def test_what_was_measured_is_no_noise_and_its_mean_counts(line):
    """y = c (0.5 + wind): at the worst c, 1, the mean over the wind is 1."""
    rng = np.random.default_rng(5)
    c, wind = rng.random((20, 1)), rng.random(20)
    x, y = np.full((20, 1), 0.5), c[:, 0] * (0.5 + wind)
    search = pooled_search(line, 0.5, x, c, y, measured={"wind": wind})
    for further in (0.1, 0.3, 0.7, 0.9):
        context = search.ask(rng)
        assert context.keys() == {"c"}
        search.tell({**context, "wind": further}, context["c"] * (0.5 + further))
    worst = search.worst_case(rng)
    assert worst.context == {"c": pytest.approx(1.0, abs=0.05)}
    assert worst.value == pytest.approx(0.5 + np.mean([*wind, 0.1, 0.3, 0.7, 0.9]), abs=0.03)


def test_the_first_trial_has_no_data_but_its_own(line):
    nothing = np.empty((0, 1))
    measured = {"wind": np.empty(0)}
    search = pooled_search(line, 0.5, nothing, nothing, np.empty(0), measured=measured)
    rng = np.random.default_rng(6)
    for c in (0.0, 0.5, 1.0):
        search.tell({"c": c, "wind": 0.4}, c)
    assert search.worst_case(rng).value == pytest.approx(1.0, abs=0.1)
