"""The draws of a certificate: contexts from their distribution, the same for all subjects."""

from collections.abc import Sequence

from bo_tuner.evidence.certificate.decisions import contradiction
from bo_tuner.evidence.certificate.findings import Evidence
from bo_tuner.evidence.certificate.plan import CHECKED, Case, CertificatePlan, Subject
from bo_tuner.plans import Run
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, Stage
from bo_tuner.tuning.validation import by_turns

DRAWS = "test runs at random"
"""Name of the first phase; the others are searches."""

LEAST_DRAWS = 30
"""Draws behind a mean and a standard deviation, even if fewer decide the verdict."""

REPEATS = 3
"""Draws of each subject that are run once more with another seed if they are to have no noise."""


def least_draws(study: Study) -> int:
    """Return the least number of draws; without noise and contexts all would be the same."""
    return 1 if study.a_run_tells_all else LEAST_DRAWS


class DrawPlan(CertificatePlan):
    """All subjects in the same draws, until these are clear for every subject.

    Draws that were planned before it was clear count, too.

    Attributes
    ----------
    evaluations
        Of each subject.
    """

    phase = DRAWS

    def __init__(
        self, case: Case, subjects: Sequence[Subject], repeats: Sequence[Sequence[Evaluation]]
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
        number = by_turns(self._case.study, k, range(count))[place]
        return self._case.drawn(number, self._subjects[number], k, self._contexts[k])

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
        decided = self._case.decided(subject, drawn)
        least = min(least_draws(self._case.study), self._case.most)
        return decided is False or (decided is True and len(drawn) >= least)


class RepeatedDraws(CertificatePlan):
    """The first draws of all subjects with other seeds, which are to change nothing.

    Attributes
    ----------
    evaluations
        Of each subject.
    """

    phase = "repeats without noise"

    def __init__(self, case: Case, subjects: Sequence[Subject]) -> None:
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
