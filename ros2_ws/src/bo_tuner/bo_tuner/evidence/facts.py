"""Facts about a result: small frozen objects with a subject and numbers, and no sentence.

`bo_tuner.evidence.words.facts` has one function for each kind.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from bo_tuner.evidence.certificate.findings import ConstraintVerdict, Failure, Refutation
from bo_tuner.evidence.differences import Difference
from bo_tuner.evidence.limit_verdict import LimitVerdict
from bo_tuner.evidence.reasons import Assumption
from bo_tuner.metrics.equal_runs import UnevenRate
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.measured import SeenRange
from bo_tuner.study.noiseless import Noisy
from bo_tuner.study.ranges import OutOfRange
from bo_tuner.study.study import Study
from bo_tuner.tuning.effects import ParameterEffects


class Fact:
    """Base of all kinds."""


@dataclass(frozen=True)
class Said(Fact):
    """What others say, in their own words, as a clause: a method, a node, a certificate's file."""

    text: str


@dataclass(frozen=True)
class Doubt(Said):
    """Why the method does not vouch for a parameter set."""


# What speaks against a parameter set.


@dataclass(frozen=True)
class AgainstLimit(Fact):
    """The test runs of a validation speak against a limit."""

    limit: LimitVerdict


@dataclass(frozen=True)
class WorstCaseOver(Fact):
    """The search of a trial found the default beyond a limit, with a value in the metric's unit."""

    constraint: Constraint
    title: str
    unit: str
    value: float
    trial: int


@dataclass(frozen=True)
class RunsFailed(Fact):
    """So many of the test runs failed."""

    failed: int
    runs: int


@dataclass(frozen=True)
class RunsLost(Fact):
    """So many of the test runs are unusable, for one reason or for several (empty)."""

    lost: int
    runs: int
    why: str


@dataclass(frozen=True)
class FirstFailure(Fact):
    """So many of the test runs of a certificate failed, and how the first did."""

    failed: int
    runs: int
    first: Failure


@dataclass(frozen=True)
class NotShown(Fact):
    """A certificate does not show a limit of this title."""

    title: str
    found: ConstraintVerdict


@dataclass(frozen=True)
class Contradiction(Fact):
    """Runs of a certificate contradict what the study declares, and how."""

    how: OutOfRange | Noisy


@dataclass(frozen=True)
class RefutedInRun(Fact):
    """So many runs of a tuning run, in so many contexts, refute a limit of this title."""

    title: str
    runs: int
    contexts: int


@dataclass(frozen=True)
class AllTrialsFailed(Fact):
    """Every trial of a run failed, for one reason or for several (empty)."""

    trials: int
    why: str


# On what a verdict rests.


@dataclass(frozen=True)
class Basis(Fact):
    """The fresh test runs that a verdict rests on, with drawn context and noise.

    Attributes
    ----------
    draws
        Their number.
    paired
        Whether the default was run with the same context and noise.
    validation
        Number of test runs of the validation, in which the default was run; None if nowhere.
    tuned_too
        Whether the tuned parameter set was run in those as well.
    """

    draws: int
    paired: bool = True
    validation: int | None = None
    tuned_too: bool = False


@dataclass(frozen=True)
class Progress(Fact):
    """How far a run without a result is, in trials; whether they are all that may be."""

    done: int
    planned: int
    spent: bool


@dataclass(frozen=True)
class ClaimedLimit:
    """A limit on single runs that a certificate shows, and how many of its runs are beyond it."""

    constraint: Constraint
    title: str
    over: int
    runs: int


@dataclass(frozen=True)
class Claim(Fact):
    """What a certificate that passed claims of a parameter set.

    Attributes
    ----------
    searched
        Whether a limit is claimed in every context, of which only those searched were run.
    limits
        The limits on single runs.
    conditions
        What it rests on that runs do not prove.
    """

    searched: bool = False
    limits: tuple[ClaimedLimit, ...] = ()
    conditions: tuple[Assumption, ...] = ()


NO_CLAIM = Claim()

# What else to know.


@dataclass(frozen=True)
class TrialsEnded(Fact):
    """The trials were ended before the budget was spent: the time was up, or somebody asked."""

    made: int
    planned: int
    time_up: bool


@dataclass(frozen=True)
class SearchStoodStill(Fact):
    """The search could not go on after so many trials, and why."""

    trials: int
    why: str


@dataclass(frozen=True)
class CertificateBegun(Fact):
    """An unfinished certificate has so many test runs on record."""

    runs: int


