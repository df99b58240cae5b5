"""Optuna's GPSampler and TPESampler, by ask and tell, with its constraint interface.

Sources
    https://optuna.readthedocs.io/en/stable/tutorial/20_recipes/009_ask_and_tell.html and the pages
    of `GPSampler`, `TPESampler`, `Trial.set_constraint` and `Study.best_trial`.
Constraints
    `Trial.set_constraint`, which since Optuna 5 takes the place of `constraints_func`; a value
    above 0 is a violation. GPSampler multiplies its improvement by the probability of feasibility,
    TPESampler sorts infeasible trials by their total violation.
Initial samples
    `Study.add_trial`, as documented for trials that were run elsewhere. They count as the
    samplers' 10 start-up trials.
Failed trials
    Told as complete ones that violate a constraint of their own, ``crash``. `TrialState.FAIL` is
    documented for crashes, but such trials reach neither sampler: both then return to the region
    that crashes. Objective and other constraints get the worst value seen, which neither shifts
    their scale nor makes a crash attractive.
Order of two parameters
    Optuna has no constraint between parameters that the samplers know. What they suggest is moved
    to the nearest permitted values; the suggestion itself then ends as failed, which the samplers
    ignore, and the values that ran are added.
Recommendation
    `Study.best_trial`: the best value among the feasible complete trials.
"""

import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.samplers import BaseSampler, GPSampler, TPESampler
from optuna.trial import Trial, TrialState, create_trial

from bo_tuner.study.parameter import Parameter
from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.peers.optimizer import Observation, excesses, permitted

CRASH = "crash"


class _Optuna:
    """An Optuna study with some sampler."""

    def __init__(self, study: Study, sampler: BaseSampler) -> None:
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._study = study
        self._space = study.search_space()
        self._distributions = {
            name: distribution(study.parameters[name]) for name in self._space.names
        }
        self._optuna = optuna.create_study(sampler=sampler)
        self._pending: Trial | None = None
        self._numbers: list[int] = []
        self._values: list[float] = []
        self._largest = dict.fromkeys(study.constraints, 0.0)

    def ask(self) -> dict[str, Value]:
        """Let the sampler suggest."""
        trial = self._optuna.ask(self._distributions)
        parameters = permitted(self._space, trial.params)
        if parameters == trial.params:
            self._pending = trial
        else:
            self._optuna.tell(trial, state=TrialState.FAIL)
        return parameters

    def tell(self, observation: Observation) -> None:
        """End the trial that was asked for, or add one."""
        value, constraints = self._seen(observation)
        pending, self._pending = self._pending, None
        if pending is not None and pending.params == dict(observation.parameters):
            for name, excess in constraints.items():
                pending.set_constraint(name, excess)
            self._optuna.tell(pending, value)
            self._numbers.append(pending.number)
            return
        self._optuna.add_trial(
            create_trial(
                params=dict(observation.parameters),
                distributions=self._distributions,
                value=value,
                constraints=constraints,
            )
        )
        self._numbers.append(self._optuna.trials[-1].number)

    def recommend(self) -> int | None:
        """Index of the study's best trial."""
        try:
            best = self._optuna.best_trial
        except ValueError:  # No trial is feasible.
            return None
        return self._numbers.index(best.number)

    def _seen(self, observation: Observation) -> tuple[float, dict[str, float]]:
        """Value and constraints of a trial; of a failed one those that the others bound."""
        if observation.failed or observation.objective is None:
            return max(self._values, default=0.0), self._largest | {CRASH: 1.0}
        self._values.append(observation.objective)
        constraints = excesses(self._study, observation)
        for name, excess in constraints.items():
            self._largest[name] = max(self._largest[name], excess)
        return observation.objective, constraints | {CRASH: -1.0}


class OptunaGP(_Optuna):
    """Gaussian processes and constrained log expected improvement, defaults."""

    def __init__(self, study: Study, seed: int) -> None:
        super().__init__(study, GPSampler(seed=seed, deterministic_objective=study.is_noiseless))


class OptunaTPE(_Optuna):
    """Tree-structured Parzen estimator, defaults (multivariate since Optuna 5)."""

    def __init__(self, study: Study, seed: int) -> None:
        super().__init__(study, TPESampler(seed=seed))


def distribution(parameter: Parameter) -> BaseDistribution:
    """Return the distribution of a tuned parameter."""
    if parameter.bounds is None:
        raise ValueError(f"parameter {parameter.name}: expected a tuned one")
    low, high = parameter.bounds
    log = parameter.scale == "log"
    if parameter.is_integer:
        return IntDistribution(int(low), int(high), log=log)
    return FloatDistribution(low, high, log=log)
