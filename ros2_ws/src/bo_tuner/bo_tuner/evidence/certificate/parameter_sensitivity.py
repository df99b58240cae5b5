"""Sensitivity of an optimum to a step in one parameter, as the surrogates predict it.

An optimum is narrow if a step to a neighbour loses more than the fraction `TOLERABLE` of the
objective, or breaks a limit that the optimum keeps. After rounding, a small manual
change or a move to a slightly different machine such an optimum may no longer be good. The paper's
example is (H_u, H_p, λ_MPC, λ_KF) = (1, 4, -3.9, 2), where one step of a horizon decides whether
the limits are kept (Table 3).

The ranking steps integers alone. Here real parameters have steps as well: they say more to a reader
than they could decide.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bo_tuner.models.narrowness import TOLERABLE, intolerable, relative_excess, relative_loss
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.study.study import Study
from bo_tuner.trials import Value


@dataclass(frozen=True)
class Neighbour:
    """The prediction for a parameter set one step away from the optimum.

    Attributes
    ----------
    parameters
        The parameter set.
    changed
        The tuned parameters that differ from the optimum, with their values here.
    objective
        Posterior mean of the objective, in the metric's unit; of several objectives that of the
        cost of the compromise, which has none.
    feasibility
        Probability that all constraints hold.
    loss
        How much worse the objective is, relative to that of the optimum; negative for a gain. Of
        several objectives, by the cost of the compromise relative to its spread.
    excess
        Largest predicted excess over a limit, relative to the limit; negative if all are kept.
    """

    parameters: Mapping[str, Value]
    changed: Mapping[str, Value]
    objective: float
    feasibility: float
    loss: float
    excess: float

    @property
    def tolerable(self) -> bool:
        """Whether the loss is `TOLERABLE`, and all limits are kept."""
        return self.loss <= TOLERABLE and self.excess <= 0.0


@dataclass(frozen=True)
class ParameterSensitivity:
    """Predictions for all steps away from an optimum.

    Attributes
    ----------
    optimum
        The optimum itself, with a loss of 0.
    neighbours
        Up to two for each tuned parameter, where bounds and order permit them.
    score
        Mean over the neighbours of the loss beyond `TOLERABLE` and the excess over a limit; 0 if
        every step is tolerable.
    """

    optimum: Neighbour
    neighbours: tuple[Neighbour, ...]
    score: float

    @property
    def narrow(self) -> tuple[Neighbour, ...]:
        """The neighbours that are not tolerable; the optimum is narrow if there is one."""
        return tuple(n for n in self.neighbours if not n.tolerable)


def parameter_sensitivity(
    study: Study, parameters: Mapping[str, Value], models: Surrogates
) -> ParameterSensitivity | None:
    """Predict objective and constraints one step away from a parameter set in each parameter."""
    if models.objective is None:
        return None
    space = study.search_space()
    around = [dict(parameters), *space.neighbours(parameters)]
    tuned = [{name: item[name] for name in space.names} for item in around]
    points = space.cube_of(tuned)
    cost = models.objective.predict_mean(points)
    objective = study.from_predicted_cost(cost)
    loss = relative_loss(study, models.objective, cost, cost[:1])
    excess = relative_excess(models, points)
    feasibility = models.feasibility(points)
    optimum, *others = (
        Neighbour(
            parameters=item,
            # What has its default as it is not active is not set.
            changed={n: v for n, v in space.active(tuned[k]).items() if v != tuned[0][n]},
            objective=float(objective[k]),
            feasibility=float(feasibility[k]),
            loss=float(loss[k]),
            excess=float(excess[k]),
        )
        for k, item in enumerate(around)
    )
    # The optimum itself is left out: its own excess does not make it narrow.
    lost = intolerable(loss[1:]) + np.maximum(excess[1:], 0.0)
    return ParameterSensitivity(optimum, tuple(others), float(lost.mean()) if others else 0.0)
