"""Stage two with ask and tell, on functions whose worst context is known."""

import numpy as np
import pytest

from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Discrete, TruncatedNormal, Uniform
from bo_tuner.trials import WorstCase
from tuning_benchmark.paper.reinterpolation_search import OBSERVED, POSTERIOR, ReinterpolationSearch
from tuning_benchmark.paper.searches import worst_contexts_nearby

LOAD = TruncatedNormal(mean=1.0, standard_deviation=0.2, bounds=(0.7, 1.3))
DRAWN = 5


@pytest.fixture
def plane():
    return ContextSpace({"a": LOAD, "b": Uniform(bounds=(10.0, 20.0))})


def corner(context):
    """Largest, 2, at a = 1.3 and b = 10, with some curvature."""
    a, b = (context["a"] - 0.7) / 0.6, (context["b"] - 10.0) / 10.0
    return a**2 + (1.0 - b) + 0.2 * np.sin(3 * a * b)


def search(space, function, *, seed=0, limit=np.inf, evaluations=10, noise=0.0, **options):
    """Run a search; returns it and the contexts that it asked for."""
    rng = np.random.default_rng(seed)
    found = ReinterpolationSearch(space, limit, evaluations, **options)
    for row in space.draw(DRAWN, rng):
        context = space.to_dict(row)
        found.tell(context, function(context) + noise * rng.normal())
    asked = []
    while not found.done(rng):
        asked.append(found.ask(rng))
        found.tell(asked[-1], function(asked[-1]) + noise * rng.normal())
    return found, asked


class TestSearch:
    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("estimate", [OBSERVED, POSTERIOR])
    def test_finds_a_corner(self, plane, seed, estimate):
        found, asked = search(plane, corner, seed=seed, estimate=estimate)
        worst = found.worst_case(np.random.default_rng(0))
        assert len(asked) == 10
        assert worst.value == pytest.approx(2.0, abs=0.05)
        assert worst.observed == pytest.approx(2.0, abs=0.02)
        assert worst.context["a"] == pytest.approx(1.3, abs=0.06)
        assert worst.context["b"] == pytest.approx(10.0, abs=1.0)

    def test_finds_an_inner_maximum(self, plane):
        def hill(context):
            return float(
                np.exp(-10 * ((context["a"] - 0.85) ** 2 + (context["b"] / 10 - 1.7) ** 2))
            )

        found, _ = search(plane, hill)
        assert found.worst_case(np.random.default_rng(0)).value == pytest.approx(1.0, abs=0.05)

    @pytest.mark.parametrize("seed", range(4))
    def test_noise_is_not_taken_for_the_worst(self, plane, seed):
        """The posterior is nearer to the true worst case than the largest noisy value."""
        found, _ = search(plane, corner, seed=seed, noise=0.2)
        worst = found.worst_case(np.random.default_rng(0))
        assert worst.value == pytest.approx(2.0, abs=0.3)
        assert worst.value < worst.observed

    def test_in_one_dimension(self):
        space = ContextSpace({"a": LOAD})
        found, _ = search(space, lambda c: c["a"], evaluations=4)
        assert found.worst_case(np.random.default_rng(0)).value == pytest.approx(1.3, abs=0.02)

    def test_in_six_dimensions(self):
        space = ContextSpace({f"c{k}": LOAD for k in range(6)})
        found, _ = search(space, lambda c: sum(c.values()), evaluations=6)
        assert found.worst_case(np.random.default_rng(0)).observed > 6 * 1.2

    def test_discrete_contexts_keep_to_their_values(self):
        space = ContextSpace(
            {"tool": Discrete(values=(1.0, 2.0, 5.0), probabilities=(0.5, 0.3, 0.2)), "a": LOAD}
        )
        found, asked = search(space, lambda c: c["tool"] + c["a"])
        assert {context["tool"] for context in asked} <= {1.0, 2.0, 5.0}
        worst = found.worst_case(np.random.default_rng(0))
        assert worst.context["tool"] == 5.0

    def test_contexts_stay_in_their_box(self, plane):
        _, asked = search(plane, corner, evaluations=15)
        rows = np.array([[c["a"], c["b"]] for c in asked])
        assert np.all((rows >= [0.7, 10.0]) & (rows <= [1.3, 20.0]))

    def test_the_same_generators_give_the_same_search(self, plane):
        first, second = (search(plane, corner, noise=0.1)[1] for _ in range(2))
        assert first == second


