"""Measured contexts in a study file: what may be one, and what its runs have seen."""

import numpy as np
import pytest
from functions import NODE, make_study, study_mapping

from bo_tuner.errors import StudyError
from bo_tuner.methods.registry import METHODS, problem_of
from bo_tuner.metrics.collect import Collector
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.metrics.signal_sources import signal_sources
from bo_tuner.study.changes import changes_of_data, incomparable_changes
from bo_tuner.study.measured import seen_in
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

METRICS = {
    "error": NODE,
    "peak": NODE,
    "wind": NODE | {"unit": "m/s"},
    "both": {"expression": "error + wind"},
    "worse": {"relative": "error"},
    "windier": {"relative": "wind"},
}
FLIGHT = """\
name: hover
nodes:
  pid: {node: pid}
parameters:
  kp: {node: pid, type: double, bounds: [1.0, 50.0], default: 5.0}
signals:
  height: {topic: /pose, field: z}
  wind_speed: {topic: /wind, field: data, minimum_messages: 0}
run:
  start: [{wait: 1}]
  end: {after: 2}
metrics:
  error: {of: height - 1, measure: iae}
  wind: {of: wind_speed, measure: mean, unit: m/s}
measured: [wind]
objective: {metric: error}
budget: {trials: 12, initial_trials: 4}
"""


def study(**sections):
    return make_study(**{"metrics": METRICS, "measured": ["wind"]} | sections)


def test_it_is_written_as_it_is_read():
    read = parse_study(FLIGHT)
    assert read.measured == ("wind",)
    assert read.responses == ["error"]
    assert parse_study(study_to_yaml(read)) == read


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"measured": "wind"}, "measured: expected a list of metrics, found text 'wind'"),
        ({"measured": [3]}, "measured[0]: expected text, found 3"),
        ({"measured": ["wind", "wind"]}, "measured[1]: 'wind' is there twice"),
        ({"measured": ["wnd"]}, "measured[0]: there is no metric 'wnd'; did you mean 'wind'?"),
        (
            {"measured": ["both"]},
            "measured[0]: metric 'both' is computed from others; expected one of a run",
        ),
        (
            {"measured": ["worse"]},
            "measured[0]: metric 'worse' is computed from others; expected one of a run",
        ),
        (
            {"contexts": {"wind": NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]}}},
            "measured[0]: 'wind' is also a context, which is set; expected another name",
        ),
        (
            {"objective": "wind"},
            "measured[0]: 'wind' is the objective; what is measured is not optimized",
        ),
        (
            {"objective": "windier"},
            "measured[0]: 'wind' is the objective; what is measured is not optimized",
        ),
        (
            {"constraints": {"calm": {"kind": "chance", "metric": "wind", "upper": 3.0}}},
            "measured[0]: constraints.calm limits 'wind'; what is measured depends on no "
            "parameter, and is not limited",
        ),
        (
            {"constraints": {"calm": {"kind": "chance", "metric": "windier", "upper": 3.0}}},
            "measured[0]: constraints.calm limits 'wind'; what is measured depends on no "
            "parameter, and is not limited",
        ),
    ],
)
def test_what_is_refused(sections, message):
    if sections.get("constraints"):
        sections["constraints"]["calm"]["probability"] = 0.9
    with pytest.raises(StudyError) as error:
        study_from_mapping(study_mapping(**{"metrics": METRICS, "measured": ["wind"]} | sections))
    assert str(error.value) == message


def test_a_signal_that_is_not_there():
    with pytest.raises(
        StudyError, match=r"metrics\.wind\.of: there is no signal or function 'wind_sped'"
    ):
        parse_study(FLIGHT.replace("of: wind_speed", "of: wind_sped"))


@pytest.mark.parametrize(
    ("heard", "reason"),
    [([], "wind_speed"), ([np.nan], "metric wind: wind_speed is undefined at 0.500 s")],
)
def test_without_a_number_the_run_fails_by_name(heard, reason):
    of_study = parse_study(FLIGHT)
    time = np.array([0.5, 1.0])
    signals = {
        "height": RecordedSignal(time, np.array([0.9, 1.0])),
        "wind_speed": RecordedSignal(time[: len(heard)], np.array(heard)),
    }
    with signal_sources(of_study, lambda: Recording(signals, 2.0)) as sources:
        outcome = Collector(of_study, sources).outcome({})
    assert outcome.state is EvaluationState.FAILED
    assert outcome.metrics == {}
    assert reason in outcome.reason


def test_other_algorithms_refuse_it_in_a_line():
    of_study = study()
    assert problem_of("boundary", of_study) == ""
    for name in METHODS.keys() - {"boundary", "safe"}:
        assert problem_of(name, of_study) == (
            f"{name} knows nothing of what is measured, and the study measures 'wind'; "
            "expected boundary"
        )
    # A safe search is asked for by the study.
    assert not any(problem_of(n, study(measured=[])) for n in METHODS.keys() - {"safe"})


def test_a_run_without_it_is_data_of_one_with_it():
    """Its models have other columns, though."""
    assert changes_of_data(study(measured=[]), study())
    assert not incomparable_changes(study(measured=[]), study())


def test_what_runs_have_seen():
    def run(wind, state=EvaluationState.COMPLETE):
        outcome = Outcome(state, {"wind": wind} if state is EvaluationState.COMPLETE else {})
        return Evaluation(0, 0, Stage.DRAWN, {}, {}, 0, outcome)

    runs = [run(0.2), run(3.1), run(0.9), run(99.0, EvaluationState.FAILED)]
    seen = seen_in(["wind"], runs)
    assert (seen["wind"].low, seen["wind"].high) == (0.2, 3.1)
    assert seen["wind"].mean == pytest.approx(1.4)
    assert seen_in(["wind"], [run(1.0, EvaluationState.FAILED)]) == {}
    assert seen_in([], runs) == {}
