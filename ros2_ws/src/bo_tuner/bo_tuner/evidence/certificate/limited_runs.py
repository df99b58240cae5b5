"""Evaluations as runs of one limit: what of them counts for it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bo_tuner.evidence.certificate.findings import (
    Earlier,
    Evidence,
)
from bo_tuner.evidence.limit_proof import Runs
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation


def is_exact(study: Study, constraint: Constraint) -> bool:
    """Return whether one run decides if a limit is kept in its context, as there is no noise.

    Over contexts it takes draws, unless there is but one context.
    """
    return study.is_noiseless and (constraint.rule.in_every_context or not study.contexts)


def drawn_runs(
    study: Study, constraint: Constraint, drawn: Sequence[Evaluation], earlier: Earlier
) -> Runs:
    """Return draws as runs of which each stands for all contexts."""
    known = [*values_of(drawn, constraint.metric), *earlier.extremes.get(constraint.metric, ())]
    return replace(
        runs_of(constraint, drawn),
        farthest=constraint.farthest(known),
        declared=declared_range(study, constraint),
        exact=is_exact(study, constraint),
    )


def runs_in_context(
    study: Study, constraint: Constraint, evaluations: Sequence[Evaluation], evidence: Evidence
) -> Runs:
    """Return evaluations in one context as runs, with what is known of the parameter set."""
    exact = is_exact(study, constraint)
    if constraint.rule.on_runs:
        # Nothing else counts for a share of these.
        return replace(runs_of(constraint, evaluations), exact=exact)
    metric = constraint.metric
    own = values_of(evidence.evaluations, metric)
    # Earlier ones as well.
    known = [*own, *evidence.earlier.extremes.get(metric, ())]
    return replace(
        runs_of(constraint, evaluations),
        farthest=constraint.farthest(known),
        declared=declared_range(study, constraint),
        exact=exact,
    )


def runs_of(constraint: Constraint, evaluations: Sequence[Evaluation]) -> Runs:
    """Return evaluations as runs of a limit; nothing else is known beside them."""
    return Runs(_events(constraint, evaluations), values_of(evaluations, constraint.metric))


def _events(constraint: Constraint, evaluations: Sequence[Evaluation]) -> list[bool]:
    """Return whether each evaluation violates the limit or failed."""
    return [
        not e.outcome.complete or bool(constraint.violations(e.outcome.metrics[constraint.metric]))
        for e in evaluations
    ]


def values_of(evaluations: Sequence[Evaluation], metric: str) -> Array:
    """Return the values of a metric in the complete evaluations; shape (at most as many,)."""
    return np.array(
        [
            evaluation.outcome.metrics[metric]
            for evaluation in evaluations
            if evaluation.outcome.complete
        ]
    )


def declared_range(study: Study, constraint: Constraint) -> tuple[float, float] | None:
    """Return the declared range of the limited metric, if there is one."""
    return study.metrics[constraint.metric].range


def failed_runs(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Return the evaluations that are not complete."""
    return [e for e in evaluations if not e.outcome.complete]
