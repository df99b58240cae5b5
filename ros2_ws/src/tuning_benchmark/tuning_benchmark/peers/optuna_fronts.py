"""Optuna's samplers for several objectives, in the place of the tuner's stage one.

Sources
    https://optuna.readthedocs.io/en/stable/tutorial/20_recipes/002_multi_objective.html and the
    pages of `NSGAIISampler`, `TPESampler`, `Study.enqueue_trial` and `Study.best_trials`.
Constraints
    `Trial.set_constraint`, which both samplers and `best_trials` respect; the same numbers as for
    one objective (`peers.adapter.observation`).
Initial samples
    `Study.enqueue_trial`: they are asked for like others, so that they are in NSGA-II's first
    population. A trial that fails is reported as `TrialState.FAIL`.
Settings
    Defaults, but for NSGA-II's population: its default of 50 is more than the trials of a run,
    which would all be random.
Recommendation
    `Study.best_trials`: the feasible trials that no other one dominates, as observed.
"""

from collections.abc import Sequence

import numpy as np
import optuna
from optuna.samplers import BaseSampler, NSGAIISampler, TPESampler
from optuna.trial import TrialState

from bo_tuner.optimizers.base import DesignedOptimizer, Proposal
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial
from bo_tuner.trials import TrialState as State
from tuning_benchmark.peers.adapter import ORIGIN, observation
from tuning_benchmark.peers.optimizer import excesses
from tuning_benchmark.peers.optuna_samplers import distribution

POPULATION = 10


class OptunaFront(DesignedOptimizer):
    """An Optuna study with as many directions as the study has objectives."""

    def __init__(self, study: Study, sampler: BaseSampler) -> None:
        super().__init__(study)
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._distributions = {
            name: distribution(study.parameters[name]) for name in self.space.names
        }
        # Costs are always minimized.
        self._optuna = optuna.create_study(
            directions=["minimize"] * len(study.objectives), sampler=sampler
        )
        self._pending: optuna.Trial | None = None

    def ask(self, pending: Sequence[Trial] = ()) -> Proposal:
        """Propose what the initial design has or the sampler suggests; none may be pending."""
        proposal = self.initial()
        if proposal is not None:
            tuned = {name: proposal.parameters[name] for name in self.space.names}
            self._optuna.enqueue_trial(tuned)
        self._pending = self._optuna.ask(self._distributions)
        if proposal is not None:
            return proposal
        return Proposal(self.space.completed(dict(self._pending.params)), ORIGIN)

    def tell(self, trial: Trial) -> None:
        """End the trial that was asked for."""
        super().tell(trial)
        pending, self._pending = self._pending, None
        if pending is None:
            raise ValueError("no trial was asked for")
        if trial.state is State.FAILED:
            self._optuna.tell(pending, state=TrialState.FAIL)
            return
        seen = observation(self.study, trial, self.trials)
        for name, excess in excesses(self.study, seen).items():
            pending.set_constraint(name, excess)
        costs = [
            float(np.mean(o.to_cost(trial.observations(o.metric)))) for o in self.study.objectives
        ]
        self._optuna.tell(pending, costs)

    def recommend(self) -> list[int]:
        """Return the numbers of the trials on the front as observed."""
        return [trial.number for trial in self._optuna.best_trials]


def nsga2(study: Study, seed: int) -> OptunaFront:
    """Make NSGA-II (Deb et al. 2002)."""
    return OptunaFront(study, NSGAIISampler(population_size=POPULATION, seed=seed))


def tpe(study: Study, seed: int) -> OptunaFront:
    """Make the multi-objective tree-structured Parzen estimator (Ozaki et al. 2022)."""
    return OptunaFront(study, TPESampler(seed=seed))
