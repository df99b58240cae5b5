"""SMAC3's black-box facade (Lindauer et al. 2022), by ask and tell.

Sources
    https://automl.github.io/SMAC3/ : the pages on facades and on ask and tell; `BlackBoxFacade`
    (Gaussian process, expected improvement) is the one for few numerical parameters.
Noise
    ``deterministic=False``: the intensifier runs promising configurations again, up to three times
    as is its default, each at the cost of a trial. The seed that SMAC hands out only names the
    repetition; contexts and noise are drawn anew in any case.
Initial samples
    `tell` of trials that were not asked for, as documented; SMAC's own initial design is left out.
Constraints
    SMAC has none for results (issues 884 and 1260 of its repository ask for them), so they are a
    penalty in the cost, as its users do: for each limit the excess over it, relative to the largest
    one of the initial samples and 1 at most, times the range of their objectives. So the model sees
    a continuous cost on the objective's own scale, in which a violation as large as usual outweighs
    all that it may gain.
Failed trials
    Status ``CRASHED``, which SMAC's model learns from by default, at the largest initial objective
    plus that range. The default ``crash_cost``, infinity, would make the model fail.
Order of two parameters
    A forbidden relation of the configuration space, which SMAC's search keeps.
Recommendation
    SMAC's incumbent; as a penalty cannot rule out that it is infeasible, else the configuration
    with the lowest mean cost. Only configurations that were feasible each time are considered.
"""

import logging
import tempfile
from pathlib import Path

from ConfigSpace import (
    Configuration,
    ConfigurationSpace,
    Float,
    ForbiddenGreaterThanRelation,
    Integer,
)
from smac import BlackBoxFacade, Scenario
from smac.runhistory import StatusType, TrialInfo, TrialValue

from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.peers.optimizer import Observation, excesses, is_feasible, permitted

INITIAL_SEED = 0
"""Name of the first evaluation of a configuration."""


class Smac:
    """SMAC with a Gaussian process."""

    def __init__(self, study: Study, seed: int) -> None:
        self._study = study
        self._space = study.search_space()
        self._configurations = _configuration_space(study)
        self._seed = seed
        self._smac: BlackBoxFacade | None = None
        self._observations: list[Observation] = []
        self._configured: list[Configuration] = []
        self._pending: TrialInfo | None = None

    def ask(self) -> dict[str, Value]:
        """Let SMAC suggest."""
        if self._smac is None:
            self._smac = self._start()
        self._pending = self._smac.ask()
        parameters = {
            name: (int if integer else float)(self._pending.config[name])
            for name, integer in zip(self._space.names, self._space.integer, strict=True)
        }
        return permitted(self._space, parameters)

    def tell(self, observation: Observation) -> None:
        """Take an initial sample, or the result of the one that was asked for."""
        self._observations.append(observation)
        pending, self._pending = self._pending, None
        if pending is None:
            configuration = Configuration(self._configurations, dict(observation.parameters))
            pending = TrialInfo(configuration, seed=INITIAL_SEED)
        self._configured.append(pending.config)
        if self._smac is not None:
            self._tell(self._smac, pending, observation)

    def recommend(self) -> int | None:
        """First trial of the best configuration."""
        verdicts: dict[Configuration, bool] = {}
        for configuration, observation in zip(self._configured, self._observations, strict=True):
            verdicts[configuration] = verdicts.get(configuration, True) and is_feasible(observation)
        feasible = [configuration for configuration, verdict in verdicts.items() if verdict]
        if not feasible:
            return None
        smac = self._smac or self._start()
        incumbents = [c for c in smac.intensifier.get_incumbents() if c in feasible]
        best = min(incumbents or feasible, key=smac.runhistory.get_cost)
        return self._configured.index(best)

    def _start(self) -> BlackBoxFacade:
        """Start SMAC with the initial samples, which set the scale of the costs."""
        logging.getLogger("smac").setLevel(logging.ERROR)
        objectives = [o.objective for o in self._observations if o.objective is not None]
        self._largest = max(objectives, default=0.0)
        self._range = self._largest - min(objectives, default=0.0) or 1.0
        seen = [excesses(self._study, o) for o in self._observations]
        self._excess = {
            name: max(
                [0.0, *(of_observation[name] for of_observation in seen if name in of_observation)]
            )
            or 1.0
            for name in self._study.constraints
        }
        # SMAC writes its settings when it starts; after that nothing, as results are not saved.
        with tempfile.TemporaryDirectory() as folder:
            scenario = Scenario(
                self._configurations,
                deterministic=False,
                seed=self._seed,
                output_directory=Path(folder),
            )
            smac = BlackBoxFacade(
                scenario,
                initial_design=BlackBoxFacade.get_initial_design(scenario, n_configs=0),
                logging_level=False,
            )
        for configuration, observation in zip(self._configured, self._observations, strict=True):
            self._tell(smac, TrialInfo(configuration, seed=INITIAL_SEED), observation)
        return smac

    def _tell(self, smac: BlackBoxFacade, trial: TrialInfo, observation: Observation) -> None:
        if observation.failed or observation.objective is None:
            cost, status = self._largest + self._range, StatusType.CRASHED
        else:
            penalty = sum(
                min(1.0, max(0.0, value) / self._excess[name])
                for name, value in excesses(self._study, observation).items()
            )
            cost = observation.objective + self._range * penalty
            status = StatusType.SUCCESS
        smac.tell(trial, TrialValue(cost, status=status), save=False)


def _configuration_space(study: Study) -> ConfigurationSpace:
    space = study.search_space()
    made = ConfigurationSpace()
    for name in space.names:
        parameter = study.parameters[name]
        kind = Integer if parameter.is_integer else Float
        made.add(kind(name, bounds=parameter.bounds, log=parameter.scale == "log"))
    for smaller, larger in space.order:
        if smaller in space.names and larger in space.names:
            made.add(ForbiddenGreaterThanRelation(made[smaller], made[larger]))
    return made
