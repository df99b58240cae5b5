"""The evaluations of a certificate: common fresh draws, then the worst contexts of each subject.

They end as soon as the verdict is clear; `most_evaluations` says when at the latest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bo_tuner.evidence.certificate.decisions import contradiction
from bo_tuner.evidence.certificate.draws import REPEATS, DrawPlan, RepeatedDraws
from bo_tuner.evidence.certificate.findings import Evidence
from bo_tuner.evidence.certificate.independent_search import most_searched
from bo_tuner.evidence.certificate.plan import Case, CertificatePlan, Subject
from bo_tuner.evidence.certificate.worst_contexts import WorstCasePlan, most_places
from bo_tuner.study.study import Study
from bo_tuner.tuning.driver import Driver


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
    places = sum(most_places(study, subject) for subject in subjects)
    return MostEvaluations(
        drawn=len(subjects) * (draws + (REPEATS if study.is_noiseless else 0)),
        searched=constraints * sum(most_searched(space, len(s.suspected)) for s in subjects),
        repeated=places * (1 if study.is_noiseless else draws),
    )


class Certification:
    """Collects the evidence for a certificate.

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
        """
        case = Case(self._study, self._confidence, self._attempt, draws)
        repeats = RepeatedDraws(case, subjects)
        if self._study.is_noiseless:
            self._complete(repeats)
        drawing = DrawPlan(case, subjects, repeats.evaluations)
        self._complete(drawing)
        return [
            self._look_closely(case, number, subject, drawing.evidence(number))
            for number, subject in enumerate(subjects)
        ]

    def _look_closely(
        self, case: "Case", number: int, subject: Subject, evidence: Evidence
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

    def _complete(self, plan: "CertificatePlan") -> None:
        if self._finishing():
            plan.finish()
        self._driver.complete(plan)
        self.cut_short = self.cut_short or plan.cut_short
