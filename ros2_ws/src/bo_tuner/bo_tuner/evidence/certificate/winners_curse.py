"""Compares a run's own estimates of its result with fresh evaluations (Sec. 5.2).

The result is selected for its good figures, so these are too good on average (winner's curse). A
gap of several standard errors means that the run's own figures must not be quoted; it is no reason
for a FAIL, since only the fresh evaluations are judged.
"""

from dataclasses import dataclass
from math import hypot, nan, sqrt

import numpy as np

from bo_tuner.evidence.certificate.findings import Findings
from bo_tuner.study.study import Study
from bo_tuner.study.titles import mean_title
from bo_tuner.trials import Trial


@dataclass(frozen=True)
class Gap:
    """A quantity in training and in validation, in the metric's unit.

    Attributes
    ----------
    name, unit
        Name and unit of the quantity.
    observed, observed_error
        Observed in the trial itself, and its standard error; NaN if not known, which is so for a
        worst case: its largest observation would exceed its mean over noise.
    predicted
        Predicted by the surrogates of all trials, or by the model of the trial's own search.
    validated, validated_error
        Observed in the fresh evaluations, and its standard error.
    """

    name: str
    unit: str
    observed: float
    observed_error: float
    predicted: float
    validated: float
    validated_error: float

    @property
    def value(self) -> float:
        """Validated minus observed, or minus predicted where nothing like it was observed."""
        return self.validated - (self.predicted if np.isnan(self.observed) else self.observed)

    @property
    def standard_error(self) -> float:
        """Standard error of the gap; an unknown error of the observation counts as zero."""
        observed = 0.0 if np.isnan(self.observed_error) else self.observed_error
        return hypot(self.validated_error, observed)


def training_gaps(
    study: Study, trial: Trial, predicted: float, findings: Findings
) -> tuple[Gap, ...]:
    """Compare training and validation, for the objective and, if there is one, the worst case."""
    metric = study.metrics[study.objective.metric]
    seen = np.array(trial.observations(metric.name))
    gaps = [
        Gap(
            name=mean_title(metric.title),
            unit=metric.unit,
            observed=float(seen.mean()) if len(seen) else nan,
            observed_error=float(seen.std(ddof=1)) / sqrt(len(seen)) if len(seen) > 1 else nan,
            predicted=predicted,
            validated=findings.objective.value,
            validated_error=findings.objective.error,
        )
    ]
    for constraint in findings.constraints:
        estimate = trial.worst_cases.get(constraint.name)
        if constraint.worst and estimate is not None:
            gaps.append(
                Gap(
                    name=f"worst {mean_title(study.limited(study.constraints[constraint.name]))}",
                    unit=constraint.unit,
                    observed=nan,
                    observed_error=nan,
                    predicted=estimate.value,
                    validated=constraint.worst[0].mean.value,
                    validated_error=constraint.worst[0].mean.standard_error,
                )
            )
    return tuple(gaps)
