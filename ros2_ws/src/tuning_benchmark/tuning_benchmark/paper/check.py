"""The recommended parameter set, after a check of the best candidates on fresh draws.

Candidates are selected by noisy evaluations, so the estimates from these are too optimistic. They
are therefore evaluated again, in fresh contexts from the distribution and, with fresh noise, in
their estimated worst context. These evaluations are added to the trial, and the ranking decides
among the candidates that passed the check.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bo_tuner.methods.protocol import AnswerSearch
from bo_tuner.methods.recommendation import Recommendation
from bo_tuner.methods.repetitions import (
    DRAWN_EVALUATIONS,
    most_check_evaluations,
    repetitions_of,
    worst_evaluations,
)
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.ranking import Candidate, Ranking
from bo_tuner.plans import Run
from bo_tuner.study.limits import judge_sample, judge_samples, refuted
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Trial, WorstCase

EXPECTED_CHECKS = 2
"""Candidates that are expected to be checked: as if every other one passed."""


@dataclass(frozen=True)
class CandidateCheck:
    """The check of the best candidates on fresh draws before the answer.

    Attributes
    ----------
    most
        Largest number of candidates to check; with 0 the first in rank is the answer, unchecked.
    """

    most: int = 6

    def search(
        self, study: Study, trials: Sequence[Trial], ranking: Ranking[Surrogates]
    ) -> "CheckedAnswer":
        """Make the search for the answer."""
        return CheckedAnswer(study, trials, ranking, self.most)

    def most_evaluations(self, study: Study) -> int:
        """Return the largest number of evaluations of all checks."""
        return self.most * most_check_evaluations(study)

    def expected_evaluations(self, study: Study, made: int) -> int:
        """Return how many evaluations are expected after those `made`: two checks or more."""
        size = most_check_evaluations(study)
        ended = made // size
        expected = min(max(EXPECTED_CHECKS, ended + 1), self.most)
        return max(0, expected * size - made)


class CheckedAnswer(AnswerSearch):
    """The search for the answer by checks of candidates.

    The trials are ranked again after each check, until the first in rank has passed its check. An
    unusable evaluation, lost with its nodes or disturbed by others, is asked for again. Those of
    one check are independent of each other, but none follows one that failed.

    Parameters
    ----------
    study, trials
        Of the run.
    ranking
        Of the trials.
    most
        Largest number of candidates to check.

    Attributes
    ----------
    steps
        Checked candidates, at most.
    answer
        The recommendation, once there is nothing more to ask.
    """

    what = "test runs of the check"

    def __init__(
        self, study: Study, trials: Sequence[Trial], ranking: Ranking[Surrogates], most: int
    ) -> None:
        self._study = study
        self._ranking = ranking
        self._latest = {trial.number: trial for trial in trials}
        self._held: set[int] = set()
        self._checked: list[int] = []
        self._candidate: Trial | None = None
        self._plan: list[tuple[Stage, Context]] = []
        self._check: dict[int, Evaluation] = {}
        self._awaited = 0
        self.steps = most

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next evaluation of a check; the next candidate follows from all of them."""
        trial = self._candidate or self._next_candidate()
        if trial is None or self._failed:
            return None
        first = len(trial.evaluations)
        taken = {*self._check, *(task.evaluation.index - first for task in pending)}
        place = next((k for k in range(len(self._plan)) if k not in taken), None)
        if place is None:
            return None
        stage, context = self._plan[place]
        index = first + place
        seed = noise_seed(self._study.seed, Stream.CHECK_NOISE, trial.number, index)
        self._awaited += 1
        return Run(Evaluation(trial.number, index, stage, trial.parameters, context, seed))

    def tell(self, task: Run) -> bool:
        """Add an evaluation; returns whether a check has ended with it."""
        trial, evaluation = self._candidate, task.evaluation
        if trial is None:
            return False
        self._awaited -= 1
        if not evaluation.outcome.unusable:
            self._check[evaluation.index - len(trial.evaluations)] = evaluation
        if self._awaited or not (self._failed or len(self._check) == len(self._plan)):
            return False
        check = [self._check[place] for place in sorted(self._check)]
        self._latest[trial.number], holds = with_check(self._study, trial, check)
        self._checked.append(trial.number)
        if holds:
            self._held.add(trial.number)
        self._candidate = None
        return True

    @property
    def _failed(self) -> bool:
        """Whether the present check has failed already."""
        return not all(e.outcome.complete for e in self._check.values())

    def _next_candidate(self) -> Trial | None:
        """Return the candidate to check next; without one there is the answer."""
        ranked = self._ranking.rank(self._study, list(self._latest.values()))
        if not ranked:
            return None
        # In a space smaller than the budget trials repeat a set; each set is checked once.
        sets = {self._latest[number].parameter_set for number in self._checked}
        open_ones = [
            candidate
            for candidate in ranked
            if candidate.believed_feasible
            and (candidate.trial.number in self._held or candidate.trial.parameter_set not in sets)
        ]
        if open_ones:
            best = open_ones[0]
            if best.trial.number in self._held or self.steps == 0:
                self.answer = self._recommendation(best, True, ranked)
                return None
            if len(self._checked) < self.steps:
                self._begin(best.trial)
                return best.trial
        self.answer = self._without_a_leader(ranked, open_ones)
        return None

    def _begin(self, trial: Trial) -> None:
        contexts = self._study.context_space()
        rng = generator(self._study.seed, Stream.CHECK_CONTEXTS, trial.number)
        drawn = contexts.draw_stratified(DRAWN_EVALUATIONS, rng)
        self._candidate, self._check, self._awaited = trial, {}, 0
        self._plan = [(Stage.CHECK_DRAWN, contexts.to_dict(row)) for row in drawn]
        for worst_context in _worst_contexts(trial):
            self._plan += [(Stage.CHECK_WORST, worst_context)] * worst_evaluations(self._study)

    def _without_a_leader(
        self, ranked: Sequence[Candidate], open_ones: Sequence[Candidate]
    ) -> Recommendation:
        """Return the answer where the first in rank has passed no check, and none is left."""
        kept = next((c for c in ranked if c.trial.number in self._held), None)
        if kept is not None:
            return self._recommendation(kept, kept.believed_feasible, ranked)
        # Among several within the limits the first in rank, not the one with the largest margin: a
        # machine that hardly moves keeps every limit.
        crashed = {c.trial.parameter_set for c in ranked if c.trial.failed_again}
        others = [c for c in ranked if c.trial.parameter_set not in crashed] or ranked
        least = open_ones[0] if open_ones else min(others, key=lambda c: max(c.violation, 0.0))
        return self._recommendation(least, False, ranked)

    def _recommendation(
        self, candidate: Candidate, feasible: bool, ranked: Sequence[Candidate]
    ) -> Recommendation:
        return Recommendation(candidate, feasible, tuple(self._checked), tuple(ranked))


