"""What the plans of a certificate have in common: subjects, draws, seeds, and their end."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bo_tuner.evidence.certificate.decisions import decide_context, decide_draws
from bo_tuner.evidence.certificate.findings import NOTHING, Earlier, Evidence
from bo_tuner.numerics.seeds import Stream, generator, noise_seed
from bo_tuner.plans import Plan, Run
from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Evaluation, Stage, Value

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
class Case:
    """What all evaluations of a certificate have in common; `most` of them in each context."""

    study: Study
    confidence: float
    attempt: int
    most: int

    def decided(self, subject: Subject, drawn: Sequence[Evaluation]) -> bool | None:
        """Return whether a subject keeps its limits in draws; None if open."""
        return decide_draws(self.study, drawn, self.most, self.confidence, subject.earlier)

    def holds(self, evidence: Evidence, place: int) -> bool | None:
        """Return whether all worst-case constraints hold in a context; None if one is open."""
        decided = [
            decide_context(self.study, constraint, evidence, place, self.most, self.confidence)
            for constraint in self.study.worst_case_constraints
        ]
        return False if False in decided else None if None in decided else True

    def draw(self) -> list[Context]:
        """Return the contexts of all draws."""
        space = self.study.context_space()
        rng = generator(self.study.seed, Stream.CERTIFICATE_CONTEXTS, self.attempt)
        return [space.to_dict(row) for row in space.draw(self.most, rng)]

    def drawn(self, number: int, subject: Subject, draw: int, context: Context) -> Run:
        """Return the run of a subject, by its number, in a draw, by its number and context."""
        # Without noise draws differ by their contexts alone.
        seed = self.noise_seed(DRAWN, 0 if self.study.is_noiseless else draw)
        return Run(Evaluation(number, draw, Stage.VALIDATION, subject.parameters, context, seed))

    def noise_seed(self, *key: int) -> int:
        """Return a seed; it does not depend on the subject: the same noise for all."""
        return noise_seed(self.study.seed, Stream.CERTIFICATE_NOISE, self.attempt, *key)


class CertificatePlan(Plan[Run]):
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
