"""Which metrics only grow during a run, and which studies may have runs cut short."""

import contextlib
import itertools

import numpy as np
import pytest
from cut_short_runs import GROWS
from functions import make_study, study_mapping
from signal_runs import recording, signal_study

from bo_tuner.errors import StudyError
from bo_tuner.metrics.recording import Recording
from bo_tuner.metrics.so_far import MetricsSoFar
from bo_tuner.numerics.signal_metrics import (
    MEASURES,
    NEVER_FALLS,
    UndefinedMetricError,
    options_of,
)
from bo_tuner.study.ending_early import CutShortBy, check_ends_early, decided_by
from bo_tuner.study.study_file import study_from_mapping

CUT = {"trials": 5, "initial_trials": 3, "cut_short": True}
OPTIONS = {"target": 1.0, "percent": 90.0}


def with_measures(**metrics):
    """A study of signals whose runs may be cut short."""
    return study_from_mapping(
        signal_study(
            metrics={"error": {"of": "setpoint - angle", "measure": "iae"}} | metrics,
            budget=CUT,
        )
    )


def refusal(**sections):
    with pytest.raises(StudyError) as caught:
        make_study(**({"budget": CUT} | sections))
    return str(caught.value)


@pytest.mark.parametrize("measure", sorted(MEASURES))
def test_those_that_never_fall_are_those_that_do_not_in_any_signal(measure):
    """A signal that swings, rests and begins anew makes each of the others fall somewhere."""
    options = {key: OPTIONS[key] for key in options_of(measure) if key in OPTIONS}
    time = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.05, 220))
    parts = np.linspace(0.0, 1.6, 60), 1.0 + 0.5 * np.cos(np.arange(60)), np.full(80, 1.001)
    value = np.concatenate([*parts, np.full(20, -0.5)])
    values = []
    for count in range(2, len(time)):
        with contextlib.suppress(UndefinedMetricError):
            values.append(MEASURES[measure](time[:count], value[:count], **options))
    fell = bool((np.diff(values) < -1e-9).any())
    # The last two are not known before the step is over, which may take the whole run.
    assert fell == (measure not in {*NEVER_FALLS, "rise_time", "settling_time"})


class TestStudy:
    def test_the_measure_says_it(self):
        study = with_measures(
            rough={"of": "angle", "measure": "rms"},
            far={"of": "abs(angle)", "measure": "max"},
            over={"of": "angle", "measure": "overshoot", "target": 1.0},
            over_end={"of": "angle", "measure": "overshoot", "target": "setpoint"},
            cost={"expression": "error + 0.1 * far"},
        )
        assert study.growing_metrics == ["error", "far", "over"]
        # Nothing but the objective is bounded above.
        assert study.decisive_metrics == ["error"]

    def test_a_lower_limit_and_a_maximized_objective_do_not_end_a_run(self):
        study = make_study(
            budget=CUT,
            metrics={"error": GROWS, "peak": GROWS},
            objective={"metric": "error", "direction": "maximize"},
            constraints={
                "peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0},
                "least": {"kind": "worst_case", "metric": "error", "lower": 0.1},
            },
        )
        assert study.decisive_metrics == ["peak"]

    def test_without_the_key_nothing_does(self):
        study = make_study(metrics={"error": GROWS, "peak": GROWS})
        assert study.growing_metrics == ["error", "peak"]
        assert study.decisive_metrics == []

    def test_metrics_that_may_fall_are_refused_with_why(self):
        assert refusal() == (
            "budget.cut_short: no metric with an upper limit, and no minimized objective, only "
            "grows during a run (peak: its entry does not say `grows: true`; error: its entry does "
            "not say `grows: true`)"
        )

    def test_measures_that_may_fall_are_refused_with_why(self):
        mapping = signal_study(
            metrics={
                "rough": {"of": "angle", "measure": "rms"},
                "over": {"of": "angle", "measure": "overshoot", "target": "setpoint"},
                "cost": {"expression": "rough + over"},
            },
            objective={"metric": "cost"},
            constraints={
                name: {"kind": "chance", "metric": name, "upper": 5.0, "probability": 0.9}
                for name in ("rough", "over")
            },
            budget=CUT,
        )
        with pytest.raises(StudyError) as caught:
            study_from_mapping(mapping)
        assert "(rough: rms may fall during a run; over: its target, setpoint, is" in str(
            caught.value
        )
        assert str(caught.value).endswith("cost: it is computed from other metrics)")

    @pytest.mark.parametrize("value", ["yes", 1, None])
    def test_keys_that_are_no_truth_value_are_refused(self, value):
        assert "budget.cut_short: " in refusal(budget=CUT | {"cut_short": value})
        metrics = {"error": GROWS | {"grows": value}, "peak": GROWS}
        assert "metrics.error.grows: " in refusal(metrics=metrics)

    def test_measured_contexts_are_refused(self):
        found = refusal(metrics={"error": GROWS, "peak": GROWS, "wind": GROWS}, measured=["wind"])
        assert "has no measured context, such as wind; expected a study without" in found

    def test_a_broken_study_is_refused_for_what_is_broken(self):
        """Nothing is said of metrics that could not be read."""
        found = refusal(metrics={"error": GROWS, "peak": {"of": "angle"}})
        assert "metrics.peak" in found


class TestWhoRunsIt:
    def study(self):
        return make_study(budget=CUT, metrics={"error": GROWS, "peak": GROWS})

    @pytest.mark.parametrize(
        ("backend", "who"), [("ros", "a node that a service starts"), ("function", "a function")]
    )
    def test_what_cannot_end_a_run_is_refused(self, backend, who):
        with pytest.raises(StudyError, match=f"nothing ends a run of {who} early; expected"):
            check_ends_early(self.study(), backend)

    def test_objects_and_procedures_can(self):
        check_ends_early(self.study(), "inprocess")
        check_ends_early(with_measures(), "ros")
        check_ends_early(make_study(), "ros")

    def test_what_decides_is_said(self):
        study = with_measures(rough={"of": "angle", "measure": "rms"})
        others = (("rough", "rms may fall during a run"),)
        assert decided_by(study) == CutShortBy(("error",), others)


class TestSoFar:
    def test_it_is_that_of_the_first_part_of_the_run(self):
        study = with_measures(far={"of": "abs(angle)", "measure": "max"})
        whole, values = recording(1), []
        for end in (0.5, 1.0, 1.5, 2.0):
            part = Recording(whole.signals, end)
            values.append(MetricsSoFar(study).of(part))
        assert all(before["far"] <= after["far"] for before, after in itertools.pairwise(values))
        assert all(before["error"] < after["error"] for before, after in itertools.pairwise(values))
        seen = whole.signals["angle"]
        assert values[1]["far"] == pytest.approx(np.abs(seen.value[seen.time <= 1.0]).max())

    def test_what_is_not_known_yet_is_left_out(self):
        study = with_measures(over={"of": "angle", "measure": "overshoot", "target": 1.0})
        part = Recording(recording(1).signals, 1e-4)
        assert "over" not in MetricsSoFar(study).of(part)


def test_the_key_is_written_and_read_again():
    mapping = study_mapping(metrics={"error": GROWS, "peak": GROWS}, budget=CUT)
    assert study_from_mapping(mapping).budget.cut_short is True
