"""What the verdict says of how far the machine is from its simulation."""

from collections.abc import Iterable, Mapping
from typing import Any

from bo_tuner.evidence.differences import Difference
from bo_tuner.study.study import Study
from bo_tuner.text import shown


def biases_in_words(study: Study, biases: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return a remark on the biases; none without any.

    Parameters
    ----------
    study
        The study.
    biases
        From ``summary.json``: each a `bo_tuner.models.bias.Bias` as a mapping.
    """
    texts = [_in_words(study, item) for item in biases]
    if not texts:
        return ()
    return (f"Machine and simulation, by the models of both, at these values: {'; '.join(texts)}.",)


def _in_words(study: Study, item: Mapping[str, Any]) -> str:
    metric = study.metrics[str(item["metric"])]
    mean, low, high = (float(item[key]) for key in ("difference", "low", "high"))
    interval = Difference(mean, low, high, 0).interval_in_words
    unit = f" {metric.unit}" if metric.unit else ""
    simulated = f"{shown(float(item['simulated']))}{unit} in the simulation"
    if low <= 0.0 <= high:
        return (
            f"{metric.title} {simulated}, no difference shown on the machine "
            f"({mean:+.3g}, {interval})"
        )
    side = "higher" if mean > 0.0 else "lower"
    return f"{metric.title} {simulated}, {abs(mean):.3g}{unit} {side} on the machine ({interval})"
