"""The evaluations of a certificate: common fresh draws, then the worst contexts of each subject.

They end as soon as the verdict is clear; `most_evaluations` says when at the latest.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.evidence.certificate.economy import least_draws
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
from bo_tuner.evidence.certificate.judgement import (
    contradiction,
    decide_context,
    decide_draws,
    is_failed,
)
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.plans import Batches, BatchPlan, Plan, Run
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Value
from bo_tuner.tuning.driver import Driver

EXPECTED_REPEATS = 25
"""Evaluations in each context that may be the worst, in a clear case; for the progress display."""

DRAWS = "draws"
"""Name of the first phase; the others are searches."""

REPEATS = 3
"""Draws of each subject that are run once more with another seed if they are to have no noise."""

DRAWN, SEARCHED, REPEATED, CHECKED = 0, 1, 2, 3
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
        drawn=len(subjects) * (draws + (REPEATS if study.is_noiseless else 0)),
        searched=constraints * sum(most_searched(space, len(s.suspected)) for s in subjects),
        repeated=places * (1 if study.is_noiseless else draws),
    )


def _most_places(study: Study, subject: Subject) -> int:
    """Return the largest number of contexts in which a subject is evaluated again and again."""
    constraints = len(study.worst_case_constraints)
    if not constraints or not study.contexts:
        return constraints
    per_constraint = CANDIDATES + (CARRIED if subject.earlier.certified else 0)
    return len(subject.earlier.contexts) + constraints * per_constraint


class Certification:
    """Collects the evidence for a certificate.

    Parameters
    ----------
    study
        The study.
    driver
        Carries out the plans.
    confidence
        Confidence of each bound.
    attempt
        Number of the attempt to certify a parameter set of the run, from 1: each has own draws.
    finishing
        Returns whether no more runs are to be begun.

    Attributes
    ----------
    cut_short
        Whether runs are missing for that reason: the evidence decides nothing.
    """

    def __init__(
        self,
        study: Study,
        driver: Driver,
        *,
        confidence: float,
        attempt: int = 1,
        finishing: Callable[[], bool] = lambda: False,
    ) -> None:
        self._study = study
        self._driver = driver
        self._confidence = confidence
        self._attempt = attempt
        self._finishing = finishing
        self.cut_short = False

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
        case = _Case(self._study, self._confidence, self._attempt, draws)
        repeats = RepeatedDraws(case, subjects)
        if self._study.is_noiseless:
            self._complete(repeats)
        drawing = DrawPlan(case, subjects, repeats.evaluations)
        self._complete(drawing)
        searched = [
            self._look_closely(case, number, subject, drawing.evidence(number))
            for number, subject in enumerate(subjects)
        ]
        return [
            self._draw_on(case, number, subject, evidence)
            for number, (subject, evidence) in enumerate(zip(subjects, searched, strict=True))
        ]

    def _look_closely(
        self, case: "_Case", number: int, subject: Subject, evidence: Evidence
    ) -> Evidence:
        if (
            self.cut_short
            or not self._study.worst_case_constraints
            or case.decided(subject, evidence.drawn) is False
            or contradiction(self._study, evidence.evaluations)
        ):
            return evidence
        plan = WorstCasePlan(case, number, subject, evidence)
        self._complete(plan)
        return plan.evidence

    def _draw_on(
        self, case: "_Case", number: int, subject: Subject, evidence: Evidence
    ) -> Evidence:
        """Make the draws that the limits need beside all other runs, if they are kept there."""
        places = range(len(evidence.repeated))
        others = evidence.others
        if (
            self.cut_short
            or contradiction(self._study, evidence.evaluations)
            or not places
            or any(case.open_limits(evidence, place) != [] for place in places)
            or case.decided(subject, evidence.drawn, others) is not None
        ):
            return evidence
        plan = FurtherDrawPlan(case, number, subject, evidence)
        self._complete(plan)
        return plan.evidence

    def _complete(self, plan: "_CertificatePlan") -> None:
        if self._finishing():
            plan.finish()
        self._driver.complete(plan)
        self.cut_short = self.cut_short or plan.cut_short


@dataclass(frozen=True)
class _Case:
    """What all evaluations of a certificate have in common; `most` of them in each context."""

    study: Study
    confidence: float
    attempt: int
    most: int

    def decided(
        self,
        subject: Subject,
        drawn: Sequence[Evaluation],
        others: Sequence[Evaluation] | None = None,
    ) -> bool | None:
        """Return whether a subject keeps its limits in draws, with other runs; None if open."""
        return decide_draws(self.study, drawn, self.most, self.confidence, subject.earlier, others)

    def open_limits(self, evidence: Evidence, place: int) -> list[str] | None:
        """Return the worst-case constraints that are open in a context; None if one is broken."""
        undecided = []
        for constraint in self.study.worst_case_constraints:
            holds = decide_context(
                self.study, constraint, evidence, place, self.most, self.confidence
            )
            if holds is False:
                return None
            if holds is None:
                undecided.append(constraint.name)
        return undecided

    def draw(self) -> list[Context]:
        """Return the contexts of all draws."""
        space = self.study.context_space()
        rng = generator(self.study.seed, Stream.CERTIFICATE_CONTEXTS, self.attempt)
        return [space.to_dict(row) for row in space.draw(self.most, rng)]

    def draw_seed(self, number: int) -> int:
        """Return the seed of a draw; without noise draws differ by their contexts alone."""
        return self.noise_seed(DRAWN, 0 if self.study.is_noiseless else number)

    def noise_seed(self, *key: int) -> int:
        """Return a seed; it does not depend on the subject: the same noise for all."""
        return noise_seed(self.study.seed, Stream.CERTIFICATE_NOISE, self.attempt, *key)


class _CertificatePlan(Plan[Run]):
    """A phase of a certificate, which may be told to begin no more runs.

    Attributes
    ----------
    cut_short
        Whether there were more to begin.
    """

    def __init__(self) -> None:
        self._finishing = False
        self.cut_short = False

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next run, unless no more are to be begun."""
        if self.cut_short:
            return None
        task = self._next(pending)
        if task is not None and self._finishing:
            self.cut_short = True
            return None
        return task

    def finish(self) -> bool:
        """Begin no more runs; those that were begun count."""
        before, self._finishing = self._finishing, True
        return not before

    @abstractmethod
    def _next(self, pending: Sequence[Run]) -> Run | None:
        """Return the next run, as `ask`."""


