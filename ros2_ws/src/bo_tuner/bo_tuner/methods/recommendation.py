"""The answer of a run, and the better parameter sets that were passed over for it."""

from dataclasses import dataclass, field

from bo_tuner.models.bias import Bias
from bo_tuner.optimizers.ranking import Candidate


@dataclass(frozen=True)
class PassedOver:
    """A parameter set that was passed over.

    Attributes
    ----------
    trial
        Number of its trial.
    objective
        Posterior mean of the objective, in the metric's unit.
    feasibility
        Probability that it keeps all limits.
    shown
        Whether that is enough, so that it lacked only runs of its own.
    """

    trial: int
    objective: float
    feasibility: float
    shown: bool


@dataclass(frozen=True)
class Recommendation:
    """The recommendation of a run.

    Attributes
    ----------
    candidate
        The recommended trial, the evaluations of its check included. If none passed its check, the
        first in rank that is believed feasible and was not checked, or else the least violating
        one.
    feasible
        Whether it passed its check; with no checks allowed, whether it is believed feasible.
    checked
        Numbers of the checked trials, in the order of the checks.
    ranked
        All candidates, with the evaluations of the checks.
    passed_over
        Better ones that were not chosen, by models that pool all evaluations; the best one first.
    biases
        At the recommended parameter set, how far the machine is from its simulation.
    """

    candidate: Candidate
    feasible: bool
    checked: tuple[int, ...]
    ranked: tuple[Candidate, ...] = field(repr=False)
    passed_over: tuple[PassedOver, ...] = ()
    biases: tuple[Bias, ...] = ()
