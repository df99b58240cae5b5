"""The search for the worst contexts of a parameter set, and the repeated runs in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.evidence.certificate.decisions import is_failed
from bo_tuner.evidence.certificate.findings import Evidence
from bo_tuner.evidence.certificate.independent_search import (
    CARRIED,
    find_worst_contexts,
    most_candidates,
    most_searched,
    worst_of_all,
)
from bo_tuner.evidence.certificate.plan import REPEATED, SEARCHED, Case, CertificatePlan, Subject
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.plans import Batches, BatchPlan, Plan, Run
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage


def most_places(study: Study, subject: Subject) -> int:
    """Return the largest number of contexts in which a subject is evaluated again and again."""
    constraints = len(study.worst_case_constraints)
    if not constraints or not study.contexts:
        return constraints
    per_constraint = most_candidates(study.context_space())
    if subject.earlier.certified and not study.context_space().is_discrete:
        per_constraint += CARRIED
    return len(subject.earlier.contexts) + constraints * per_constraint


@dataclass(frozen=True)
class _Suspects:
    """Contexts that may be the worst ones, with the places of those that each constraint found."""

    contexts: Sequence[Context]
    found_by: Mapping[str, Sequence[int]]


class WorstCasePlan(CertificatePlan):
    """The search for the worst contexts of a subject, then repeated runs in them.

    Attributes
    ----------
    evidence
        With the runs that have ended.
    """

    def __init__(self, case: Case, number: int, subject: Subject, evidence: Evidence) -> None:
        super().__init__()
        self._case = case
        self._number = number
        self._subject = subject
        self._search = BatchPlan(self._suspects(), lambda _: is_failed(self.evidence.search))
        self._repeats: RepeatPlan | None = None
        self.evidence = evidence
        study = case.study
        self.phase = f"worst case of {subject.name}"
        searched = most_searched(study.context_space(), len(subject.suspected))
        self.steps = len(study.worst_case_constraints) * searched + most_places(study, subject) * (
            1 if study.is_noiseless else case.most
        )

    def _next(self, pending: Sequence[Run]) -> Run | None:
        """Return the next evaluation of the search, or in one of the contexts that it found."""
        if self._repeats is not None:
            return self._repeats.ask(pending)
        task = self._search.ask(pending)
        if task is not None or pending or self._search.result is None:
            return task
        suspects = self._search.result
        evidence = replace(self.evidence, repeated=((),) * len(suspects.contexts))
        self._repeats = RepeatPlan(self._case, self._number, evidence, suspects)
        self.evidence = self._repeats.visited
        return self._repeats.ask(pending)

    def tell(self, task: Run) -> bool:
        """Add an evaluation, which is a step."""
        if self._repeats is None:
            self.evidence = replace(self.evidence, search=(*self.evidence.search, task.evaluation))
            return self._search.tell(task)
        self._repeats.tell(task)
        self.evidence = self._repeats.visited
        return True

    def _suspects(self) -> Batches[_Suspects | None]:
        """Search for each constraint; nothing is found where an evaluation has failed: a FAIL."""
        study, subject = self._case.study, self._subject
        drawn = self.evidence.drawn
        key = Stream.CERTIFICATE_SEARCH, self._case.attempt, self._number
        rng = generator(study.seed, *key)
        # They come first: where it failed before, a FAIL is soonest reached.
        candidates: list[Context] = [*subject.earlier.contexts]
        failed_before = range(len(candidates))
        found_by: dict[str, list[int]] = {}
        for index, constraint in enumerate(study.worst_case_constraints):
            # Not all of them may fit among the candidates; the constraint's own does.
            suspected = [*subject.suspected[index:], *subject.suspected[:index]]
            worst = yield from self._find(constraint, suspected, rng)
            if worst is None:
                return None
            candidates += [context for context in worst if context not in candidates]
            places = (candidates.index(context) for context in worst)
            found_by[constraint.name] = sorted({*failed_before, *places})
        if subject.earlier.certified:
            known = [*self.evidence.search, *drawn, *subject.earlier.evaluations]
            for constraint in study.worst_case_constraints:
                candidates += self._carry(constraint, known, candidates, rng)
        return _Suspects(candidates, found_by)

    def _find(
        self, constraint: Constraint, suspected: Sequence[Context], rng: np.random.Generator
    ) -> Batches[list[Context] | None]:
        """Search for the worst contexts of one constraint; None if an evaluation has failed."""
        metric, sign = constraint.metric, constraint.sign
        known = [*self.evidence.search, *self.evidence.drawn]
        search = find_worst_contexts(
            self._case.study.context_space(),
            [
                (evaluation.context, sign * evaluation.outcome.metrics[metric])
                for evaluation in known
                if evaluation.outcome.complete
            ],
            suspected,
            sign * constraint.limit,
            rng,
        )
        values: list[float | None] | None = None
        while True:
            try:
                contexts = next(search) if values is None else search.send(values)
            except StopIteration as end:
                worst: list[Context] = end.value
                return worst
            ran = yield [self._searched(context, k) for k, context in enumerate(contexts)]
            if is_failed(self.evidence.search):
                return None
            values = [sign * e.outcome.metrics[metric] if e.outcome.complete else None for e in ran]

    def _searched(self, context: Context, place: int) -> Evaluation:
        index = len(self.evidence.search) + place
        seed = self._case.noise_seed(SEARCHED, index)
        return Evaluation(
            self._number, index, Stage.SEARCH, self._subject.parameters, context, seed
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
            self._case.study.context_space(),
            [evaluation.context for evaluation in complete],
            [constraint.sign * e.outcome.metrics[constraint.metric] for e in complete],
            candidates,
            rng,
        )


class RepeatPlan(Plan[Run]):
    """Repeated runs in contexts that may be the worst, in their order, until each is clear."""

    def __init__(self, case: Case, number: int, evidence: Evidence, suspects: _Suspects) -> None:
        self._case = case
        self._number = number
        self._evidence = evidence
        self._suspects = suspects
        self._places: dict[int, int] = {}

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next run in a context that takes more."""
        counts = [len(here) for here in self._evidence.repeated]
        for task in pending:
            counts[self._places[task.evaluation.seed]] += 1
        place = self._open_context()
        if place is None:
            return None
        k = counts[place]
        if k >= self._case.most:
            return None
        seed = self._case.noise_seed(REPEATED, place, k)
        self._places[seed] = place
        parameters, context = self._evidence.parameters, self._suspects.contexts[place]
        return Run(Evaluation(self._number, k, Stage.CHECK_WORST, parameters, context, seed))

    def tell(self, task: Run) -> bool:
        """Add a run."""
        place, groups = self._places[task.evaluation.seed], list(self._evidence.repeated)
        groups[place] = (*groups[place], task.evaluation)
        self._evidence = replace(self._evidence, repeated=tuple(groups))
        return True

    @property
    def visited(self) -> Evidence:
        """The evidence, with the contexts alone in which there was a run."""
        evidence, found_by = self._evidence, self._suspects.found_by
        unvisited = {
            name: count
            for name, places in found_by.items()
            if (count := sum(not evidence.repeated[place] for place in places))
        }
        return replace(
            evidence,
            repeated=tuple(here for here in evidence.repeated if here),
            unvisited=unvisited,
            unseen=frozenset(name for name in unvisited if unvisited[name] == len(found_by[name])),
        )

    def _open_context(self) -> int | None:
        """Return the context of the next run; None if the verdict is clear.

        What was clear in a context may be open again after the runs in the next.
        """
        for place, here in enumerate(self._evidence.repeated):
            holds = self._case.holds(self._evidence, place) if here else None
            if not holds:
                return place if holds is None else None
        return None
