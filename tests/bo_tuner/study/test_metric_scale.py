"""The scale of a metric: which there are, what they need, and what they do to a run."""

from dataclasses import replace

import numpy as np
import pytest
from drive_text import mapping, put, refusal

from bo_tuner.methods.registry import METHODS
from bo_tuner.models.compression import Compression
from bo_tuner.models.logarithm import Logarithm
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.study.study_file import study_from_mapping, study_to_mapping
from bo_tuner.trials import TrialState
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

PEAK = {"node": "drive", "key": "peak_p99", "unit": "A"}


def with_scale(scale, **limits):
    changed = mapping()
    changed["metrics"]["peak"] = PEAK | {"scale": scale}
    changed["constraints"]["worst"] |= limits
    return changed


def test_unless_given_it_is_linear():
    study = study_from_mapping(mapping())
    assert study.metrics["peak"].scale == "linear"
    assert study.logarithmic_metrics == []


def test_it_is_kept_in_the_file():
    study = study_from_mapping(with_scale("log"))
    assert study.logarithmic_metrics == ["peak"]
    assert study_from_mapping(study_to_mapping(study)) == study


@pytest.mark.parametrize("value", ["logarithmic", 1, True, None])
def test_another_one_is_refused(value):
    message = refusal(with_scale(value))
    assert message.startswith("metrics.peak.scale: ")
    assert "linear" in message
    assert "log" in message


@pytest.mark.parametrize(
    ("key", "limit"), [("upper", 0.0), ("upper", -2.0), ("lower", -1.0), ("lower", 0.0)]
)
def test_a_limit_without_a_logarithm_is_refused(key, limit):
    changed = with_scale("log")
    changed["constraints"]["worst"] = {"kind": "worst_case", "metric": "peak", key: limit}
    assert refusal(changed) == (
        f"constraints.worst.{key}: expected a limit above 0 on a metric with the scale log, "
        f"found {limit:g}"
    )
    changed["metrics"]["peak"]["scale"] = "linear"
    study_from_mapping(changed)


@pytest.mark.parametrize(
    "metric",
    [
        {"of": "speed", "measure": "max"},
        {"expression": "error + 1"},
        {"python": "mine:jerk"},
    ],
    ids=["signal", "expression", "python"],
)
def test_every_kind_of_metric_has_it(metric):
    changed = mapping()
    changed["metrics"]["other"] = metric | {"scale": "logs"}
    assert "metrics.other.scale: unknown 'logs'" in refusal(changed)


def test_without_a_limit_it_is_refused():
    changed = put("log", "metrics", "error", "scale")
    assert refusal(changed) == (
        "metrics.error.scale: has no effect: there is no limit on error; leave it out, or if it is "
        "the objective, write objective: {metric: error, scale: log}"
    )


def test_a_difference_from_the_default_has_none():
    changed = put({"relative": "error", "scale": "log"}, "metrics", "other")
    assert refusal(changed).startswith("metrics.other.scale: unknown key")


@pytest.mark.parametrize(("named", "kind"), [("log", Logarithm), ("linear", Compression)])
def test_the_models_are_on_the_one_that_it_names(named, kind):
    models = PooledModels().of_metric(study_from_mapping(with_scale(named)), "peak")
    assert isinstance(models.scale(np.arange(1.0, 10.0), 5.0, 1.0), kind)


@pytest.mark.parametrize("scale", ["log", "linear"])
def test_a_run_in_which_a_metric_is_not_positive_goes_on(make_study, function_backend, scale):
    node = {"node": "axis"}
    study = make_study(metrics={"error": node, "peak": node | {"scale": scale}}).replace(trials=9)

    def run(gain, load, seed):
        noise = np.random.default_rng(seed).standard_normal()
        return {"error": gain, "peak": 0.0 if gain > 0.7 else (0.2 + gain) * np.exp(0.2 * noise)}

    trials = list(Tuning(study, Driver(function_backend(study, run)), METHODS["boundary"]))
    assert len(trials) == 9
    zero = [t for t in trials if t.parameters["gain"] > 0.7]
    assert zero
    for trial in zero:
        assert (trial.state is TrialState.FAILED) == (scale == "log")
    if scale == "log":
        assert "metric peak is 0.0; its log scale needs a positive value" in zero[0].reason


@pytest.mark.parametrize(
    "peak",
    [
        lambda gain: 0.5,
        lambda gain: 1.0 if gain > 0.5 else 0.5,
        lambda gain: 1e9 * (1.0 + gain),
        lambda gain: -1e9 * (1.0 + gain),
        lambda gain: np.inf if gain > 0.5 else 0.5,
    ],
    ids=["all alike", "two values", "far beyond", "far within", "infinite"],
)
@pytest.mark.parametrize("scale", ["log", "linear"])
def test_runs_that_say_nothing_of_a_scale(make_study, function_backend, peak, scale):
    node = {"node": "axis"}
    study = make_study(metrics={"error": node, "peak": node | {"scale": scale}}).replace(trials=9)
    backend = function_backend(study, lambda gain, load, seed: {"error": gain, "peak": peak(gain)})
    trials = list(Tuning(study, Driver(backend), replace(METHODS["boundary"])))
    assert len(trials) == 9
    assert not any("could not be maximized" in w for t in trials for w in t.warnings)
