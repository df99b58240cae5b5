"""The evaluations of a certificate: common fresh draws, then the worst contexts of each subject.

They end as soon as the verdict is clear; `most_evaluations` says when at the latest.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bo_tuner.backends.protocol import Backend
from bo_tuner.evidence.certificate.findings import NOTHING, Earlier, Evidence, Ranking
from bo_tuner.evidence.certificate.independent_search import (
    CANDIDATES,
    CARRIED,
    MOST_MODELLED,
    find_worst_contexts,
    most_searched,
    rank,
    worst_of_all,
)
from bo_tuner.evidence.certificate.judgement import decide_context, decide_draws, is_failed
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Value
from bo_tuner.tuning.evaluation import Losses, evaluate
from bo_tuner.tuning.observer import NOBODY, RunObserver

LEAST_DRAWS = 30
"""Draws behind the mean of the objective, even if fewer decide the verdict."""

EXPECTED_REPEATS = 25
"""Evaluations in each context that may be the worst, in a clear case; for the progress display."""

DRAWS = "draws"
"""Name of the first phase; the others are searches."""

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
        Contexts that are already suspected to be its worst ones, in the order of the worst-case
        constraints.
    earlier
        What was known of it before.
    """

    name: str
    parameters: Mapping[str, Value]
    suspected: tuple[Context, ...] = ()
    earlier: Earlier = NOTHING


@dataclass(frozen=True)
class MostEvaluations:
    """Largest number of evaluations of a certificate, by their purpose.

    Attributes
    ----------
    drawn, searched, repeated
        In draws, in the search for the worst contexts, and in these.
    """

    drawn: int
    searched: int
    repeated: int

    @property
    def total(self) -> int:
        """All of them."""
        return self.drawn + self.searched + self.repeated


def most_evaluations(study: Study, subjects: Sequence[Subject], draws: int) -> MostEvaluations:
    """Return the largest number of evaluations of `Certification.collect`; its arguments."""
    space, constraints = study.context_space(), len(study.worst_case_constraints)
    places = sum(_most_places(study, subject) for subject in subjects)
    return MostEvaluations(
        drawn=len(subjects) * draws,
        searched=constraints * sum(most_searched(space, len(s.suspected)) for s in subjects),
        repeated=places * draws,
    )


def _most_places(study: Study, subject: Subject) -> int:
    """Return the largest number of contexts in which a subject is evaluated again and again."""
    constraints = len(study.worst_case_constraints)
    if not constraints or not study.contexts:
        return constraints
    found = CANDIDATES + (CARRIED if subject.earlier.certified else 0)
    return len(subject.earlier.contexts) + constraints * found


class _FailedError(Exception):
    """An evaluation of a search failed: a FAIL."""