@dataclass(frozen=True)
class FailedBefore(Fact):
    """What a parameter set failed on before its certificate, and whether a PASS covers that."""

    refutation: Refutation
    reasons: tuple[Fact, ...]
    covered: bool


@dataclass(frozen=True)
class Seen(Fact):
    """What runs have seen of a measured context, in its unit."""

    title: str
    unit: str
    range: SeenRange


@dataclass(frozen=True)
class EvidenceMissing(Fact):
    """The evidence of an earlier certificate cannot be read, and why."""

    why: str


@dataclass(frozen=True)
class Confidence(Fact):
    """The confidence of each bound, and of all certificates of a run or, in a path, of values."""

    each: float
    together: float
    given: str


@dataclass(frozen=True)
class ApplyRefuses(Fact):
    """`apply` refuses a result that passed, and why."""

    why: str


@dataclass(frozen=True)
class ApplyWaits(Fact):
    """`apply` waits for the result of a run that has not ended."""


@dataclass(frozen=True)
class RunsToRepeat(Fact):
    """Lost test runs leave the verdict open."""


@dataclass(frozen=True)
class OnlyTimesOver(Fact):
    """Only measured times exceed limits, and how busy the nodes were is not known."""

    titles: tuple[str, ...]


@dataclass(frozen=True)
class ComputingTimes(Fact):
    """Limited times that are computing times."""

    titles: tuple[str, ...]


@dataclass(frozen=True)
class BetterSet:
    """A parameter set whose objective is better by the model.

    Attributes
    ----------
    trial, objective, feasibility
        Its trial, the objective in its unit, and the probability that it keeps all limits.
    shown
        Whether that is enough, and only runs to confirm it are missing.
    """

    trial: int
    objective: float
    feasibility: float
    shown: bool


@dataclass(frozen=True)
class PassedOver(Fact):
    """Better parameter sets that were not chosen; with several objectives better compromises."""

    title: str
    unit: str
    sets: tuple[BetterSet, ...]
    compromises: bool


@dataclass(frozen=True)
class Branch:
    """A branch of the search space, with its best trial within limits and the objective of that.

    Attributes
    ----------
    name, trials
        What it is called, and how many trials are in it.
    best, objective
        Number of the best trial, None if none is within limits, and its mean objective.
    """

    name: str
    trials: int
    best: int | None
    objective: float


@dataclass(frozen=True)
class Branches(Fact):
    """The best of each branch that was tried."""

    title: str
    unit: str
    branches: tuple[Branch, ...]


@dataclass(frozen=True)
class MetricBias:
    """How a metric differs between machine and simulation, in its unit."""

    title: str
    unit: str
    simulated: float
    difference: Difference


@dataclass(frozen=True)
class Biases(Fact):
    """How far the machine is from its simulation."""

    metrics: tuple[MetricBias, ...]


@dataclass(frozen=True)
class Contradicted(Fact):
    """A run contradicts what the study declares, and how."""

    how: OutOfRange | Noisy


@dataclass(frozen=True)
class NoLogarithm(Fact):
    """Runs failed as a metric with a logarithmic scale, of this key of the study, had none."""

    title: str
    key: str
    runs: int


@dataclass(frozen=True)
class Drift(Fact):
    """A metric changes with the order of runs that are alike.

    Attributes
    ----------
    title, whose
        The metric, and the name of the parameter set.
    runs
        Number of runs.
    in_scatter
        Whether its scatter changes, not its value.
    correlation, p_value
        Rank correlation with the order, and its p-value.
    """

    title: str
    whose: str
    runs: int
    in_scatter: bool
    correlation: float
    p_value: float


@dataclass(frozen=True)
class UnevenRates(Fact):
    """A signal comes less often in one run of a parameter set than in another.

    Others of these names do likewise.
    """

    first: UnevenRate
    others: tuple[str, ...] = ()


@dataclass(frozen=True)
class TwoKinds(Fact):
    """Runs of a parameter set are of two kinds.

    Attributes
    ----------
    metric, title, whose
        The metric in which they differ, what screens call it, and the name of the parameter set.
    above, below
        How many runs each kind has, and their median.
    needs_range
        Whether a limit on its mean needs the range of the metric.
    """

    metric: str
    title: str
    whose: str
    above: tuple[int, float]
    below: tuple[int, float]
    needs_range: bool


@dataclass(frozen=True)
class Effects(Fact):
    """What is known of the effects of the tuned parameters of a study."""

    study: Study
    parameters: Sequence[ParameterEffects]
