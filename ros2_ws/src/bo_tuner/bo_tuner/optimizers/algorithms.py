"""The algorithms of the paper's comparison (Sec. 5.1), as choices for the two stages."""

from dataclasses import dataclass

from bo_tuner.models.surrogates import DEFAULT_MODELS, ModelOptions
from bo_tuner.optimizers.stage_one import BayesianOptimization, RandomSearch, StageOne
from bo_tuner.study.study import Study
from bo_tuner.worst_case.search import POSTERIOR


@dataclass(frozen=True)
class Method:
    """Choices that make up an algorithm.

    Attributes
    ----------
    title
        What it is, in a line.
    nominal
        Evaluate parameter sets in the nominal context only, by one evaluation each.
    random
        Draw parameter sets at random instead of by the surrogates.
    models
        Which models stand for the responses.
    worst_case
        Estimate of the worst case: ``posterior`` or ``observed``.
    neighbour_starts
        Most contexts, the worst of neighbouring trials, with which a worst-case search starts.
    most_checked
        Most candidates to check on fresh draws before one is recommended.
    """

    title: str
    nominal: bool = False
    random: bool = False
    models: ModelOptions = DEFAULT_MODELS
    worst_case: str = POSTERIOR
    neighbour_starts: int = 2
    most_checked: int = 6

    def stage_one(self, study: Study) -> StageOne:
        """Make the stage one of a run."""
        if self.random:
            return RandomSearch(study)
        return BayesianOptimization(study, self.models)


METHODS = {
    "I": Method("Bayesian optimization on the nominal model", nominal=True, most_checked=0),
    "II": Method("random sampling in stage one", random=True),
    "III": Method(
        "Bayesian optimization without outlier detection",
        models=ModelOptions(reject_outliers=False),
    ),
    "IV": Method("Bayesian optimization with outlier detection"),
    "V": Method(
        "as IV, with one joint model of parameter set and context",
        models=ModelOptions(joint=True),
    ),
}
