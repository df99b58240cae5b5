"""How long tuning will take, by a test run that `check` has made."""

import pytest
from signal_runs import signal_study

from bo_tuner.cli.check_times import time_of
from bo_tuner.evidence.check import Ramp
from bo_tuner.run_notes import Notes
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

RUN = {"end": {"after": 2.0}}
NOTHING = Notes()
CALM = {"kind": "chance", "metric": "error", "upper": "1.1 * default", "probability": 0.9}


@pytest.mark.parametrize(
    ("sections", "ramp", "runs", "sets"),
    [
        # In seconds, with 1 s of the run itself; the default is run beside each one in the last.
        ({"run": RUN}, None, 1, 0),
        ({"run": RUN | {"ramp": 60}}, Ramp(60.0, 0), 1, 60),
        ({"run": RUN | {"ramp": 60}, "park": {"between_runs": True}}, Ramp(60.0, 2), 121, 0),
        ({"run": RUN | {"ramp": 60}, "constraints": {"calm": CALM}}, Ramp(60.0, 1), 122, 0),
    ],
)
def test_ramps_count(sections, ramp, runs, sets):
    """Whatever ramps the test run had itself: its parameters may be those that were there."""
    study = study_from_mapping(
        signal_study(budget={"trials": 7, "initial_trials": 2, "drawn_contexts": 5}, **sections)
    )
    found = time_of(study, [made(seconds=13.0, notes=Notes(ramped_seconds=12.0))])
    assert (found.of_run, found.ramp) == (1.0, ramp)
    assert found.seconds == pytest.approx(found.most * runs + 7 * sets)


def test_bags_are_proven_on_others():
    """By as many as it takes at least, and by no certificate, which `validate` refuses."""
    run = {"start": [{"play": "{drive}"}], "end": "played", "clock": "sim"}
    contexts = {"drive": {"distribution": "discrete", "values": ["one", "two"]}}
    study = study_from_mapping(signal_study(run=run, contexts=contexts))
    found = time_of(study, [made()])
    # 0.9^31 < 0.04 < 0.9^30.
    assert (found.drives, found.certificate) == (31, None)


def made(seconds=1.0, notes=NOTHING):
    outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0}, notes=notes)
    return Evaluation(0, 0, Stage.NOMINAL, {"gain": 0.5}, {}, 1, outcome, seconds=seconds)
