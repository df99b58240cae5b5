"""Evaluations that a run has on record already, given again instead of being run anew."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from bo_tuner.backends.protocol import Backend
from bo_tuner.metrics.collect import judged
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation


class OnRecord:
    """Evaluations on record, each given once when it is planned again.

    An evaluation is known again by its stage, its seed and what is set for it: parameters and
    context. A run that was resumed plans the same, so that it takes the way it took before. Where
    no parameter takes the seed, it still tells one repetition from another.
    """

    def __init__(self, study: Study, evaluations: Iterable[Evaluation]) -> None:
        self._study = study
        self._evaluations: dict[str, list[Evaluation]] = {}
        for evaluation in evaluations:
            self._evaluations.setdefault(self._key(evaluation), []).append(evaluation)

    def take(self, planned: Evaluation) -> Evaluation | None:
        """Return a planned evaluation with its outcome on record; None if it is to be run."""
        recorded = self._evaluations.get(self._key(planned))
        if not recorded:
            return None
        earlier = recorded.pop(0)
        # Those of another run may have been judged by another study.
        outcome = judged(self._study, earlier.outcome)
        return replace(planned, outcome=outcome, seconds=earlier.seconds, recorded=True)

    def _key(self, evaluation: Evaluation) -> str:
        assignments: Mapping[str, Mapping[str, object]] = self._study.assignments(
            evaluation.parameters, evaluation.context, evaluation.seed
        )
        # As text, 3 and 3.0 differ, as they do for a node, and all bits of a double count.
        values = {node: dict(of_node) for node, of_node in assignments.items()}
        return json.dumps([evaluation.stage, evaluation.seed, values], sort_keys=True)


class RecordedEvaluations:
    """A backend that runs only the evaluations which are not on record."""

    def __init__(self, backend: Backend, study: Study, evaluations: Iterable[Evaluation]) -> None:
        self.name = backend.name
        self._backend = backend
        self._record = OnRecord(study, evaluations)

    def open(self) -> None:
        """Get ready to run evaluations."""
        self._backend.open()

    def run(self, evaluations: Iterable[Evaluation]) -> Iterator[Evaluation]:
        """Give evaluations from the record, then run the others."""
        others = []
        for planned in evaluations:
            earlier = self._record.take(planned)
            if earlier is None:
                others.append(planned)
            else:
                yield earlier
        # Also without new ones: several workers may still have some of earlier calls.
        yield from self._backend.run(others)

    def close(self) -> None:
        """Let go of everything that `open` took."""
        self._backend.close()
