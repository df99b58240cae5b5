"""Validation of parameter sets on fresh draws of context and noise (Sec. 5.2)."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.codec.rules import Count
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.plans import Phase, Plan, Run
from bo_tuner.study.limits import Sample, judge_samples
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Stage, Value


@dataclass(frozen=True)
class Validation:
    """Result of the validation of one parameter set.

    Attributes
    ----------
    parameters
        The parameter set.
    draws
        Number of evaluations.
    failures, lost
        Number of those that failed for the parameters, and of those that are unusable: lost with
        their nodes, or disturbed by others.
    constraints
        Each constraint, by name, judged on the complete evaluations.
    """

    parameters: Mapping[str, Value]
    draws: Count
    failures: Count
    lost: Count
    constraints: Mapping[str, Sample]

    @property
    def feasible(self) -> bool:
        """Whether all evaluations are complete and agree with every constraint."""
        return self.failures == self.lost == 0 and all(s.agrees for s in self.constraints.values())


class ValidationPlan(Plan[Run]):
    """The evaluations of parameter sets on the same fresh draws, which depend on no result.

    Attributes
    ----------
    evaluations
        Those that were told, of each parameter set.
    """

    phase = Phase.VALIDATION

    def __init__(
        self,
        study: Study,
        candidates: Sequence[Mapping[str, Value]],
        spared: Collection[int] = (),
    ) -> None:
        self._study = study
        self._candidates = candidates
        self._run = [number for number in range(len(candidates)) if number not in spared]
        self._planned = self._evaluations()
        self.evaluations: list[list[Evaluation]] = [[] for _ in candidates]
        self.steps = study.budget.validation_draws

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next evaluation."""
        planned = next(self._planned, None)
        return None if planned is None else Run(planned)

    def tell(self, task: Run) -> bool:
        """Add an evaluation; a draw of all parameter sets is a step."""
        self.evaluations[task.evaluation.trial].append(task.evaluation)
        return sum(map(len, self.evaluations)) % len(self._run) == 0

    @property
    def results(self) -> list[Validation]:
        """One for each parameter set, in their order."""
        pairs = zip(self._candidates, self.evaluations, strict=True)
        return [_judge(self._study, parameters, evaluations) for parameters, evaluations in pairs]

    def _evaluations(self) -> Iterator[Evaluation]:
        study, contexts = self._study, self._study.context_space()
        rng = generator(study.seed, Stream.VALIDATION_CONTEXTS)
        for k, row in enumerate(contexts.draw(study.budget.validation_draws, rng)):
            seed = noise_seed(study.seed, Stream.VALIDATION_NOISE, 0 if study.is_noiseless else k)
            context = contexts.to_dict(row)
            for number in by_turns(study, k, self._run):
                parameters = self._candidates[number]
                yield Evaluation(number, k, Stage.VALIDATION, parameters, context, seed)


def by_turns(study: Study, draw: int, numbers: Sequence[int]) -> Sequence[int]:
    """Return in which order parameter sets run in a draw, by their numbers.

    By turns the first and the last is first: wear, or a machine that warms up, is no difference
    between them, and a node that starts anew for other parameters does so once a draw. Where limits
    are relative to the default, its run is ahead of the others anyway, and is not made twice.
    """
    return numbers[::-1] if draw % 2 and not study.relative_metrics else numbers


def _judge(
    study: Study, parameters: Mapping[str, Value], evaluations: Sequence[Evaluation]
) -> Validation:
    complete = sum(e.outcome.complete for e in evaluations)
    lost = sum(not e.outcome.complete and e.outcome.unusable for e in evaluations)
    return Validation(
        parameters=dict(parameters),
        draws=len(evaluations),
        failures=len(evaluations) - complete - lost,
        lost=lost,
        constraints=judge_samples(study, evaluations),
    )
