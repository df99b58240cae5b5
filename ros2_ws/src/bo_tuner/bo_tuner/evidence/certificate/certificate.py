"""A certificate: what it says, in memory and on disk."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.evidence.busy import HighLoad
from bo_tuner.evidence.certificate.context_tolerance import ContextTolerance
from bo_tuner.evidence.certificate.deaths import Deaths
from bo_tuner.evidence.certificate.findings import EarlierInBrief, Findings
from bo_tuner.evidence.certificate.parameter_sensitivity import ParameterSensitivity
from bo_tuner.evidence.certificate.search_width import SearchWidth
from bo_tuner.evidence.certificate.winners_curse import Gap
from bo_tuner.evidence.facts import Drift, TwoKinds, UnevenRates
from bo_tuner.evidence.verdict import FAIL, PASS
from bo_tuner.study.measured import SeenRange
from bo_tuner.study.study import Study
from bo_tuner.trials import DEFAULT, TUNED, Trial, Value


@dataclass(frozen=True)
class CertifiedObjective:
    """The metric whose mean over the draws a certificate gives, its unit, and its direction."""

    metric: str
    unit: str
    direction: str


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """The findings about a parameter set, with their provenance; as they are in its file.

    Attributes
    ----------
    study, study_sha256
        Name and digest of the study.
    trial
        Number of the trial with this parameter set.
    parameters_sha256
        Digest of the parameter set.
    held
        By the name of a parameter the value that a device has in place of one with more digits.
    seen
        By the name of a measured context what the evaluations of the parameter set have seen of it.
    best_yaml_sha256
        Digest of the ``best.yaml`` that holds it; None if that holds another trial's.
    evaluations_sha256
        Digest of the file with the evaluations.
    draws, confidence
        Largest number of draws, and the confidence over all attempts, as requested.
    drawn
        Number of draws that were made.
    attempt
        Number of the attempt to certify a parameter set of the run, from 1.
    bound_confidence
        Confidence of each bound: the share of this attempt and of one of its parameter sets.
    contexts, metrics
        Units of the contexts and metrics by their names, in the order of the columns of the
        evaluations.
    objective
        What the findings give the mean of.
    tuned, default
        Findings for the parameter set, and for the hand-tuned one if it was evaluated as well.
    earlier
        What was known of the parameter set before.
    search_widths
        Which widths of a violation its search would have found; empty without a search.
    training_gaps
        Training compared with validation.
    context_tolerances
        Robustness against the context, for each worst-case constraint of which it is known.
    parameter_sensitivity
        Robustness to steps in the parameters; None if not known.
    deaths
        How often a node died in runs that were made again; None if none is ignored.
    in_force
        How it is known that the parameters were in force on nodes of ROS, a line each.
    high_load
        Of limits on measured times that were not shown: runs in which the computer was busy.
    drifts, two_kinds, uneven
        Of runs that are alike: metrics that drift, those of which runs are of two kinds, and
        signals that come less often in one of them.
    provenance
        Versions, sources, machine, backend and seed.
    finished
        When it was made.
    """

    study: str
    study_sha256: str
    trial: int
    parameters_sha256: str
    held: Mapping[str, float]
    seen: Mapping[str, SeenRange]
    best_yaml_sha256: str | None
    evaluations_sha256: str
    draws: int
    drawn: int
    confidence: float
    attempt: int
    bound_confidence: float
    contexts: Mapping[str, str]
    metrics: Mapping[str, str]
    objective: CertifiedObjective
    tuned: Findings
    default: Findings | None
    earlier: EarlierInBrief
    search_widths: tuple[SearchWidth, ...]
    training_gaps: tuple[Gap, ...]
    context_tolerances: tuple[ContextTolerance, ...]
    parameter_sensitivity: ParameterSensitivity | None
    deaths: Deaths | None
    in_force: tuple[str, ...]
    high_load: HighLoad | None
    drifts: tuple[Drift, ...]
    two_kinds: tuple[TwoKinds, ...]
    uneven: tuple[UnevenRates, ...]
    provenance: Mapping[str, str]
    finished: str

    @property
    def passed(self) -> bool:
        """Whether the tuned parameter set passes; the default is there for comparison."""
        return self.tuned.passed

    @property
    def verdict(self) -> str:
        """`PASS` or `FAIL`."""
        return PASS if self.passed else FAIL

    @property
    def parameters(self) -> Mapping[str, Value]:
        """The parameter set."""
        return self.tuned.parameters

    @property
    def sides(self) -> Mapping[str, Findings]:
        """The findings by the name of their parameter set, the tuned one last."""
        default = {} if self.default is None else {DEFAULT: self.default}
        return {**default, TUNED: self.tuned}

    def is_of(self, trial: Trial) -> bool:
        """Return whether the parameter set is that of a trial."""
        return dict(self.parameters) == dict(trial.parameters)

    def check_names(self, study: Study) -> None:
        """Refuse one whose constraints, parameters or contexts are not those of a study."""
        for side in self.sides.values():
            _check("constraints", [c.name for c in side.constraints], study.constraints)
            _check("parameters", side.parameters, study.parameters)
            for constraint in side.constraints:
                for worst in constraint.worst:
                    _check(f"contexts of {constraint.name}", worst.context, study.contexts)
        for tolerance in self.context_tolerances:
            _check_known("context_tolerances", [tolerance.constraint], study.constraints)
            _check("worst_context", tolerance.worst_context, study.contexts)
            _check_known("variables", [v.name for v in tolerance.variables], study.contexts)
            if not tolerance.variables:
                raise ValueError("variables: expected at least one")
        _check("contexts", self.contexts, study.contexts)
        _check("metrics", self.metrics, study.metrics)
        _check_known("seen", self.seen, study.metrics)


def _check(
    what: str, names: Mapping[str, object] | Sequence[str], known: Mapping[str, object]
) -> None:
    """Refuse names that are not all that are known, in any order."""
    if sorted(names) != sorted(known):
        raise ValueError(f"{what}: expected {_listed(known)}, found {_listed(names)}")


def _check_known(
    what: str, names: Mapping[str, object] | Sequence[str], known: Mapping[str, object]
) -> None:
    """Refuse names that are not among those known."""
    if unknown := [name for name in names if name not in known]:
        raise ValueError(f"{what}: expected of {_listed(known)}, found {_listed(unknown)}")


def _listed(names: Mapping[str, object] | Sequence[str]) -> str:
    return ", ".join(names) or "none"
