"""How many evaluations a certificate will probably take, by simulated ones.

What is known of a parameter set, its draws, and the estimate of a worst case with its noise, leaves
open how far it is from its limits. A margin is drawn from what is open (a posterior), runs with it
are simulated, and the tests of the certificate say after how many of them the limits are shown. The
range is that of eight in ten of the simulated certificates that pass. Of a limit of which nothing
is known, the margin is drawn from those that results usually have.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log, sqrt

import numpy as np
from scipy.special import betaincinv, ndtr

from bo_tuner.evidence.certificate.draws import least_draws
from bo_tuner.evidence.certificate.independent_search import (
    least_candidates,
    least_searched,
    most_candidates,
    most_searched,
)
from bo_tuner.evidence.certificate.limited_runs import declared_range, is_exact
from bo_tuner.evidence.certificate.store import required_draws
from bo_tuner.evidence.limit_proof import proof_of
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.bounded_means import log_wealth
from bo_tuner.numerics.sequential import log_evidence, log_mean_evidence, spent
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, WorstCase

SIMULATIONS = 100

ENDS = 0.1, 0.9
"""Of the range, as quantiles."""

USUAL_MARGINS = 0.3, 5.0
"""From a mean to its limit, in standard deviations of a run, of a result of which nothing is known;
each order of magnitude alike."""

USUAL_DEVIATIONS = 0.01, 0.2
"""Standard deviations of a run, in widths of the declared range, likewise."""

LEAST_KNOWN = 5
"""Runs behind an estimate, at least: models share those of other parameter sets."""


@dataclass(frozen=True)
class Outlook:
    """How many evaluations a certificate takes.

    Attributes
    ----------
    low, high
        Of a range that eight in ten of those that pass are in.
    """

    low: int
    high: int

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.low}" if self.low == self.high else f"{self.low} to {self.high}"


def outlook(
    study: Study,
    most: int,
    confidence: float,
    drawn: Sequence[Evaluation] = (),
    worst_cases: Mapping[str, WorstCase] | None = None,
) -> Outlook | None:
    """Return how many evaluations the certificate of a parameter set probably takes."""
    rng = np.random.default_rng(0)
    simulation = _Simulation(study, most, confidence, drawn, worst_cases or {}, rng)
    counts = [simulation.evaluations() for _ in range(SIMULATIONS)]
    passed = [count for count in counts if count is not None]
    if len(passed) < ENDS[0] * SIMULATIONS:
        return None
    low, high = np.quantile(passed, ENDS)
    return Outlook(round(low), round(high))


def probable_certificate(
    study: Study, worst_cases: Mapping[str, WorstCase] | None = None
) -> Outlook | None:
    """Return how many evaluations the first certificate probably takes, as `outlook`."""
    confidence = study.certificate.confidence
    draws = required_draws(study, confidence)
    return outlook(study, draws, spent(confidence, 1), worst_cases=worst_cases)


@dataclass(frozen=True)
class _Margin:
    """How far the values of a metric are from the limit.

    Attributes
    ----------
    deviations
        From mean to limit, in standard deviations of a run.
    deviation
        Standard deviation of a run, in the metric's unit.
    share
        Of the runs that are beyond the limit.
    """

    deviations: float
    deviation: float
    share: float


@dataclass(frozen=True)
class _Simulation:
    study: Study
    most: int
    confidence: float
    drawn: Sequence[Evaluation]
    worst_cases: Mapping[str, WorstCase]
    rng: np.random.Generator

    def evaluations(self) -> int | None:
        """Return how many evaluations a certificate takes; None if it does not pass."""
        draws, places = least_draws(self.study), 0
        for constraint in self.study.constraints.values():
            if constraint.rule.in_every_context:
                runs = self._in_contexts(constraint)
                places = max(places, runs or 0)
            else:
                runs = self._runs(constraint, self._of_draws(constraint))
                draws = max(draws, runs or 0)
            if runs is None:
                return None
        if not places:
            return draws
        space = self.study.context_space()
        searched = self.rng.integers(least_searched(space, 1), most_searched(space, 1) + 1)
        return draws + int(searched) + places

    def _in_contexts(self, constraint: Constraint) -> int | None:
        """Return the runs in all contexts that may be the worst; None if they do not show it."""
        worst = self._runs(constraint, self._of_worst(constraint))
        if worst is None or not self.study.contexts:
            return worst
        # None of the others may be as bad.
        declared = declared_range(self.study, constraint)
        exact = is_exact(self.study, constraint)
        fewest = 1 if exact else proof_of(constraint).fewest(declared, self.confidence)
        space = self.study.context_space()
        count = int(self.rng.integers(least_candidates(space), most_candidates(space) + 1))
        others = self.rng.integers(min(fewest, worst), worst + 1, size=count - 1)
        return worst + int(others.sum())

    def _runs(self, constraint: Constraint, margin: _Margin) -> int | None:
        """Return after how many runs with a margin a limit is shown; None if after none."""
        if is_exact(self.study, constraint):
            return 1
        if constraint.rule.on_runs:
            events = self.rng.random(self.most) < margin.share
            evidence = log_evidence(events, constraint.allowed)
        else:
            beyond = margin.deviation * (self.rng.standard_normal(self.most) - margin.deviations)
            declared = self.study.metrics[constraint.metric].range
            if declared is None:
                evidence = log_mean_evidence(beyond, 0.0)
                evidence[: proof_of(constraint).fewest(None, self.confidence) - 1] = 0.0
            else:
                ends = sorted(constraint.sign * (end - constraint.limit) for end in declared)
                evidence = log_wealth(np.clip(beyond, ends[0], ends[1]), 0.0, ends[1])
        reached = evidence >= log(1.0 / (1.0 - self.confidence))
        return int(np.argmax(reached)) + 1 if reached.any() else None

    def _of_draws(self, constraint: Constraint) -> _Margin:
        """Draw the margin of a limit over the contexts, by what the known draws leave open."""
        values = self._known(constraint)
        if not len(values):
            return self._usual(constraint)
        beyond = int(np.sum(constraint.violations(values)))
        share = self.rng.beta(beyond + 0.5, len(values) - beyond + 0.5)
        if len(values) < 2:
            return _Margin(0.0, 1.0, share)
        margin = constraint.sign * (constraint.limit - float(values.mean()))
        found = self._open(margin, float(values.std(ddof=1)), len(values))
        return _Margin(found.deviations, found.deviation, share)

    def _of_worst(self, constraint: Constraint) -> _Margin:
        """Draw the margin of a limit in the worst context, by its estimate."""
        estimate = self.worst_cases.get(constraint.name)
        if estimate is None or not estimate.noise > 0.0:
            return self._usual(constraint)
        margin = constraint.sign * (constraint.limit - estimate.value)
        return self._open(margin, estimate.noise, len(self.drawn))

    def _open(self, margin: float, deviation: float, count: int) -> _Margin:
        """Draw from the posterior of a normal mean and deviation, by so many runs."""
        count = max(count, LEAST_KNOWN)
        deviation *= sqrt((count - 1) / self.rng.chisquare(count - 1))
        margin += deviation * self.rng.standard_normal() / sqrt(count)
        deviations = margin / deviation if deviation > 0.0 else float(np.copysign(10.0, margin))
        return _Margin(deviations, deviation, float(ndtr(-deviations)))

    def _usual(self, constraint: Constraint) -> _Margin:
        """Draw the margin of a result that keeps the limit, and of which nothing else is known."""
        deviations, deviation = self._between(*USUAL_MARGINS), 1.0
        declared = self.study.metrics[constraint.metric].range
        if declared is not None:
            deviation = self._between(*USUAL_DEVIATIONS) * (declared[1] - declared[0])
        # By the prior of Jeffreys, up to what is allowed.
        allowed = constraint.allowed
        level = self.rng.random() * 2.0 / np.pi * np.arcsin(sqrt(allowed))
        return _Margin(deviations, deviation, float(betaincinv(0.5, 0.5, level)))

    def _between(self, low: float, high: float) -> float:
        return exp(self.rng.uniform(log(low), log(high)))

    def _known(self, constraint: Constraint) -> Array:
        complete = [e.outcome.metrics for e in self.drawn if e.outcome.complete]
        return np.array([metrics[constraint.metric] for metrics in complete])
