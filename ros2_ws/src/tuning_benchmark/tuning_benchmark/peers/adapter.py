"""Another optimizer in the place of the tuner's: the same trials, evaluated in the same way."""

from collections.abc import Mapping, Sequence

import numpy as np

from bo_tuner.errors import ParameterError
from bo_tuner.optimizers import base
from bo_tuner.optimizers.base import DesignedOptimizer, Proposal
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial, TrialState, Value
from tuning_benchmark.paper.check import CandidateCheck
from tuning_benchmark.paper.method import PaperMethod
from tuning_benchmark.paper.single_evaluations import single_evaluation_margin
from tuning_benchmark.peers.optimizer import Observation, Optimizer, best_observed

ORIGIN = "asked"
"""Origin of a trial that the optimizer proposed."""


class PeerOptimizer:
    """The study's initial design, then what the optimizer asks for.

    Parameters
    ----------
    study
        The study.
    optimizer
        It is told of every trial; of the initial ones when they are all done.
    """

    standstill = ""

    def __init__(self, study: Study, optimizer: Optimizer) -> None:
        self._study = study
        self._space = study.search_space()
        self._designed = DesignedOptimizer(study)
        self._optimizer = optimizer
        self._trials: list[Trial] = []
        self._designing = True

    def ask(self, pending: Sequence[Trial] = ()) -> Proposal:
        """Propose the next trial's parameter set; none may be pending.

        Raises
        ------
        ParameterError
            If the optimizer asks for something outside the search space.
        """
        proposal = self._designed.initial()
        if proposal is not None:
            return proposal
        if self._designing:
            self._designing = False
            for trial in self._trials:
                self._show(trial)
        proposed = dict(self._optimizer.ask())
        parameters = self._space.to_parameters(self._space.to_cube(proposed))
        if self._space.key(parameters) != self._space.key(proposed):
            raise ParameterError(f"{proposed}: expected values in the order of the study")
        # As asked to the last digit, for an optimizer may look for what it asked.
        return Proposal(parameters | proposed, ORIGIN)

    def tell(self, trial: Trial) -> None:
        """Take a finished trial."""
        self._designed.tell(trial)
        self._trials.append(trial)
        if not self._designing:
            self._show(trial)

    def refuse(self, parameters: Mapping[str, Value]) -> None:
        """Refuse to refuse: a peer decides by itself what it proposes.

        Raises
        ------
        ParameterError
            Always.
        """
        raise ParameterError(f"{dict(parameters)}: a peer takes no refusal")

    def recommend(self) -> int | None:
        """Return the number of the trial that the optimizer recommends; None if it has none.

        During the initial design, which it has not been told of yet, the best as observed.
        """
        if not self._designing:
            return self._optimizer.recommend()
        return best_observed([observation(self._study, t, self._trials) for t in self._trials])

    def _show(self, trial: Trial) -> None:
        self._optimizer.tell(observation(self._study, trial, self._trials))


def peer_method(peer: base.Optimizer) -> PaperMethod:
    """Return the method of the paper whose proposals come from another optimizer."""
    return PaperMethod(stage_one=lambda _: peer, check=CandidateCheck(0))


def observation(study: Study, trial: Trial, trials: Sequence[Trial]) -> Observation:
    """Sum up a trial for an optimizer.

    A chance constraint is the quantile of the observations at its probability. The worst case is
    the trial's estimate with the noise of a single evaluation, as pooled over all `trials` so far:
    the same number as the tuner's own surrogates see.
    """
    space = study.search_space()
    parameters = {name: trial.parameters[name] for name in space.names}
    if trial.state is TrialState.FAILED:
        return Observation(parameters, True, None, {})
    cost = study.objective.to_cost(trial.observations(study.objective.metric))
    constraints = {}
    for chance in study.drawn_constraints:
        values = trial.observations(chance.metric)
        costs = chance.sign * np.asarray(values)
        value = float(np.quantile(costs, chance.level, method="inverted_cdf"))
        constraints[chance.name] = value - chance.sign * chance.limit
    for worst in study.worst_case_constraints:
        beyond = worst.sign * (trial.worst_cases[worst.name].value - worst.limit)
        constraints[worst.name] = beyond + single_evaluation_margin(trials, worst)
    return Observation(parameters, False, float(cost.mean()), constraints)
