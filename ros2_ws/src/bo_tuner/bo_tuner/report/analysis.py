"""The data behind a report: the trials of a run, the models of them, and the answer."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bo_tuner.errors import RunRecordError
from bo_tuner.models.surrogates import Surrogates
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.optimizers.algorithms import ALGORITHMS
from bo_tuner.optimizers.ranking import Candidate, rank
from bo_tuner.report.sections.certificate import CertificateFile, certificate
from bo_tuner.storage.record import RunRecord
from bo_tuner.study import checks
from bo_tuner.study.study import Study
from bo_tuner.trials import Evaluation, EvaluationState, Stage, Trial, TrialState, Value
from bo_tuner.tuning.limits import WITHIN, Sample, verdict
from bo_tuner.tuning.recommendation import with_check
from bo_tuner.tuning.validation import Validation

CHECKS = (Stage.CHECK_DRAWN, Stage.CHECK_WORST)


class Outcome:
    """Outcome of a trial, as displayed."""

    WITHIN = "within limits"
    VIOLATES = "violating"
    OUTLIER = "outlying"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class Analysis:
    """A run with the models of all its trials.

    Attributes
    ----------
    record
        The run.
    """

    record: RunRecord

    @property
    def study(self) -> Study:
        """The study of the run, with its command-line options."""
        return self.record.study

    @cached_property
    def trials(self) -> tuple[Trial, ...]:
        """The trials, each with the evaluations that checked it as a candidate."""
        checks: dict[int, dict[int, Evaluation]] = {}
        for evaluation in self.record.evaluations:
            if evaluation.stage in CHECKS:
                # A later one of the same place replaces one that a kill left behind.
                checks.setdefault(evaluation.trial, {})[evaluation.index] = evaluation
        return tuple(
            with_check(self.study, trial, list(checks.get(trial.number, {}).values()))[0]
            for trial in self.record.trials
        )

    @cached_property
    def models(self) -> Surrogates:
        """Surrogates of all trials, the same as in `rank`."""
        rng = generator(self.study.seed, Stream.ACQUISITION, 2**31, len(self.trials))
        options = ALGORITHMS[self.record.algorithm].models
        return Surrogates.fit(self.study, self.trials, rng=rng, options=options)

    @cached_property
    def ranked(self) -> list[Candidate]:
        """Complete trials, the recommended one first."""
        return rank(self.study, self.trials, ALGORITHMS[self.record.algorithm].models)

    @cached_property
    def certificate(self) -> CertificateFile | None:
        """The certificate, if `validate` has written one."""
        return certificate(self.record)

    @cached_property
    def answer(self) -> Trial | None:
        """The trial of the result; before there is one, the trial recommended so far."""
        if self.record.summary is None:
            return self.ranked[0].trial if self.ranked else None
        number = self.record.summary.get("trial")
        for trial in self.trials:
            if trial.number == number:
                return trial
        raise RunRecordError(f"{self.record.path}: its summary names trial {number}, not on record")

    @property
    def believed_feasible(self) -> bool:
        """Whether the answer is believed to keep the limits and, once validated, kept them."""
        if self.record.summary is not None:
            return self.record.summary.get("feasible") is True
        return bool(self.ranked) and self.ranked[0].believed_feasible

    @property
    def defaults(self) -> Mapping[str, Value]:
        """The hand-tuned parameter set."""
        return self.study.search_space().defaults

    @cached_property
    def validations(self) -> tuple[Validation, Validation] | None:
        """Validation of the default and the tuned parameter set; None without a result."""
        if self.record.summary is None:
            return None
        try:
            default, tuned = (_validation(self.record.summary[key]) for key in ("default", "tuned"))
            for side in (default, tuned):
                self._check_validation(side)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise RunRecordError(
                f"{self.record.path}: its summary is not one of tune's: {str(error)[:200]!r}"
            ) from error
        return default, tuned

    def _check_validation(self, side: Validation) -> None:
        """Refuse a validation of other parameters or constraints than the study's."""
        space = self.study.search_space()
        if side.parameters != space.completed(side.parameters):
            raise ValueError("other values of tied or fixed parameters")
        if side.constraints.keys() != self.study.constraints.keys():
            raise ValueError(f"constraints {', '.join(side.constraints)}")
        if not 0 <= side.failures <= side.draws:
            raise ValueError(f"{side.failures} failures of {side.draws} draws")

    def outcome(self, trial: Trial) -> str:
        """Return the `Outcome` of a trial."""
        if trial.state is TrialState.FAILED:
            return Outcome.FAILED
        if trial.number in self.models.outliers:
            return Outcome.OUTLIER
        within = verdict(self.study, trial) == WITHIN
        return Outcome.WITHIN if within else Outcome.VIOLATES

    def mean_objective(self, trial: Trial) -> float:
        """Return the mean of the objective's metric over the drawn contexts; NaN without any."""
        seen = trial.observations(self.study.objective.metric)
        return sum(seen) / len(seen) if seen else math.nan

    def tuned_values(self, parameters: Mapping[str, Value]) -> dict[str, Value]:
        """Return the tuned ones among `parameters`."""
        return {name: parameters[name] for name in self.study.search_space().names}

    def paired_difference(self) -> tuple[float, float] | None:
        """Mean difference of the objective, tuned minus default, and its standard error.

        Over the draws of the validation that both completed; None without two of them.
        """
        seen: dict[int, dict[int, float]] = {}
        for evaluation in self.record.evaluations:
            if (
                evaluation.stage is Stage.VALIDATION
                and evaluation.outcome.state is EvaluationState.COMPLETE
            ):
                value = evaluation.outcome.metrics[self.study.objective.metric]
                # In the validation, trial 0 is the default and trial 1 the tuned parameter set.
                seen.setdefault(evaluation.index, {})[evaluation.trial] = value
        pairs = np.array([both[1] - both[0] for both in seen.values() if len(both) == 2])
        if len(pairs) < 2:
            return None
        return float(pairs.mean()), float(pairs.std(ddof=1) / np.sqrt(len(pairs)))

    def evaluations_of(self, parameters: Mapping[str, Value]) -> list[Evaluation]:
        """Return the complete evaluations of a parameter set, of any stage."""
        space = self.study.search_space()
        key = space.key(self.tuned_values(parameters))
        return [
            evaluation
            for evaluation in self.record.evaluations
            if evaluation.outcome.state is EvaluationState.COMPLETE
            and space.key(evaluation.parameters) == key
        ]


def _validation(entry: object) -> Validation:
    if not isinstance(entry, Mapping):
        raise TypeError(f"expected an object, found {entry!r}")
    return Validation(
        parameters=dict(entry["parameters"]),
        draws=_count(entry["draws"]),
        failures=_count(entry["failures"]),
        objective=_number(entry["objective"]),
        deviation=_number(entry["deviation"]),
        constraints={
            str(name): Sample(
                name=str(sample["name"]),
                worst=_number(sample["worst"]),
                count=_count(sample["count"]),
                violations=_count(sample["violations"]),
                holds=bool(sample["holds"]),
            )
            for name, sample in entry["constraints"].items()
        },
    )


def _count(value: object) -> int:
    """Read a number of evaluations of the summary."""
    return checks.integer(value, at_least=0)


def _number(value: object) -> float:
    """Read a number of the summary, where null stands for NaN."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"expected a number, found {value!r:.40}")
    return float(value)