class DrawPlan(_CertificatePlan):
    """All subjects in the same draws, until these are clear for every subject.

    Draws that were planned before it was clear count, too.

    Parameters
    ----------
    case
        The certificate.
    subjects
        The parameter sets.
    repeats
        Of each of them, draws that were run with other seeds.

    Attributes
    ----------
    evaluations
        Of each subject.
    """

    phase = DRAWS

    def __init__(
        self, case: _Case, subjects: Sequence[Subject], repeats: Sequence[Sequence[Evaluation]]
    ) -> None:
        super().__init__()
        self._repeats = repeats
        self._case = case
        self._subjects = subjects
        self._clear = False
        self._contexts = case.draw()
        self.steps = case.most
        self.evaluations: list[list[Evaluation]] = [[] for _ in subjects]

    def _next(self, pending: Sequence[Run]) -> Run | None:
        """Return the next subject in a draw, or one in the next draw."""
        count = len(self._subjects)
        k, place = divmod(sum(map(len, self.evaluations)) + len(pending), count)
        if k == len(self._contexts) or (self._clear and place == 0):
            return None
        # By turns the first and the last is first: a machine that warms up is no difference.
        number = count - 1 - place if k % 2 else place
        parameters, context = self._subjects[number].parameters, self._contexts[k]
        seed = self._case.draw_seed(k)
        return Run(Evaluation(number, k, Stage.VALIDATION, parameters, context, seed))

    def tell(self, task: Run) -> bool:
        """Add an evaluation; a draw of all subjects is a step."""
        self.evaluations[task.evaluation.trial].append(task.evaluation)
        if len({len(drawn) for drawn in self.evaluations}) > 1:
            return False
        self._clear = all(map(self._is_clear, range(len(self._subjects))))
        return True

    def evidence(self, number: int) -> Evidence:
        """Return the draws of a subject as evidence, with what was run before them."""
        subject, drawn = self._subjects[number], tuple(self.evaluations[number])
        repeats = tuple(self._repeats[number])
        return Evidence(subject.parameters, drawn, earlier=subject.earlier, repeats=repeats)

    def _is_clear(self, number: int) -> bool:
        subject, drawn = self._subjects[number], self.evaluations[number]
        if contradiction(self._case.study, [*self._repeats[number], *drawn]):
            return True
        # Several are compared in the same draws, so that none may need more of them later.
        decided = self._case.decided(subject, drawn, None if len(self._subjects) == 1 else ())
        least = min(least_draws(self._case.study), self._case.most)
        return decided is False or (decided is True and len(drawn) >= least)