class Certification:
    """Collects the evidence for a certificate.

    Parameters
    ----------
    study
        The study.
    backend
        Runs the evaluations; open.
    confidence
        Confidence of each bound.
    attempt
        Number of the attempt to certify a parameter set of the run, from 1: each has own draws.
    observer
        Told of each phase, evaluation and step.
    """

    def __init__(
        self,
        study: Study,
        backend: Backend,
        *,
        confidence: float,
        attempt: int = 1,
        observer: RunObserver = NOBODY,
    ) -> None:
        self._study = study
        self._backend = backend
        self._confidence = confidence
        self._attempt = attempt
        self._observer = observer
        self._contexts = study.context_space()
        self._losses = Losses("evaluations")

    def collect(self, subjects: Sequence[Subject], draws: int) -> list[Evidence]:
        """Evaluate all subjects in the same draws, then search for the worst contexts of each.

        The draws end when they are clear for every subject. Without a worst-case constraint, or
        for a subject that the draws let fail, there is no search.

        Parameters
        ----------
        subjects
            The parameter sets.
        draws
            Largest number of draws, and of evaluations in each context that may be the worst.

        Raises
        ------
        RunError
            If three evaluations in a row were lost with their nodes or disturbed.
        """
        drawn = self._draw(subjects, draws)
        found = [
            self._look_closely(number, subject, drawn[number], draws)
            for number, subject in enumerate(subjects)
        ]
        return [
            self._draw_on(number, subject, evidence, draws)
            for (number, subject), evidence in zip(enumerate(subjects), found, strict=True)
        ]

    def _draw_on(self, number: int, subject: Subject, found: Evidence, most: int) -> Evidence:
        """Make the draws that a limit kept by far still needs, after all other runs."""
        if not found.repeated:
            return found
        others = found.evaluations[len(found.drawn) :]
        rng = generator(self._study.seed, Stream.CERTIFICATE_CONTEXTS, self._attempt)
        rows = self._contexts.draw(most, rng)
        drawn = list(found.drawn)
        while (
            len(drawn) < most
            and decide_draws(self._study, drawn, most, self._confidence, subject.earlier, others)
            is None
        ):
            k = len(drawn)
            drawn.append(
                self._run(
                    Evaluation(
                        number,
                        k,
                        Stage.VALIDATION,
                        subject.parameters,
                        self._contexts.to_dict(rows[k]),
                        self._noise_seed(DRAWN, k),
                    )
                )
            )
        return replace(found, drawn=tuple(drawn))

    def _draw(self, subjects: Sequence[Subject], draws: int) -> list[list[Evaluation]]:
        self._observer.begin(DRAWS, draws)
        rng = generator(self._study.seed, Stream.CERTIFICATE_CONTEXTS, self._attempt)
        evaluations: list[list[Evaluation]] = [[] for _ in subjects]
        for k, row in enumerate(self._contexts.draw(draws, rng)):
            seed = self._noise_seed(DRAWN, k)
            context = self._contexts.to_dict(row)
            for number, subject in enumerate(subjects):
                planned = Evaluation(number, k, Stage.VALIDATION, subject.parameters, context, seed)
                evaluations[number].append(self._run(planned))
            self._observer.advance()
            if all(map(partial(self._clear, draws), subjects, evaluations)):
                break
        return evaluations

    def _clear(self, most: int, subject: Subject, drawn: Sequence[Evaluation]) -> bool:
        decided = self._decide_draws(subject, drawn, most)
        return decided is False or (decided is True and len(drawn) >= min(LEAST_DRAWS, most))

    def _decide_draws(
        self, subject: Subject, drawn: Sequence[Evaluation], most: int
    ) -> bool | None:
        return decide_draws(self._study, drawn, most, self._confidence, subject.earlier)

    def _look_closely(
        self, number: int, subject: Subject, drawn: Sequence[Evaluation], most: int
    ) -> Evidence:
        constraints = self._study.worst_case_constraints
        evidence = Evidence(subject.parameters, tuple(drawn), earlier=subject.earlier)
        if not constraints or self._decide_draws(subject, drawn, most) is False:
            return evidence
        search: list[Evaluation] = []

        def run(stage: Stage, context: Context, index: int, *key: int) -> Evaluation:
            # The key does not depend on the subject: the same noise for all.
            seed = self._noise_seed(*key)
            evaluation = self._run(
                Evaluation(number, index, stage, subject.parameters, context, seed)
            )
            self._observer.advance()
            return evaluation

        def evaluated(context: Context) -> Evaluation:
            search.append(run(Stage.SEARCH, context, len(search), SEARCHED, len(search)))
            if is_failed(search):
                raise _FailedError
            return search[-1]

        self._observer.begin(
            f"worst case of {subject.name}",
            len(constraints) * most_searched(self._contexts, len(subject.suspected))
            + _most_places(self._study, subject) * EXPECTED_REPEATS,
        )
        rng = generator(self._study.seed, Stream.CERTIFICATE_SEARCH, self._attempt, number)
        # They come first: where it failed before, a FAIL is soonest found.
        candidates: list[Context] = [*subject.earlier.contexts]
        failed_before = list(range(len(candidates)))
        found_by: dict[str, list[int]] = {}
        try:
            for index, constraint in enumerate(constraints):
                known = [*search, *drawn]
                # Not all of them may fit among the candidates; the constraint's own does.
                suspected = [*subject.suspected[index:], *subject.suspected[:index]]
                worst = self._find(constraint, evaluated, known, suspected, rng)
                candidates += [context for context in worst if context not in candidates]
                found_by[constraint.name] = sorted(
                    {*failed_before, *(candidates.index(context) for context in worst)}
                )
        except _FailedError:
            return replace(evidence, search=tuple(search))
        if subject.earlier.certified:
            known = [*search, *drawn, *subject.earlier.evaluations]
            for constraint in constraints:
                candidates += self._carry(constraint, known, candidates, rng)
        ranking = self._rank([*search, *drawn], candidates, subject.earlier.contexts, rng)
        # Where a limit is nearest comes first.
        nearness = [sum(c in item.clear for item in ranking.values()) for c in candidates]
        order = sorted(range(len(candidates)), key=lambda i: nearness[i])
        candidates = [candidates[i] for i in order]
        found_by = {k: sorted(order.index(i) for i in v) for k, v in found_by.items()}
        found = replace(
            evidence,
            search=tuple(search),
            repeated=((),) * len(candidates),
            ranking=ranking,
        )
        while (place := self._open_context(found, most)) is not None:
            here, k = found.repeated[place], len(found.repeated[place])
            new = run(Stage.CHECK_WORST, candidates[place], k, REPEATED, place, k)
            found = replace(
                found,
                repeated=(*found.repeated[:place], (*here, new), *found.repeated[place + 1 :]),
            )
        unvisited = {
            name: count
            for name, places in found_by.items()
            if (count := sum(not found.repeated[place] for place in places))
        }
        visited = tuple(here for here in found.repeated if here)
        unseen = frozenset(name for name in unvisited if unvisited[name] == len(found_by[name]))
        return replace(found, repeated=visited, unvisited=unvisited, unseen=unseen)

    def _rank(
        self,
        known: Sequence[Evaluation],
        candidates: Sequence[Context],
        failed_before: Sequence[Context],
        rng: np.random.Generator,
    ) -> dict[str, Ranking]:
        """Return by constraint what a model has of the candidates that have not failed before."""
        if self._study.certificate.distribution_free:
            return {}
        complete = [e for e in known if e.outcome.complete][:MOST_MODELLED]
        found = {}
        for constraint in self._study.worst_case_constraints:
            metric, sign = constraint.metric, constraint.sign
            runs = [(e.context, sign * e.outcome.metrics[metric]) for e in complete]
            limit = sign * constraint.limit
            clear, behind = rank(self._contexts, runs, candidates, limit, rng)
            found[constraint.name] = Ranking(
                tuple(context for context in clear if context not in failed_before),
                tuple(context for context in behind if context not in failed_before),
            )
        return found

    def _open_context(self, found: Evidence, most: int) -> int | None:
        """Return the context of the next evaluation; None if the verdict is clear.

        First those that must show a limit by their own runs. What was clear in a context may be
        open again after the runs in the next.
        """
        places = range(len(found.repeated))
        holds = [
            self._holds(found, place, most) if found.repeated[place] else None for place in places
        ]
        if False in holds:
            return None
        still = [place for place in places if holds[place] is None]
        if not still:
            return None
        alone = [p for p in still if not found.repeated[p] or not self._is_helped(found, p)]
        place = alone[0] if alone else min(still, key=lambda p: len(found.repeated[p]))
        return place if len(found.repeated[place]) < most else None

    def _is_helped(self, found: Evidence, place: int) -> bool:
        context = found.repeated[place][0].context
        return any(context in item.behind for item in found.ranking.values())

    def _find(
        self,
        constraint: Constraint,
        evaluated: Callable[[Context], Evaluation],
        known: Sequence[Evaluation],
        suspected: Sequence[Context],
        rng: np.random.Generator,
    ) -> list[Context]:
        """Search for the worst contexts of one constraint, after `known` evaluations."""
        metric, sign = constraint.metric, constraint.sign

        def violation(context: Context) -> float | None:
            value = evaluated(context).outcome.metrics.get(metric)
            return None if value is None else sign * value

        return find_worst_contexts(
            self._contexts,
            violation,
            [
                (evaluation.context, sign * evaluation.outcome.metrics[metric])
                for evaluation in known
                if evaluation.outcome.complete
            ],
            suspected,
            sign * constraint.limit,
            rng,
        )

    def _carry(
        self,
        constraint: Constraint,
        known: Sequence[Evaluation],
        candidates: Sequence[Context],
        rng: np.random.Generator,
    ) -> list[Context]:
        """Return the worst contexts by all runs, earlier ones as well, that are no candidates."""
        complete = [evaluation for evaluation in known if evaluation.outcome.complete]
        return worst_of_all(
            self._contexts,
            [evaluation.context for evaluation in complete],
            [constraint.sign * e.outcome.metrics[constraint.metric] for e in complete],
            candidates,
            rng,
        )

    def _holds(self, found: Evidence, place: int, most: int) -> bool | None:
        """Return whether every worst-case constraint holds in a context; None if open."""
        decided = [
            decide_context(self._study, constraint, found, place, most, self._confidence)
            for constraint in self._study.worst_case_constraints
        ]
        if False in decided:
            return False
        return None if None in decided else True

    def _noise_seed(self, *key: int) -> int:
        return noise_seed(self._study.seed, Stream.CERTIFICATE_NOISE, self._attempt, *key)

    def _run(self, planned: Evaluation) -> Evaluation:
        evaluation = evaluate(self._backend, planned, self._observer)
        self._losses.note(evaluation)
        self._losses.check()
        return evaluation
