"""Another optimizer in the place of stage one: the same trials, evaluated in the same way."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bo_tuner.benchmark.optimizer import Observation, Optimizer
from bo_tuner.methods import Method
from bo_tuner.stage_one import Proposal, RandomSearch, StageOne
from bo_tuner.study import Study
from bo_tuner.trials import Trial, TrialState, Value

ASKED = "asked"
"""Origin of a trial that the optimizer proposed."""


class AskedStageOne:
    """The study's initial design, then what the optimizer asks for.

    Parameters
    ----------
    study
        The study.
    optimizer
        The optimizer; told of every trial, the initial ones too.
    """

    def __init__(self, study: Study, optimizer: Optimizer) -> None:
        self._study = study
        self._space = study.search_space()
        self._designed = RandomSearch(study)
        self._optimizer = optimizer

    def ask(self) -> Proposal:
        """Propose the next trial's parametrization.

        Raises
        ------
        ParameterError
            If the optimizer asks for something outside the search space.
        """
        proposal = self._designed.initial()
        if proposal is None:
            tuned: Mapping[str, Value] = self._optimizer.ask()
            parameters = self._space.to_parameters(self._space.to_cube(tuned))
            proposal = Proposal(parameters, ASKED)
        return proposal

    def tell(self, trial: Trial) -> None:
        """Tell the optimizer of a finished trial."""
        self._designed.tell(trial)
        self._optimizer.tell(observation(self._study, trial))


@dataclass(frozen=True)
class AskedMethod(Method):
    """A method whose stage one is another optimizer."""

    stage: AskedStageOne | None = None

    def stage_one(self, study: Study) -> StageOne:
        """Give the optimizer of this run."""
        if self.stage is None:
            raise ValueError("stage: expected the optimizer of this run")
        return self.stage


def observation(study: Study, trial: Trial) -> Observation:
    """Sum up a trial for an optimizer.

    A chance constraint is the quantile of the observations at its probability. The worst case is
    the trial's estimate with the noise of a single cut, as the product's own surrogates see it.
    """
    space = study.search_space()
    parameters = {name: trial.parameters[name] for name in space.names}
    if trial.state is TrialState.FAILED:
        return Observation(parameters, True, None, None, {})
    cost = study.objective.to_cost(trial.observations(study.objective.metric))
    error = float(cost.std(ddof=1) / np.sqrt(len(cost))) if len(cost) > 1 else None
    constraints = {}
    for chance in study.chance_constraints:
        values = trial.observations(chance.metric)
        value = float(np.quantile(values, chance.probability, method="inverted_cdf"))
        constraints[chance.name] = value - chance.upper
    worst = study.worst_case_constraint
    if worst is not None and trial.worst_case is not None:
        margin = worst.deviations * trial.worst_case.noise
        constraints[worst.name] = trial.worst_case.value + margin - worst.upper
    return Observation(parameters, False, float(cost.mean()), error, constraints)