class RepeatedDraws(_CertificatePlan):
    """The first draws of all subjects with other seeds, which are to change nothing.

    Parameters
    ----------
    case
        The certificate.
    subjects
        The parameter sets.

    Attributes
    ----------
    evaluations
        Of each subject.
    """

    phase = "repeats without noise"

    def __init__(self, case: _Case, subjects: Sequence[Subject]) -> None:
        super().__init__()
        contexts = case.draw()[:REPEATS]
        self._planned = iter(
            Evaluation(
                number,
                k,
                Stage.CHECK_DRAWN,
                subject.parameters,
                context,
                case.noise_seed(CHECKED, k),
            )
            for number, subject in enumerate(subjects)
            for k, context in enumerate(contexts)
        )
        self.steps = len(subjects) * len(contexts)
        self.evaluations: list[list[Evaluation]] = [[] for _ in subjects]

    def _next(self, pending: Sequence[Run]) -> Run | None:
        planned = next(self._planned, None)
        return None if planned is None else Run(planned)

    def tell(self, task: Run) -> bool:
        """Add a run, which is a step."""
        self.evaluations[task.evaluation.trial].append(task.evaluation)
        return True


class FurtherDrawPlan(_CertificatePlan):
    """More draws of one subject, as its other runs were too few beside those that it has.

    Parameters
    ----------
    case
        The certificate.
    number
        Of the subject.
    subject
        The parameter set.
    evidence
        All its runs.

    Attributes
    ----------
    evidence
        With the runs that have ended.
    """

    phase = "more draws"

    def __init__(self, case: _Case, number: int, subject: Subject, evidence: Evidence) -> None:
        super().__init__()
        self._case = case
        self._number = number
        self._subject = subject
        self._others = evidence.others
        self._contexts = case.draw()
        self.evidence = evidence
        self.steps = case.most - len(evidence.drawn)

    def _next(self, pending: Sequence[Run]) -> Run | None:
        """Return the next draw."""
        drawn = self.evidence.drawn
        k = len(drawn) + len(pending)
        if (
            k == len(self._contexts)
            or self._case.decided(self._subject, drawn, self._others) is not None
        ):
            return None
        seed = self._case.draw_seed(k)
        parameters, context = self._subject.parameters, self._contexts[k]
        return Run(Evaluation(self._number, k, Stage.VALIDATION, parameters, context, seed))

    def tell(self, task: Run) -> bool:
        """Add a draw."""
        self.evidence = replace(self.evidence, drawn=(*self.evidence.drawn, task.evaluation))
        return True


