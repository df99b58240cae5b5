"""The search of a certificate finds worst contexts that draws and stage two may miss."""

import itertools
import math

import numpy as np
import pytest

from bo_tuner.evidence.certificate.independent_search import (
    APART,
    DISTINCT,
    EVALUATIONS_A_ROUND,
    ROUNDS,
    SPREAD_EVALUATIONS,
    find_worst_contexts,
    most_candidates,
    most_searched,
)
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.distributions import Discrete, TruncatedNormal, Uniform

FACTOR = TruncatedNormal(mean=1.0, standard_deviation=0.2, bounds=(0.7, 1.3))
PLANE = ContextSpace({"stiffness": FACTOR, "damping": FACTOR})


OPEN = math.nan
"""A limit of which it is never clear whether it is kept, so that the search is a whole one."""


class Metric:
    """A function of the context with noise; counts its calls."""

    def __init__(self, function, noise=0.0):
        self.function = function
        self.noise = noise
        self.rng = np.random.default_rng(9)
        self.calls = []

    def __call__(self, context):
        self.calls.append(dict(context))
        return float(self.function(**context) + self.noise * self.rng.standard_normal())


def found_in(space, metric, *arguments):
    """What the search finds; a metric that is None is that of an evaluation that failed."""
    searching, values = find_worst_contexts(space, *arguments), None
    while True:
        try:
            contexts = searching.send(values)
        except StopIteration as end:
            return end.value
        values = [metric(context) for context in contexts]


def search(space, metric, draws=50, known=(), limit=OPEN):
    rng = np.random.default_rng(5)
    drawn = [space.to_dict(row) for row in space.draw(draws, rng)]
    seen = [(context, metric.function(**context)) for context in drawn]
    return found_in(space, metric, seen, known, limit, rng)


def bump(stiffness, damping, at, width):
    return math.exp(-0.5 * ((stiffness - at[0]) ** 2 + (damping - at[1]) ** 2) / width**2)


