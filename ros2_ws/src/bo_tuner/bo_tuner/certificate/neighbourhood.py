"""Whether an optimum is a calm place: what the surrogates say of the parameter sets around it.

An optimum is narrow if a step to a neighbour is intolerable: it loses more than `TOLERABLE` of the
objective, or exceeds a limit by more than that part of it. Then a controller that is rounded, tuned
by hand or moved to a slightly different machine may be no good any more, however well the optimum
itself holds. The paper's example is (H_u, H_p, λ_MPC, λ_KF) = (1, 4, -3.9, 2), where one step of a
horizon decides between feasible and not (Table 3).

`recommendation.neighbourhood` steps as far as the models can tell two points apart, which suits a
ranking within a run; here a step is the same in all runs.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.arrays import Array
from bo_tuner.optimizers.ranking import TOLERABLE, intolerable, relative_excess
from bo_tuner.study.study import Study
from bo_tuner.trials import Value


@dataclass(frozen=True)
class Neighbour:
    """A parameter set one step away from the optimum.

    Attributes
    ----------
    parameters
        The parameter set.
    changed
        The tuned parameters that differ, by name, with their values here.
    objective
        Posterior mean of the objective, in the metric's unit.
    feasibility
        Probability that all constraints hold.
    loss
        Loss in cost, relative to the objective's size; negative for a gain.
    excess
        Largest predicted excess over a limit, relative to the limit; negative if within all.
    """

    parameters: Mapping[str, Value]
    changed: Mapping[str, Value]
    objective: float
    feasibility: float
    loss: float
    excess: float

    @property
    def tolerable(self) -> bool:
        """Whether the step costs no more than `TOLERABLE`."""
        return max(self.loss, self.excess) <= TOLERABLE


@dataclass(frozen=True)
class Neighbourhood:
    """The neighbours of an optimum.

    Attributes
    ----------
    optimum
        The optimum itself, with a loss of 0.
    neighbours
        One or two for each tuned parameter, as bounds and order permit.
    score
        Mean of what is lost beyond `TOLERABLE` at the neighbours, in cost and over limits; 0 is
        calm.
    """

    optimum: Neighbour
    neighbours: tuple[Neighbour, ...]
    score: float

    @property
    def narrow(self) -> tuple[Neighbour, ...]:
        """The neighbours that are intolerable; an optimum without one is calm."""
        return tuple(n for n in self.neighbours if not n.tolerable)

    @property
    def warning(self) -> str:
        """One line on a narrow optimum; empty for a calm one."""
        if not self.narrow:
            return ""
        said = "; ".join(
            ", ".join(f"{name} {value:.4g}" for name, value in n.changed.items())
            + f" (objective {100.0 * n.loss:+.0f} %"
            + (f", {100.0 * n.excess:.0f} % over a limit)" if n.excess > 0.0 else ")")
            for n in self.narrow
        )
        return (
            f"narrow optimum: {len(self.narrow)} of {len(self.neighbours)} steps to a neighbour "
            f"cost more than {100.0 * TOLERABLE:.0f} %: {said}"
        )


def look_around(
    study: Study, parameters: Mapping[str, Value], models: Surrogates
) -> Neighbourhood | None:
    """Predict the neighbours of a parameter set.

    Parameters
    ----------
    study
        The study.
    parameters
        The optimum.
    models
        Surrogates of all trials.

    Returns
    -------
    Neighbourhood or None
        None while there is no model of the objective.
    """
    if models.objective is None:
        return None
    space = study.search_space()
    around = [dict(parameters), *space.neighbours(parameters)]
    tuned = [{name: item[name] for name in space.names} for item in around]
    points = np.array([space.to_cube(item) for item in tuned])
    cost = models.objective.predict_mean(points)
    # A difference of logarithms is relative as it is.
    scale = 1.0 if study.objective.scale == "log" else models.objective.scale
    loss: Array = (cost - cost[0]) / scale
    excess = relative_excess(models, points)
    feasibility = np.exp(models.log_feasibility(points))
    objective = study.objective.from_cost(cost)
    optimum, *others = (
        Neighbour(
            parameters=item,
            changed={n: tuned[k][n] for n in space.names if tuned[k][n] != tuned[0][n]},
            objective=float(objective[k]),
            feasibility=float(feasibility[k]),
            loss=float(loss[k]),
            excess=float(excess[k]),
        )
        for k, item in enumerate(around)
    )
    # What the optimum exceeds itself is no sign of a narrow one.
    lost = intolerable(loss[1:]) + intolerable(excess[1:])
    return Neighbourhood(optimum, tuple(others), float(lost.mean()) if others else 0.0)
