"""What `check` finds of a study, as facts: of its nodes, of equal runs of the default, of times.

`bo_tuner.metrics.equal_runs` and `bo_tuner.study.sizing` have more of them.
`bo_tuner.evidence.words.check` has one function for each kind.
"""

from dataclasses import dataclass

from bo_tuner.evidence.certificate.outlook import Outlook
from bo_tuner.run_notes import Published
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from bo_tuner.tuning.effects import ParameterEffects

# Of the nodes.


@dataclass(frozen=True)
class NodesMatch:
    """The nodes match the study, which has so many parameters and signals."""

    parameters: int
    signals: int


@dataclass(frozen=True)
class OtherClock:
    """A node uses simulated time, or not, and the clock of the run is the other one."""

    node: str
    simulated: bool
    clock: str


@dataclass(frozen=True)
class OtherValue:
    """A node has another value of a parameter now than the study's default."""

    parameter: str
    now: object
    default: Value


@dataclass(frozen=True)
class NothingStarts:
    """Nothing sends a reference when a run starts."""


# Of equal runs of the default.


@dataclass(frozen=True)
class RunFailed:
    """A run failed, by its number from 1, and why."""

    number: int
    why: str


@dataclass(frozen=True)
class RunRemark:
    """What is remarked of a run, by its number from 1."""

    number: int
    remark: str


@dataclass(frozen=True)
class Streamed:
    """How the messages of a reference were published on a topic in the last run."""

    topic: str
    published: Published


@dataclass(frozen=True)
class NothingMoves:
    """None of these signals changed in so many runs."""

    signals: tuple[str, ...]
    runs: int


@dataclass(frozen=True)
class KeepsValue:
    """A signal has one value in so many runs."""

    signal: str
    value: float
    runs: int


@dataclass(frozen=True)
class DefaultBeyond:
    """The default does not keep limits of a metric."""

    metric: str
    limits: tuple[Constraint, ...]
    unit: str


@dataclass(frozen=True)
class FarOff:
    """A limit is far from what the default reaches, so that one may be in another unit."""

    limit: Constraint
    unit: str
    reached: float


@dataclass(frozen=True)
class MeanWithoutRange:
    """A limit is on a mean, which no certificate proves without a range of the metric."""

    limit: Constraint


@dataclass(frozen=True)
class Spread:
    """A metric differs by so much between runs of the same parameters."""

    metric: str
    width: float


# Of each tuned parameter.


@dataclass(frozen=True)
class SetFailed:
    """So many runs of a parameter set failed, and why."""

    whose: str
    failed: int
    runs: int
    why: str


@dataclass(frozen=True)
class Absent:
    """Parameters that the default does not have, as their condition does not hold there."""

    parameters: tuple[str, ...]


@dataclass(frozen=True)
class NotTried:
    """Parameters that cannot be moved alone, over the whole range or in small steps."""

    parameters: tuple[str, ...]
    whole_range: bool


@dataclass(frozen=True)
class TooFewRuns:
    """Too few runs were completed to tell whether these parameters move a metric."""

    parameters: tuple[str, ...]


@dataclass(frozen=True)
class NotSeen:
    """A parameter was not seen to move any metric, with these values beside its default."""

    study: Study
    effects: ParameterEffects
    tried: tuple[Value, ...]
    default: Value


# Of times.


@dataclass(frozen=True)
class Ramp:
    """How long [s] a ramp takes, and how often in a test run; 0 for once a parameter set."""

    seconds: float
    in_a_run: int


@dataclass(frozen=True)
class Start:
    """What nodes take that get their values at a start.

    Attributes
    ----------
    seconds
        How long it took.
    started, configured
        Keys of the nodes that are started, and configured.
    each_run
        Whether for each test run, or once for each parameter set.
    """

    seconds: float
    started: tuple[str, ...]
    configured: tuple[str, ...]
    each_run: bool


@dataclass(frozen=True)
class CertificateTime:
    """How long a certificate takes.

    Attributes
    ----------
    probable, low, high
        Number of its test runs if the result passes by a usual margin, and the time [s] of the
        ends; None where nothing is known.
    least
        Its fewest test runs.
    most, seconds
        Its largest number of test runs, and their time [s].
    """

    probable: Outlook | None
    low: float
    high: float
    least: int
    most: int
    seconds: float


@dataclass(frozen=True)
class StudyTime:
    """How long a study takes, by test runs that were made.

    Attributes
    ----------
    of_run
        Time [s] of a test run alone.
    rested
        Time [s] that the machine rested ahead of one.
    ramp
        Of a run with ramps.
    warm_ups, warm_up
        Number of runs to warm up, and their time [s].
    with_default
        Whether the default is run beside each test run.
    start
        Of nodes that take values while they start.
    most, seconds
        Largest number of test runs of the study, and their time [s].
    drives
        Fewest drives that prove it; None of a study that plays no bags.
    certificate
        Of one that plays none.
    """

    of_run: float
    rested: float
    ramp: Ramp | None
    warm_ups: int
    warm_up: float
    with_default: bool
    start: Start | None
    most: int
    seconds: float
    drives: int | None
    certificate: CertificateTime | None
