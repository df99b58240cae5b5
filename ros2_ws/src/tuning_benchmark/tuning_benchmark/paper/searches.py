"""Stage two of the Algorithms I to V."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.methods.searches import ModelSearch, SearchRule
from bo_tuner.models.categories import Coding
from bo_tuner.models.observations import joint_observations
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.base import Proposal
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.context_space import ContextSpace
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Trial, TrialState, WorstCase
from tuning_benchmark.paper.joint_search import JointSearch
from tuning_benchmark.paper.reinterpolation_search import OBSERVED, POSTERIOR, ReinterpolationSearch

DISTINCT = 0.1
"""Contexts closer than this in every coordinate of the unit cube count as equal."""


@dataclass(frozen=True)
class EachTrial(SearchRule):
    """A search in each trial that begins without data of its own (Sec. 4.2).

    Attributes
    ----------
    estimate
        Of the worst case: ``posterior``, the largest posterior mean over all contexts, or
        ``observed``, the largest observation.
    neighbour_starts
        Largest number of starting contexts, which are the worst contexts of neighbouring trials.
    """

    estimate: str = POSTERIOR
    neighbour_starts: int = 2

    def __call__(
        self,
        study: Study,
        constraint: Constraint,
        proposal: Proposal,
        trials: Sequence[Trial],
        evaluations: int,
    ) -> ReinterpolationSearch:
        """Make the search for one constraint."""
        contexts, space = study.context_space(), study.search_space()
        coding = Coding(space.levels)
        name = constraint.name
        known = [(t.parameters, t.worst_cases[name]) for t in trials if name in t.worst_cases]
        return ReinterpolationSearch(
            contexts,
            constraint.sign * constraint.limit,
            evaluations,
            self.estimate,
            worst_contexts_nearby(
                coding.encode(space.to_cube(proposal.parameters)[None])[0],
                coding.encode(space.cube_of(p for p, _ in known)),
                [worst for _, worst in known],
                contexts,
                self.neighbour_starts,
            ),
        )


@dataclass(frozen=True)
class NoSearch(SearchRule):
    """No search: the worst case is the largest observation, of the nominal context."""

    def __call__(
        self,
        study: Study,
        constraint: Constraint,
        proposal: Proposal,
        trials: Sequence[Trial],
        evaluations: int,
    ) -> ReinterpolationSearch:
        """Make a search that asks for nothing."""
        limit = constraint.sign * constraint.limit
        return ReinterpolationSearch(study.context_space(), limit, 0, OBSERVED)

    def refusal(self, unsearched: Sequence[str]) -> str:
        """Refuse nothing."""
        return ""


@dataclass(frozen=True)
class Joint(ModelSearch):
    """A search by a joint model of parameter set and context (Algorithm V)."""

    def __call__(
        self,
        study: Study,
        constraint: Constraint,
        proposal: Proposal,
        trials: Sequence[Trial],
        evaluations: int,
    ) -> JointSearch:
        """Make the search for one constraint."""
        contexts, space = study.context_space(), study.search_space()
        coding = Coding(space.levels)
        kept = [
            t
            for t in trials
            if t.state is TrialState.COMPLETE and t.number not in proposal.outliers
        ]
        points = space.cube_of(t.parameters for t in kept)
        x, c, y = joint_observations(points, contexts, kept, constraint.metric)
        return JointSearch(
            contexts,
            constraint.sign * constraint.limit,
            constraint.level,
            evaluations,
            coding.encode(space.to_cube(proposal.parameters)[None])[0],
            coding.encode(np.hstack([x, c])),
            constraint.sign * y,
            proposal.hyperparameters.get(constraint.name) or None,
        )


def worst_contexts_nearby(
    point: Array,
    tried: Array,
    worst_cases: Sequence[WorstCase],
    space: ContextSpace,
    count: int,
) -> list[Context]:
    """Return the worst contexts of the nearest parameter sets, without duplicates.

    Parameters
    ----------
    point
        Parameter set (d,) in the unit cube.
    tried
        Parameter sets (n, d) with a known worst case.
    worst_cases
        Worst cases of the n parameter sets.
    space
        The context space.
    count
        Largest number of contexts; they are taken from 1.5 times as many neighbours.
    """
    if space.dimension == 0:
        return []
    chosen: list[Context] = []
    nearest = np.argsort(((tried - point) ** 2).sum(axis=1), kind="stable")
    for index in nearest[: count + (count + 1) // 2]:
        candidate = worst_cases[int(index)].context
        if all(_distance(candidate, other, space) > DISTINCT for other in chosen):
            chosen.append(candidate)
    return [dict(context) for context in chosen[:count]]


def _distance(a: Context, b: Context, space: ContextSpace) -> float:
    rows = space.cube_of([a, b])
    return float(np.abs(rows[0] - rows[1]).max())