class TestSearch:
    @pytest.mark.parametrize("corner", [(0.7, 1.3), (1.3, 1.3)])
    def test_a_corner(self, corner):
        metric = Metric(lambda stiffness, damping: bump(stiffness, damping, corner, 0.2), 0.05)
        found = search(PLANE, metric)
        assert max(abs(found[0][n] - c) for n, c in zip(PLANE.names, corner, strict=True)) < 0.06

    def test_inside_beside_a_lower_maximum_in_a_corner(self):
        """The corner draws all searches that start there; the rounds lead to the other maximum."""
        found = []
        for seed in range(8):
            rng = np.random.default_rng(seed)
            at = rng.uniform(0.8, 1.2, 2)

            def function(stiffness, damping, at=at):
                other = 0.6 * bump(stiffness, damping, (0.7, 0.7), 0.09)
                return bump(stiffness, damping, at, 0.08) + other

            contexts = found_in(PLANE, Metric(function, 0.02), [], [], OPEN, rng)
            found.append(max(function(**context) for context in contexts))
        assert sum(value > 0.9 for value in found) >= 7

    def test_a_round_looks_at_other_contexts_than_the_one_maximum(self):
        """On a plane that is the same corner in each round."""
        metric = Metric(lambda stiffness, damping: stiffness + damping, 0.01)
        search(PLANE, metric)
        rounds = PLANE.to_cube([list(c.values()) for c in metric.calls[4 + SPREAD_EVALUATIONS :]])
        assert len(rounds) == ROUNDS * EVALUATIONS_A_ROUND
        for k in range(0, len(rounds), EVALUATIONS_A_ROUND):
            together = rounds[k : k + EVALUATIONS_A_ROUND]
            for one, other in itertools.combinations(together, 2):
                assert np.abs(one - other).max() > DISTINCT

    def test_a_corner_beside_the_maximum_of_the_model(self):
        """Which of the two is the worse one takes more than a smooth model to tell."""

        def function(stiffness, damping):
            return -((stiffness - 1.26) ** 2) + 2.0 * (1.3 - damping)

        found = search(PLANE, Metric(function, 0.01))
        assert {"stiffness": pytest.approx(1.3), "damping": pytest.approx(0.7)} in found

    def test_what_somebody_else_suspects_is_a_candidate(self):
        suspected = {"stiffness": 0.93, "damping": 1.11}
        metric = Metric(lambda stiffness, damping: stiffness)
        found = search(PLANE, metric, known=[suspected])
        assert any(
            all(math.isclose(context[n], v) for n, v in suspected.items()) for context in found
        )
        assert suspected in [{k: pytest.approx(v) for k, v in c.items()} for c in metric.calls]

    def test_the_largest_draw_is_a_candidate(self):
        """Also beyond those that join the model."""
        spike = {"stiffness": 1.0001, "damping": 0.9999}
        line = np.linspace(0.7, 1.3, 200).tolist()
        drawn = [({"stiffness": value, "damping": 1.0}, 0.0) for value in line] + [(spike, 5.0)]
        rng = np.random.default_rng(1)
        found = found_in(PLANE, lambda _: 0.0, drawn, [], OPEN, rng)
        assert any(math.dist(c.values(), spike.values()) < 1e-9 for c in found)

    def test_candidates_are_different_and_few(self):
        found = search(PLANE, Metric(lambda stiffness, damping: stiffness - damping, 0.1))
        assert 1 < len(found) <= most_candidates(PLANE)
        points = PLANE.to_cube([list(context.values()) for context in found])
        for one, other in itertools.combinations(points, 2):
            assert np.abs(one - other).max() > APART

    def test_no_more_evaluations_than_promised(self):
        metric = Metric(lambda stiffness, damping: math.sin(20 * stiffness) * damping)
        search(PLANE, metric, known=[{"stiffness": 1.0, "damping": 1.0}])
        assert len(metric.calls) <= most_searched(PLANE, 1)

    def test_discrete_contexts_stay_possible(self):
        tool = Discrete(values=(1.0, 2.0, 5.0), probabilities=(0.5, 0.3, 0.2))
        space = ContextSpace({"tool": tool, "load": Uniform(bounds=(0.0, 1.0))})
        metric = Metric(lambda tool, load: -((tool - 2.0) ** 2) + load)
        found = search(space, metric)
        assert {call["tool"] for call in metric.calls} <= set(tool.values)
        assert found[0] == {"tool": 2.0, "load": pytest.approx(1.0, abs=0.06)}

    def test_nothing_varies(self):
        assert found_in(
            ContextSpace({}), lambda _: 1.0, [({}, 1.0)], [{}], OPEN, np.random.default_rng(0)
        ) == [{}]
        assert most_searched(ContextSpace({}), 1) == 0

    def test_every_evaluation_fails(self):
        found = found_in(PLANE, lambda _: None, [], [], OPEN, np.random.default_rng(0))
        corners = [list(context.values()) for context in found]
        assert sorted(corners) == [[0.7, 0.7], [0.7, 1.3], [1.3, 0.7], [1.3, 1.3]]


class TestEnd:
    """The metric rises from 0 to 1 along the diagonal, with a noise of 0.05."""

    def calls(self, limit):
        metric = Metric(lambda stiffness, damping: (stiffness + damping - 1.4) / 1.2, 0.05)
        rng = np.random.default_rng(5)
        contexts = [PLANE.to_dict(row) for row in PLANE.draw(50, rng)]
        drawn = [(context, metric(context)) for context in contexts]
        metric.calls.clear()
        known = [{"stiffness": 1.0, "damping": 1.0}]
        found = found_in(PLANE, metric, drawn, known, limit, rng)
        assert found[0] == {"stiffness": pytest.approx(1.3), "damping": pytest.approx(1.3)}
        return len(metric.calls)

    def test_a_clear_violation_ends_it_after_the_corners(self):
        assert self.calls(0.5) == 1 + 4

    def test_a_limit_clearly_kept_ends_it_after_the_first_round(self):
        before = 1 + 4 + SPREAD_EVALUATIONS
        assert before < self.calls(2.0) <= before + EVALUATIONS_A_ROUND

    @pytest.mark.parametrize("limit", [0.98, 1.08])
    def test_a_limit_near_the_worst_case_takes_a_whole_search(self, limit):
        """Two standard deviations of a run may be luck, in a context that nobody looked at."""
        assert self.calls(limit) > self.calls(2.0)
