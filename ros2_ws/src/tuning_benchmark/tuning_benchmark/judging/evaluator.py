"""Single evaluations of a study on its own objects."""

from collections.abc import Mapping

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Value
from bo_tuner.tuning.driver import Driver


class Evaluator:
    """Runs evaluations of a study in process.

    Parameters
    ----------
    study
        Its nodes name their objects.
    """

    def __init__(self, study: Study) -> None:
        self._study = study
        self._backend = InProcessBackend(study)
        self._backend.open()

    def metrics(
        self,
        parameters: Mapping[str, Value],
        context: Context | None = None,
        seed: int = 1,
    ) -> Mapping[str, float]:
        """Return the metrics of one evaluation; empty if it failed.

        Parameters
        ----------
        parameters
            Every parameter of the study.
        context
            Value of each context variable; the nominal context by default.
        seed
            Seed of the noise.
        """
        if context is None:
            space = self._study.context_space()
            context = space.to_dict(space.nominal())
        planned = Evaluation(0, 0, Stage.VALIDATION, parameters, context, seed)
        return Driver(self._backend).evaluate(planned).outcome.metrics