def with_checks(
    study: Study, trials: Sequence[Trial], evaluations: Iterable[Evaluation]
) -> list[Trial]:
    """Give trials their checks on record, see `Method.checked`."""
    known = repetitions_of(evaluations)
    return [with_check(study, trial, known.get(trial.number, ()))[0] for trial in trials]


def with_check(study: Study, trial: Trial, check: Sequence[Evaluation]) -> tuple[Trial, bool]:
    """Add the evaluations of a check to a trial, and judge all constraints.

    A check that is not complete is not passed, and leaves the estimated worst case as it is.

    Parameters
    ----------
    study
        The study.
    trial
        The trial before the check.
    check
        Evaluations of the check, all of them unless one is not complete.

    Returns
    -------
    trial
        With the evaluations of the check and the worst case estimated from them.
    passed
        Whether the check is complete and all constraints hold.
    """
    extended = replace(trial, evaluations=trial.evaluations + tuple(check))
    completed = len(check) == _size(study, trial) and all(e.outcome.complete for e in check)
    if not completed:
        return extended, False
    holds = all(
        judge_sample(chance, extended.observations(chance.metric)).agrees
        for chance in study.drawn_constraints
    )
    samples = judge_samples(study, [e for e in check if e.stage is Stage.CHECK_DRAWN])
    repeated = [e for e in check if e.stage is Stage.CHECK_WORST]
    worst_cases: dict[str, WorstCase] = {}
    for constraint in study.worst_case_constraints:
        worst = trial.worst_cases.get(constraint.name)
        if worst is None:
            continue
        values = _values([e for e in repeated if e.context == worst.context], constraint.metric)
        holds = holds and not refuted(constraint, values) and samples[constraint.name].agrees
        worst_cases[constraint.name] = replace(
            worst,
            value=float(np.mean(values)),
            observed=constraint.farthest([worst.observed, *values]),
        )
    return replace(extended, worst_cases=worst_cases), holds


def _size(study: Study, trial: Trial) -> int:
    """Return the number of evaluations in the check of a trial."""
    return DRAWN_EVALUATIONS + worst_evaluations(study) * len(_worst_contexts(trial))


def _worst_contexts(trial: Trial) -> list[Context]:
    """Return the different worst contexts of a trial, in the order of the constraints."""
    contexts: list[Context] = []
    for worst in trial.worst_cases.values():
        if dict(worst.context) not in contexts:
            contexts.append(dict(worst.context))
    return contexts


def _values(evaluations: Sequence[Evaluation], metric: str) -> list[float]:
    return [e.outcome.metrics[metric] for e in evaluations]
