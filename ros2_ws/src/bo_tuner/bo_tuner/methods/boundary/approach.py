"""Where a first feasible parameter set is searched: around the one that violates the limits least.

Where ranges are wide and trials few, no model knows much of most of the cube, and the probability
of feasibility is largest where least is known: at faces and corners, one after the other. Close to
the least violating parameter set the models know in which direction the violation falls. So as long
as none is believed feasible, proposals are confined to a box around that one, as in the trust
regions of Eriksson and Poloczek (2021), whose centre moves to the least violating point, too.
Theirs shrink when trials fail, since they go on to the optimum; this box grows, since what is not
found close by is farther away: in the end it is the whole cube.

References
----------
Eriksson and Poloczek (2021). Scalable constrained Bayesian optimization. AISTATS.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bo_tuner.models.narrowness import relative_excess
from bo_tuner.models.pooled_models import PooledSurrogates
from bo_tuner.optimizers.box import Box
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial


@dataclass(frozen=True)
class Approach:
    """The box around the least violating parameter set.

    Attributes
    ----------
    half_width
        Half the edge of the box at first, in edges of the cube.
    doubled
        Proposals in a row without a less violating parameter set, for each tuned parameter, that
        double the box.
    """

    half_width: float = 0.3
    doubled: float = 2.0

    def box(
        self, surrogates: PooledSurrogates, study: Study, trials: Sequence[Trial]
    ) -> Box | None:
        """Return the box, None for the whole cube.

        Parameters
        ----------
        surrogates
            Models of all trials, none of which is believed feasible.
        study
            The study.
        trials
            Complete ones that the models know.
        """
        if not trials or not surrogates.constraints:
            return None
        space = study.search_space()
        points = space.cube_of(trial.parameters for trial in trials)
        least = int(relative_excess(surrogates, points).argmin())
        made = max(trial.number for trial in trials)
        lost = made - max(trials[least].number, study.budget.initial_trials - 1)
        half = self.half_width * 2.0 ** (max(lost, 0) / (self.doubled * space.dimension))
        # A choice has no neighbours.
        half_widths = np.where(np.array(space.levels) > 0, 1.0, half)
        return Box(
            np.maximum(points[least] - half_widths, 0.0),
            np.minimum(points[least] + half_widths, 1.0),
        )
