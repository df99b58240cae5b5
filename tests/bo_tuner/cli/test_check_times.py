"""How long tuning will take, by a test run that `check` has made."""

import re

import pytest
from signal_runs import signal_study

from bo_tuner.cli.check import _estimate
from bo_tuner.run_notes import Notes
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage

RUN = {"end": {"after": 2.0}}
CALM = {"kind": "chance", "metric": "error", "upper": "1.1 * default", "probability": 0.9}


@pytest.mark.parametrize(
    ("sections", "said", "runs", "sets"),
    [
        # In seconds, with 1 s of the run itself; the default is run beside each one in the last.
        ({"run": RUN}, "", 1, 0),
        ({"run": RUN | {"ramp": 60}}, "a ramp takes 60 s, once for each parameter set", 1, 60),
        (
            {"run": RUN | {"ramp": 60}, "park": {"between_runs": True}},
            "a ramp takes 60 s, twice for each test run",
            121,
            0,
        ),
        (
            {"run": RUN | {"ramp": 60}, "constraints": {"calm": CALM}},
            "a ramp takes 60 s, once for each test run",
            122,
            0,
        ),
    ],
)
def test_ramps_count(capsys, sections, said, runs, sets):
    """Whatever ramps the test run had itself: its parameters may be those that were there."""
    study = study_from_mapping(
        signal_study(budget={"trials": 7, "initial_trials": 2, "drawn_contexts": 5}, **sections)
    )
    ramped = Notes(ramped_seconds=12.0)
    outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0}, notes=ramped)
    made = Evaluation(0, 0, Stage.NOMINAL, {"gain": 0.5}, {}, 1, outcome, seconds=13.0)
    _estimate(study, [made])
    out = " ".join(capsys.readouterr().out.split())
    assert "a test run took 1 s" in out
    assert said in out
    assert ("a ramp takes" in out) == bool(said)
    count, time, unit = re.search(
        r"study: at most (\d+) test runs, about ([\d.]+) (s|min|h)", out
    ).groups()
    seconds = float(time) * {"s": 1.0, "min": 60.0, "h": 3600.0}[unit]
    # It is shown in whole hours at worst.
    assert seconds == pytest.approx(int(count) * runs + 7 * sets, rel=0.2)


def test_bags_are_proven_on_others(capsys):
    """By as many as it takes at least, and by no certificate, which `validate` refuses."""
    run = {"start": [{"play": "{drive}"}], "end": "played", "clock": "sim"}
    contexts = {"drive": {"distribution": "discrete", "values": ["one", "two"]}}
    study = study_from_mapping(signal_study(run=run, contexts=contexts))
    outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0}, notes=Notes())
    _estimate(study, [Evaluation(0, 0, Stage.NOMINAL, {"gain": 0.5}, {}, 1, outcome, seconds=1.0)])
    out = " ".join(capsys.readouterr().out.split())
    # 0.9^31 < 0.04 < 0.9^30.
    assert "validate --drives with at least 31 drives that are not in the study" in out
    assert "certificate:" not in out
