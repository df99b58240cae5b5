"""The evaluations of a certificate: common fresh draws, then the worst contexts of each subject."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.backends.protocol import Backend
from bo_tuner.certificate.evidence import Evidence
from bo_tuner.certificate.independent_search import (
    CANDIDATES,
    find_worst_contexts,
    most_evaluations,
)
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Stage, Value
from bo_tuner.tuning.evaluation import Losses, evaluate
from bo_tuner.tuning.observer import NOBODY, RunObserver

REPEATS = 20
"""Evaluations with fresh noise in each context that may be the worst."""

DRAWN, SEARCHED, REPEATED = 0, 1, 2
"""Purpose of an evaluation, as part of the key of its noise seed."""


@dataclass(frozen=True)
class Subject:
    """A parameter set to certify.

    Attributes
    ----------
    name
        Name in the progress display.
    parameters
        The parameter set.
    suspected
        Contexts that are already suspected to be its worst ones.
    """

    name: str
    parameters: Mapping[str, Value]
    suspected: tuple[Mapping[str, float], ...] = ()


class Certification:
    """Collects the evidence for a certificate.

    Parameters
    ----------
    study
        The study.
    backend
        Runs the evaluations; open.
    observer
        Told of each phase, evaluation and step.
    """

    def __init__(
        self,
        study: Study,
        backend: Backend,
        *,
        observer: RunObserver = NOBODY,
    ) -> None:
        self._study = study
        self._backend = backend
        self._observer = observer
        self._contexts = study.context_space()
        self._losses = Losses("evaluations")

    def collect(self, subjects: Sequence[Subject], draws: int) -> list[Evidence]:
        """Evaluate all subjects in the same draws, then search for the worst contexts of each.

        Without a worst-case constraint there is no search.

        Raises
        ------
        RunError
            If three evaluations in a row were lost with their nodes or disturbed.
        """
        drawn = self._draw(subjects, draws)
        return [
            self._look_closely(number, subject, drawn[number])
            for number, subject in enumerate(subjects)
        ]

    def _draw(self, subjects: Sequence[Subject], draws: int) -> list[list[Evaluation]]:
        self._observer.begin("draws", draws)
        rows = self._contexts.draw(draws, generator(self._study.seed, Stream.CERTIFICATE_CONTEXTS))
        evaluations: list[list[Evaluation]] = [[] for _ in subjects]
        for k, row in enumerate(rows):
            seed = noise_seed(self._study.seed, Stream.CERTIFICATE_NOISE, DRAWN, k)
            context = self._contexts.to_dict(row)
            for number, subject in enumerate(subjects):
                planned = Evaluation(number, k, Stage.VALIDATION, subject.parameters, context, seed)
                evaluations[number].append(self._run(planned))
            self._observer.advance()
        return evaluations

    def _look_closely(self, number: int, subject: Subject, drawn: Sequence[Evaluation]) -> Evidence:
        constraint = self._study.worst_case_constraint
        if constraint is None:
            return Evidence(subject.parameters, tuple(drawn))
        search: list[Evaluation] = []

        def run(stage: Stage, context: Mapping[str, float], index: int, *key: int) -> Evaluation:
            # The key does not depend on the subject: the same noise for all.
            seed = noise_seed(self._study.seed, Stream.CERTIFICATE_NOISE, *key)
            evaluation = self._run(
                Evaluation(number, index, stage, subject.parameters, context, seed)
            )
            self._observer.advance()
            return evaluation

        def metric_in(context: Mapping[str, float]) -> float | None:
            evaluation = run(Stage.SEARCH, context, len(search), SEARCHED, len(search))
            search.append(evaluation)
            return evaluation.outcome.metrics.get(constraint.metric)

        self._observer.begin(
            f"worst case of {subject.name}",
            most_evaluations(self._contexts, len(subject.suspected)) + CANDIDATES * REPEATS,
        )
        candidates = find_worst_contexts(
            self._contexts,
            metric_in,
            [
                (evaluation.context, evaluation.outcome.metrics[constraint.metric])
                for evaluation in drawn
                if evaluation.outcome.state is EvaluationState.COMPLETE
            ],
            subject.suspected,
            generator(self._study.seed, Stream.CERTIFICATE_SEARCH, number),
        )
        repeated = [
            tuple(run(Stage.CHECK_WORST, context, k, REPEATED, place, k) for k in range(REPEATS))
            for place, context in enumerate(candidates)
        ]
        return Evidence(subject.parameters, tuple(drawn), tuple(search), tuple(repeated))

    def _run(self, planned: Evaluation) -> Evaluation:
        evaluation = evaluate(self._study, self._backend, planned, self._observer)
        self._losses.note(evaluation.outcome)
        self._losses.check()
        return evaluation