class TestEnd:
    def test_no_evaluations_left(self, plane):
        _, asked = search(plane, corner, evaluations=3)
        assert len(asked) == 3

    def test_none_wanted(self, plane):
        found, asked = search(plane, corner, evaluations=0)
        assert asked == []
        drawn = [corner(plane.to_dict(row)) for row in plane.draw(DRAWN, np.random.default_rng(0))]
        worst = found.worst_case(np.random.default_rng(0))
        assert worst.observed == max(drawn)
        assert max(drawn) <= worst.value < 2.0

    @pytest.mark.parametrize("estimate", [OBSERVED, POSTERIOR])
    def test_at_a_violation(self, plane, estimate):
        found, asked = search(plane, corner, limit=1.5, estimate=estimate)
        assert len(asked) < 10
        assert found.worst_case(np.random.default_rng(0)).observed > 1.5

    @pytest.mark.parametrize("estimate", [OBSERVED, POSTERIOR])
    def test_before_it_begins(self, plane, estimate):
        _, asked = search(plane, corner, limit=-1.0, estimate=estimate)
        assert asked == []

    def test_the_limit_itself_is_no_violation(self, plane):
        _, asked = search(plane, lambda _: 1.0, limit=1.0, evaluations=4)
        assert len(asked) == 4

    def test_one_noisy_value_is_no_violation_for_the_posterior(self, plane):
        rng = np.random.default_rng(0)
        found = ReinterpolationSearch(plane, 1.0, 10, POSTERIOR)
        contexts = plane.draw(12, rng)
        for k, row in enumerate(contexts):
            found.tell(plane.to_dict(row), 1.02 if k == 3 else 0.5 + 0.1 * rng.normal())
        assert not found.done(rng)


class TestPoorData:
    def test_no_contexts(self):
        space = ContextSpace({})
        found, asked = search(space, lambda _: 0.5)
        assert asked == []
        worst = found.worst_case(np.random.default_rng(0))
        assert worst == WorstCase(0.5, {}, 0.5, worst.noise)

    @pytest.mark.parametrize(
        ("estimate", "value", "noise"), [(POSTERIOR, 0.5, 0.2), (OBSERVED, 0.7, 0.0)]
    )
    def test_mean_and_noise_without_contexts(self, estimate, value, noise):
        found = ReinterpolationSearch(ContextSpace({}), 1.0, 10, estimate)
        for observed in (0.3, 0.7, 0.5):
            found.tell({}, observed)
        worst = found.worst_case(np.random.default_rng(0))
        assert worst == WorstCase(pytest.approx(value), {}, 0.7, pytest.approx(noise))

    @pytest.mark.parametrize("value", [0.0, 0.5, -1e6, 1e-300])
    def test_constant(self, plane, value):
        found, asked = search(plane, lambda _: value)
        assert found.worst_case(np.random.default_rng(0)).value == pytest.approx(value)
        assert len({tuple(context.values()) for context in asked}) == len(asked)

    @pytest.mark.parametrize("noise", [0.0, 0.1])
    def test_equal_contexts(self, plane, noise):
        rng = np.random.default_rng(0)
        found = ReinterpolationSearch(plane, np.inf, 3)
        for _ in range(5):
            found.tell({"a": 1.0, "b": 15.0}, 1.0 + noise * rng.normal())
        while not found.done(rng):
            context = found.ask(rng)
            found.tell(context, corner(context))
        assert np.isfinite(found.worst_case(rng).value)

    def test_one_context(self, plane):
        rng = np.random.default_rng(0)
        found = ReinterpolationSearch(plane, np.inf, 2)
        found.tell({"a": 1.0, "b": 15.0}, 1.0)
        assert found.ask(rng) != {"a": 1.0, "b": 15.0}


class TestStarts:
    def test_are_asked_first(self, plane):
        starts = [{"a": 0.75, "b": 12.0}, {"a": 1.25, "b": 19.0}]
        _, asked = search(plane, corner, evaluations=4, starts=starts)
        assert asked[:2] == starts
        assert len(asked) == 4

    def test_never_more_than_the_evaluations(self, plane):
        starts = [{"a": 0.75, "b": 12.0}] * 3
        _, asked = search(plane, corner, evaluations=2, starts=starts)
        assert len(asked) == 2

    def nearby(self, space, point, count):
        tried = np.array([[0.0, 0.0], [0.5, 0.5], [0.6, 0.6], [1.0, 1.0]])
        contexts = [{"a": a, "b": 15.0} for a in (0.7, 1.0, 1.01, 1.3)]
        worst = [WorstCase(1.0, context, 1.0) for context in contexts]
        found = worst_contexts_nearby(np.array(point), tried, worst, space, count)
        return [context["a"] for context in found]

    def test_come_from_the_nearest_and_differ(self, plane):
        assert self.nearby(plane, [0.1, 0.0], 1) == [0.7]
        # 1.0 and 1.01 count as one; of two that are equally near, the earlier comes first.
        assert self.nearby(plane, [0.5, 0.5], 2) == [1.0, 0.7]
        assert self.nearby(plane, [0.5, 0.5], 0) == []

    def test_nothing_tried_yet(self, plane):
        assert worst_contexts_nearby(np.zeros(2), np.empty((0, 2)), [], plane, 2) == []

    def test_no_contexts(self):
        worst = [WorstCase(1.0, {}, 1.0)] * 2
        assert (
            worst_contexts_nearby(np.zeros(1), np.zeros((2, 1)), worst, ContextSpace({}), 2) == []
        )
