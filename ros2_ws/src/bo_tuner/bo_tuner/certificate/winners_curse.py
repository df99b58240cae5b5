"""What a run believed of its winner against what fresh evaluations show (Sec. 5.2).

A search picks winners, so the figures that made a parameter set the winner are too good on
average (the winner's curse). A gap of several standard errors says that the run's own figures must
not be quoted; it is no reason for a FAIL, since only the fresh evaluations are judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, nan, sqrt

import numpy as np

from bo_tuner.certificate.evidence import Findings
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.study.study import Study
from bo_tuner.trials import Trial


@dataclass(frozen=True)
class Gap:
    """A figure in training and in validation, in the metric's unit.

    Attributes
    ----------
    name, unit
        What it is.
    shown, shown_error
        What the trial itself showed, and its standard error; NaN where there is none.
    predicted
        What the surrogates of all trials, or of the trial's own search, made of it.
    validated, validated_error
        What the fresh evaluations show, and the standard error.
    """

    name: str
    unit: str
    shown: float
    shown_error: float
    predicted: float
    validated: float
    validated_error: float

    @property
    def value(self) -> float:
        """Validated minus shown; positive if the training's figure was the smaller one."""
        return self.validated - self.shown

    @property
    def standard_error(self) -> float:
        """Of the gap; the error of what was shown counts as far as it is known."""
        return hypot(self.validated_error, 0.0 if np.isnan(self.shown_error) else self.shown_error)


def training_gaps(
    study: Study, trial: Trial, ranked: Sequence[Candidate], findings: Findings
) -> list[Gap]:
    """Compare training and validation, for the objective and, if there is one, the worst case.

    Parameters
    ----------
    study
        The study.
    trial
        The trial in training, without checks.
    ranked
        What the surrogates make of the trials; the trial need not be among them.
    findings
        Of the trial's parameter set.
    """
    metric = study.metrics[study.objective.metric]
    seen = np.array(trial.observations(metric.name))
    gaps = [
        Gap(
            name=f"mean {metric.name}",
            unit=metric.unit,
            shown=float(seen.mean()) if len(seen) else nan,
            shown_error=float(seen.std(ddof=1)) / sqrt(len(seen)) if len(seen) > 1 else nan,
            predicted=next((c.objective for c in ranked if c.trial.number == trial.number), nan),
            validated=findings.objective.value,
            validated_error=findings.objective.standard_error,
        )
    ]
    for constraint in findings.constraints:
        if constraint.worst and trial.worst_case is not None:
            gaps.append(
                Gap(
                    name=f"worst {constraint.metric}",
                    unit=constraint.unit,
                    shown=trial.worst_case.observed,
                    shown_error=nan,
                    predicted=trial.worst_case.value,
                    validated=constraint.worst[0].mean.value,
                    validated_error=constraint.worst[0].mean.standard_error,
                )
            )
    return gaps
