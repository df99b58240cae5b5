"""The answer of `boundary`: the parameter sets that are run again before it.

Parameter sets are run again, a few runs at a time, until it is settled which one is the answer
(`repetition`) or the repetitions are used up. These runs are added to their trials. No further
check of the answer follows: the posterior that chooses it has them among its data.

With several objectives the answer is the compromise. Once that is settled, the runs that are left
settle what is best with weights that lean towards each of the objectives: what is shown to keep its
limits there is on the front.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from bo_tuner.methods.boundary.judging import PooledRanking
from bo_tuner.methods.boundary.passed_over import passed_over
from bo_tuner.methods.boundary.repetition import OwnRuns, Repetition, lacking, next_repetition
from bo_tuner.methods.protocol import AnswerSearch
from bo_tuner.methods.recommendation import Recommendation
from bo_tuner.methods.repetitions import most_check_evaluations, repetitions_of
from bo_tuner.models.bias import Bias
from bo_tuner.models.estimates import estimated
from bo_tuner.models.pooled_models import PooledModels, PooledSurrogates
from bo_tuner.models.scalarization import leaning_weights
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.optimizers.bayesian import latest_hyperparameters
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.plans import Run
from bo_tuner.study.study import Study
from bo_tuner.trials import CHECKS, TUNING, Context, Evaluation, Stage, Trial, TrialState


@dataclass(frozen=True)
class Repetitions:
    """How many evaluations are those of parameter sets that are run again.

    Attributes
    ----------
    share
        Repetitions, at most, for each evaluation of the trials; 0 for none at all.
    """

    share: float = 1.0 / 6.0

    def most(self, study: Study, evaluations: int, made: int = 0) -> int:
        """Return the largest number of repetitions after trials with these evaluations.

        It is a share of the evaluations less the repetitions `made` already, and at least what the
        check of one candidate takes.
        """
        if not self.share:
            return 0
        return max(most_check_evaluations(study), math.ceil(self.share * evaluations) - made)


class SettledAnswer(AnswerSearch):
    """The search for the answer by repetitions.

    Those between two choices of what is run again are independent of each other.

    Parameters
    ----------
    study, trials
        Of the run; repetitions that the trials have already are data, too.
    ranking
        Of the parameter sets.
    required
        Runs of its own that the answer must have.
    most
        Largest number of further repetitions.
    comparing
        Models of machine and simulation, which say how far these differ; None without one.

    Attributes
    ----------
    steps
        Repetitions, at most; each evaluation is one.
    answer
        The recommendation, once there is nothing more to ask. ``checked`` are the trials that were
        run again.
    """

    what = "repetitions"

    def __init__(
        self,
        study: Study,
        trials: Sequence[Trial],
        ranking: PooledRanking,
        required: OwnRuns,
        most: int,
        comparing: PooledModels | None = None,
    ) -> None:
        self._study = study
        self._comparing = comparing
        self._ranking = ranking
        self._required = required
        self._latest = {trial.number: trial for trial in trials}
        self._repeated = [t.number for t in trials for e in t.evaluations if e.stage in CHECKS]
        self._most = most + len(self._repeated)
        self._candidates: list[Candidate] = []
        self._choice: Repetition | None = None
        self._unplanned = self._planned = 0
        self.steps = most

    def finish(self) -> bool:
        """Run no more again; the answer is the best by the runs that were planned until now."""
        if self.finished is not None:
            return False
        self.finished = self._planned
        return True

    @property
    def _is_finished(self) -> bool:
        return self.finished is not None and self._planned >= self.finished

    def ask(self, pending: Sequence[Run]) -> Run | None:
        """Return the next repetition; what is run again after these is chosen by all of them."""
        if self._is_finished:
            self._unplanned = 0
        if not self._unplanned and not pending:
            self._choose()
        if not self._unplanned or self._choice is None:
            return None
        self._unplanned -= 1
        self._planned += 1
        trial = self._latest[self._choice.trial.number]
        index = len(trial.evaluations) + len(pending)
        return Run(_planned(self._study, trial, self._choice.context, index))

    def tell(self, task: Run) -> bool:
        """Add a repetition, which is a step; after one that failed the choice is another one."""
        number = task.evaluation.trial
        self._latest[number] = with_repetitions(self._latest[number], [task.evaluation])
        self._repeated.append(number)
        if not task.evaluation.outcome.complete:
            self._unplanned = 0
        return True

    def _choose(self) -> None:
        """Choose what is run again next; without a choice there is the answer."""
        study, known = self._study, list(self._latest.values())
        models = self._ranking.models(study, known)
        before, self._candidates = self._candidates, self._ranking.ranked_by(models, study, known)
        left = 0 if self._is_finished else self._most - len(self._repeated)
        self._choice = None
        if self._candidates and left:
            choice = self._next(models, self._candidates, left)
            self._choice = choice or self._of_front(models, left)
        if self._choice is not None:
            self._unplanned = min(self._choice.runs, left)
        elif self._candidates:
            self.answer = self._settled(models)
        elif before:
            # Every candidate has failed when it was run again.
            self.answer = Recommendation(before[0], False, tuple(self._repeated), tuple(before))

    def _next(
        self, models: PooledSurrogates, candidates: Sequence[Candidate], left: int
    ) -> Repetition | None:
        return next_repetition(self._study, models, candidates, left, self._required)

    def _of_front(self, models: PooledSurrogates, left: int) -> Repetition | None:
        """Return runs that settle what is best with other weights than those of the compromise."""
        study, known = self._study, list(self._latest.values())
        count = len(study.objectives)
        for weights in leaning_weights(count) if count > 1 else ():
            leaning = models.weighted(weights)
            candidates = self._ranking.ranked_by(leaning, study, known)
            choice = self._next(leaning, candidates, left)
            if choice is not None:
                return choice
        return None

    def _settled(self, models: PooledSurrogates) -> Recommendation:
        candidates = _with_own_runs_first(self._study, models, self._candidates, self._required)
        best = candidates[0]
        return Recommendation(
            replace(best, trial=estimated(self._study, models, best.trial)),
            best.believed_feasible,
            tuple(dict.fromkeys(self._repeated)),
            tuple(candidates),
            passed_over(models, best, candidates),
            self._biases(best.trial),
        )

    def _biases(self, trial: Trial) -> tuple[Bias, ...]:
        """Return how far machine and simulation differ at the parameter set of a trial."""
        if self._comparing is None:
            return ()
        study, known = self._study, list(self._latest.values())
        rng = generator(study.seed, Stream.ACQUISITION, 2**31, len(known))
        models = self._comparing(study, known, rng=rng, start=latest_hyperparameters(known))
        x = study.search_space().cube_of([trial.parameters])
        return tuple(item.bias(metric, x) for metric, item in models.comparisons.items())


def _with_own_runs_first(
    study: Study,
    models: PooledSurrogates,
    candidates: Sequence[Candidate],
    required: OwnRuns,
) -> list[Candidate]:
    """Put the first candidate before the others that has the runs of its own which an answer needs.

    Where the repetitions are used up, a better one may have become the first without any. If none
    has them, the order stays.
    """
    for candidate in candidates:
        if not candidate.believed_feasible:
            break
        if not lacking(study, models, candidate.trial, required):
            return [candidate, *(c for c in candidates if c is not candidate)]
    return list(candidates)


def with_known_repetitions(
    trials: Sequence[Trial], evaluations: Sequence[Evaluation], *, more: bool
) -> list[Trial]:
    """Give the trials of a run that is continued the repetitions that its next trial can know.

    Parameters
    ----------
    trials
        Without the repetitions.
    evaluations
        All evaluations of the run, in the order of the record.
    more
        Whether trials are to come. If not, what was recorded after the last trial belongs to the
        search for the answer, which takes its way anew.
    """
    last = max((k for k, e in enumerate(evaluations) if e.stage in TUNING), default=0)
    return with_all_repetitions(trials, evaluations if more else evaluations[:last])


def with_all_repetitions(trials: Sequence[Trial], evaluations: Iterable[Evaluation]) -> list[Trial]:
    """Give trials their repetitions on record, see `Method.checked`.

    A trial that failed when it was run again is no candidate. Worst cases are as they were
    estimated when the trials were run.
    """
    known = repetitions_of(evaluations)
    return [with_repetitions(trial, known.get(trial.number, ())) for trial in trials]


def with_repetitions(trial: Trial, repetitions: Sequence[Evaluation]) -> Trial:
    """Add repetitions to a trial, which has failed if one of them did for its parameters."""
    extended = replace(trial, evaluations=(*trial.evaluations, *repetitions))
    for outcome in (evaluation.outcome for evaluation in repetitions):
        if not outcome.complete and not outcome.unusable:
            return replace(extended, state=TrialState.FAILED, reason=outcome.reason)
    return extended


def _planned(study: Study, trial: Trial, context: Context | None, index: int) -> Evaluation:
    stage = Stage.CHECK_WORST
    if context is None:
        contexts, stage = study.context_space(), Stage.CHECK_DRAWN
        rng = generator(study.seed, Stream.CHECK_CONTEXTS, trial.number, index)
        context = contexts.to_dict(contexts.draw_stratified(1, rng)[0])
    seed = noise_seed(study.seed, Stream.CHECK_NOISE, trial.number, index)
    return Evaluation(trial.number, index, stage, trial.parameters, context, seed)
