"""What a busy computer means for limits on times."""

from dataclasses import replace

import pytest

from bo_tuner.evidence.busy import COMPUTING, HIGH, HighLoad, high_load, times_by
from bo_tuner.evidence.facts import ComputingTimes, Said
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.facts import in_words
from bo_tuner.evidence.words.verdict import sentences
from bo_tuner.processor_load import Load
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

STUDY = load_study("benchmark")
KEY = "controller.return_time_source"
TITLE = "solve time (p99)"
BUSY = HighLoad((TITLE,), 3, 9, (2, 3, "tuned"), 0.634, of_nodes=True)


def run(load, source="measured", trial=0, stage=Stage.DRAWN, state=EvaluationState.COMPLETE):
    metrics = dict.fromkeys(STUDY.metrics, 1.0) if state is EvaluationState.COMPLETE else {}
    details = {} if source is None else {KEY: source}
    return Evaluation(trial, 0, stage, {}, {}, 0, Outcome(state, metrics, "", details, load))


def test_the_runs_are_counted_and_named_in_which_the_nodes_waited():
    runs = [
        run(Load(0.9, HIGH - 0.01)),
        run(Load(0.9, HIGH), trial=2),
        run(Load(0.9, 0.634), trial=3),
        run(Load(0.0, 0.3), trial=1, stage=Stage.VALIDATION),
        *5 * [run(Load(None, 0.0))],
        run(None),
        run(Load(1.0, 1.0), state=EvaluationState.FAILED),
    ]
    assert high_load(STUDY, runs) == BUSY


def test_of_attached_nodes_the_whole_computer_counts():
    assert high_load(STUDY, [run(Load(0.5, None), trial=4)]) == HighLoad(
        (TITLE,), 1, 1, (4,), 0.5, of_nodes=False
    )


@pytest.mark.parametrize("source", ["cpu", "modelled"])
def test_a_time_without_waiting_is_not_longer_on_a_busy_computer(source):
    assert high_load(STUDY, [run(Load(1.0, 1.0), source)]) is None


def test_a_node_that_does_not_say_how_has_measured():
    assert high_load(STUDY, [run(Load(1.0, 1.0), None)]) is not None


def test_a_study_without_a_limit_on_a_time_does_not_care():
    limits = {k: v for k, v in STUDY.constraints.items() if k != "real_time"}
    assert high_load(replace(STUDY, constraints=limits), [run(Load(1.0, 1.0))]) is None


def test_the_source_with_the_longest_common_beginning_counts(make_study):
    study = make_study(
        metrics={
            "error": {"node": "axis"},
            "peak": {"node": "axis"},
            "step": {"node": "axis", "key": "solve_time_p99", "reproducible": False},
            "both": {"expression": "step + peak"},
        },
        constraints={
            "step": {"kind": "chance", "metric": "step", "upper": 1.0, "probability": 0.9},
            "both": {"kind": "chance", "metric": "both", "upper": 1.0, "probability": 0.9},
        },
    )
    details = {
        "axis.solve_source": "measured",
        "axis.solve_time_source": "cpu",
        "axis.solve_time_p50_source": "measured",
        "drive.solve_time_p99_source": "measured",
    }
    metrics = dict.fromkeys(study.metrics, 0.5)
    outcome = Outcome(EvaluationState.COMPLETE, metrics, "", details, Load(1.0, 1.0))
    found = Evaluation(0, 0, Stage.DRAWN, {}, {}, 0, outcome)
    assert high_load(study, [found]) is None
    # Also of a time in a metric that is computed from it.
    assert times_by(study, [found], COMPUTING) == ["step", "both"]


def test_computing_time_is_named_where_all_runs_have_it():
    assert times_by(STUDY, [run(None, "cpu"), run(None, "cpu")], COMPUTING) == ["return_time"]
    assert times_by(STUDY, [run(None, "cpu"), run(None, "measured")], COMPUTING) == []
    assert times_by(STUDY, [], COMPUTING) == []


def test_the_words():
    assert in_words(ComputingTimes((TITLE,))) == (
        "Solve time (p99): computing time; waiting for the processor is not in it."
    )
    assert in_words(BUSY) == (
        "The computer was busy in 3 of 9 runs (trials 2–3, validation of the tuned): nodes waited "
        "for the processor up to 63.4 % of the time, and solve time (p99) is longer there than on "
        "a free one. Run it with nothing else at work, or limit computing time."
    )


@pytest.mark.parametrize("state", list(State))
def test_a_verdict_says_it_first(state):
    trial = None if state is State.OPEN else 0
    verdict = Verdict(state=state, trial=trial, reasons=(Said("none"),))
    busy = replace(verdict, high_load=BUSY)
    assert sentences(busy) == (in_words(BUSY), *sentences(verdict))
