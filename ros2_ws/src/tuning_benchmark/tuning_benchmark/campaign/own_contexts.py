"""One run of an optimizer that chooses the context of each evaluation itself."""

from collections.abc import Iterator, Mapping

from bo_tuner.methods.registry import METHODS
from bo_tuner.numerics.seeds import Stream, noise_seed
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Trial, TrialState, Value
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark.campaign.timed_backend import TimedBackend
from tuning_benchmark.peers.adapter import ORIGIN
from tuning_benchmark.peers.robust import RobustOptimizer, result_of

DESIGN = "IV"
"""Algorithm whose initial trials, with its search for the worst context, all such runs share."""


class OwnContextsRun:
    """A run that begins with the trials of an algorithm's initial design.

    Each evaluation after them is a trial of its own. Has the interface of `runs.Run`.

    Parameters
    ----------
    study
        The study with the seed and the budget of the run.
    optimizer
        The optimizer.
    budget
        Evaluations after which the run ends.
    """

    def __init__(self, study: Study, optimizer: RobustOptimizer, budget: int) -> None:
        self.study = study
        self.budget = budget
        self.backend = TimedBackend(study)
        self.backend.open()
        self.trials: list[Trial] = []
        self._optimizer = optimizer
        self._space = study.search_space()
        self._numbers: dict[object, int] = {}

    @property
    def done(self) -> bool:
        """Whether the budget is used."""
        return self.backend.evaluations >= self.budget

    def __iter__(self) -> Iterator[Trial]:
        """Run the initial trials, and then evaluations until the budget is used."""
        for trial in Tuning(self.study, Driver(self.backend), METHODS[DESIGN]):
            yield self._take(trial)
            if self.done or len(self.trials) >= self.study.budget.initial_trials:
                break
        while not self.done:
            yield self._take(self._evaluate(*self._optimizer.ask()))

    def incumbent(self) -> int | None:
        """Return the first trial of the recommended parameter set; None if there is none."""
        tuned = self._optimizer.recommend()
        return None if tuned is None else self._numbers[self._space.key(tuned)]

    def answer(self) -> tuple[int, bool] | None:
        """Return the trial recommended in the end, which the optimizer believes feasible."""
        number = self.incumbent()
        return None if number is None else (number, True)

    def _evaluate(self, tuned: Mapping[str, Value], context: Context) -> Trial:
        number = len(self.trials)
        # As asked to the last digit, for an optimizer may look for what it asked.
        parameters = self._space.to_parameters(self._space.to_cube(tuned)) | dict(tuned)
        seed = noise_seed(self.study.seed, Stream.NOISE, number, 0)
        planned = Evaluation(number, 0, Stage.SEARCH, parameters, context, seed)
        done = Driver(self.backend).evaluate(planned)
        complete = done.outcome.complete
        state = TrialState.COMPLETE if complete else TrialState.FAILED
        return Trial(number, parameters, ORIGIN, state, done.outcome.reason, (done,))

    def _take(self, trial: Trial) -> Trial:
        self.trials.append(trial)
        self._numbers.setdefault(self._space.key(trial.parameters), trial.number)
        for evaluation in trial.evaluations:
            self._optimizer.tell(result_of(self.study, evaluation))
        return trial