@dataclass(frozen=True)
class _Suspects:
    """Contexts that may be the worst ones.

    Each constraint has searched for some of them, and has ranked them by a model over the contexts.
    """

    contexts: Sequence[Context]
    found_by: Mapping[str, Sequence[int]]
    ranking: Mapping[str, Ranking]


class WorstCasePlan(_CertificatePlan):
    """The search for the worst contexts of a subject, then repeated runs in them.

    Parameters
    ----------
    case
        The certificate.
    number
        Of the subject.
    subject
        The parameter set.
    evidence
        Of its draws.

    Attributes
    ----------
    evidence
        With the runs that have ended.
    """

    def __init__(self, case: _Case, number: int, subject: Subject, evidence: Evidence) -> None:
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
        self.steps = (
            len(study.worst_case_constraints) * searched
            + _most_places(study, subject) * EXPECTED_REPEATS
        )

    def _next(self, pending: Sequence[Run]) -> Run | None:
        """Return the next evaluation of the search, or in one of the contexts that it found."""
        if self._repeats is not None:
            return self._repeats.ask(pending)
        task = self._search.ask(pending)
        if task is not None or pending or self._search.result is None:
            return task
        suspects = self._search.result
        evidence = replace(
            self.evidence,
            repeated=((),) * len(suspects.contexts),
            ranking=suspects.ranking,
        )
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
        ranking = self._rank(candidates, rng)
        # Those in which limits are kept by far come last.
        kept = [sum(context in item.clear for item in ranking.values()) for context in candidates]
        order = sorted(range(len(candidates)), key=lambda place: kept[place])
        return _Suspects(
            [candidates[place] for place in order],
            {name: sorted(map(order.index, places)) for name, places in found_by.items()},
            ranking,
        )

    def _rank(self, candidates: Sequence[Context], rng: np.random.Generator) -> dict[str, Ranking]:
        """Return by constraint what a model has of the contexts that have not failed before."""
        study, failed_before = self._case.study, self._subject.earlier.contexts
        if study.certificate.distribution_free:
            return {}
        known = [*self.evidence.search, *self.evidence.drawn]
        complete = [evaluation for evaluation in known if evaluation.outcome.complete]
        rankings = {}
        for constraint in study.worst_case_constraints:
            metric, sign = constraint.metric, constraint.sign
            clear, behind = rank(
                study.context_space(),
                [(e.context, sign * e.outcome.metrics[metric]) for e in complete[:MOST_MODELLED]],
                candidates,
                sign * constraint.limit,
                rng,
            )
            rankings[constraint.name] = Ranking(
                tuple(context for context in clear if context not in failed_before),
                tuple(context for context in behind if context not in failed_before),
            )
        return rankings

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
    """Repeated runs in contexts that may be the worst, until each is clear.

    First in the worst ones; those in which the limits are kept by far come last.

    Parameters
    ----------
    case
        The certificate.
    number
        Of the subject.
    evidence
        Of its draws and its search, with an empty group of runs for each context.
    suspects
        The contexts.
    """

    def __init__(self, case: _Case, number: int, evidence: Evidence, suspects: _Suspects) -> None:
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
        every = [constraint.name for constraint in self._case.study.worst_case_constraints]
        open_at: dict[int, list[str]] = {}
        for place, here in enumerate(self._evidence.repeated):
            names = self._case.open_limits(self._evidence, place) if here else every
            if names is None:
                return None
            if names:
                open_at[place] = names
        if not open_at:
            return None
        return min(open_at, key=lambda place: (self._turn(place, open_at[place]), place))

    def _turn(self, place: int, names: Sequence[str]) -> int:
        """Return when it is a context's turn, by the limits that are open there: the least first.

        The worst ones; then those behind them; then those in which the limits are kept by far.
        """
        context = self._suspects.contexts[place]
        items = [self._suspects.ranking.get(name, Ranking()) for name in names]
        if all(context in item.clear for item in items):
            return 2
        if all(context in (*item.clear, *item.behind) for item in items):
            return 1
        return 0
