"""Runs that were made before, with which a new run begins."""

import pytest

import bo_tuner as bt
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.trials import Stage, TrialState


def earlier(function, *gains, loads=(1.0, 2.0)):
    return [
        bt.EarlierRun({"gain": gain}, function({"gain": gain}, {"load": load}, 0), {"load": load})
        for gain in gains
        for load in loads
    ]


def test_they_are_trials_that_are_not_run_again(make_function_study, function, tmp_path):
    calls = []

    def counted(parameters, context, seed):
        calls.append(parameters["gain"])
        return function(parameters, context, seed)

    study, folder = make_function_study(6), tmp_path / "run"
    runs = earlier(function, 0.1, 0.25, 0.9)
    result = study.optimize(counted, folder, earlier=runs)
    trials = read_journal(folder / "journal.sqlite").trials
    assert len(trials) == 6
    assert [trial.parameters["gain"] for trial in trials[:3]] == [0.1, 0.25, 0.9]
    assert [len(trial.evaluations) for trial in trials[:3]] == [2, 2, 2]
    # How their contexts were chosen nobody knows.
    assert {e.stage for trial in trials[:3] for e in trial.evaluations} == {Stage.SEARCH}
    assert not set(calls) & {0.1, 0.9}
    assert 2.0 * result.best["gain"] * 2.0 <= 1.0 + 1e-9
    # The same call goes on with the run, which has them.
    again = study.optimize(counted, folder, earlier=runs)
    assert again.best == result.best
    assert len(read_journal(folder / "journal.sqlite").trials) == 6


def test_what_is_left_out_is_default_and_nominal(make_function_study, tmp_path):
    """Those of one parameter set are one trial; that failed with one of its runs."""
    runs = [
        bt.EarlierRun({}, {"error": 1.0, "peak": 1.0}),
        bt.EarlierRun({"gain": 0.5}, failure="it fell over"),
    ]
    with make_function_study().tuner(tmp_path / "run", earlier=runs) as tuner:
        assert tuner.ask().trial == 1
    (trial,) = read_journal(tmp_path / "run" / "journal.sqlite").trials
    assert (trial.state, trial.reason) == (TrialState.FAILED, "it fell over")
    assert [e.parameters for e in trial.evaluations] == [{"gain": 0.5}] * 2
    # The mean of the distribution of the load.
    assert [e.context for e in trial.evaluations] == [{"load": 1.5}] * 2


@pytest.mark.parametrize(
    ("run", "error", "said"),
    [
        (({"gian": 0.5}, {}), bt.StudyError, r"earlier\[0\]\.gian: unknown; expected one of gain"),
        (({}, {"error": 1.0}), bt.MetricsError, r"earlier\[0\]: metric peak is missing"),
        (
            ({}, {"error": 1.0, "peak": 1.0}, {"lode": 1.0}),
            bt.StudyError,
            r"earlier\[0\]\.lode: unknown; expected one of load",
        ),
        (({"gain": "1"}, {}), bt.StudyError, r"earlier\[0\]\.gain: expected a number, found text"),
        (
            ({"gain": 7.0}, {"error": 1.0, "peak": 1.0}),
            bt.RunRecordError,
            "earlier: none of its 1 trial can be used: 1 trial outside the bounds of gain",
        ),
    ],
)
def test_what_is_none_of_the_study_is_refused(make_function_study, tmp_path, run, error, said):
    study, folder = make_function_study(), tmp_path / "run"
    with pytest.raises(error, match=said):
        study.tuner(folder, earlier=[bt.EarlierRun(*run)])
    # It is no run yet.
    study.tuner(folder).close()


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        (3, "earlier: expected a list of runs, found 3"),
        ([{"gain": 0.5}], r"earlier\[0\]: expected an EarlierRun, found a mapping"),
        ([bt.EarlierRun([0.5])], r"earlier\[0\]: expected a mapping, found a list of 1"),
        ([bt.EarlierRun({}, {}, 3)], r"earlier\[0\]: expected a mapping, found 3"),
        ([bt.EarlierRun({}, failure=3)], r"earlier\[0\]\.failure: expected text, found 3"),
    ],
)
def test_what_is_no_earlier_run(make_function_study, tmp_path, runs, said):
    with pytest.raises(bt.StudyError, match=said):
        make_function_study().tuner(tmp_path / "run", earlier=runs)


def test_an_integer_may_stand_for_a_double(make_function_study, function, tmp_path):
    runs = [bt.EarlierRun({"gain": 1}, function({"gain": 1}, {"load": 1}, 0), {"load": 1})]
    make_function_study().tuner(tmp_path / "run", earlier=runs).close()
    (trial,) = read_journal(tmp_path / "run" / "journal.sqlite").trials
    assert repr(trial.parameters["gain"]) == "1.0"


def test_more_than_the_budget(make_function_study, function, tmp_path):
    runs = earlier(function, 0.1, 0.2, 0.3, 0.4)
    with pytest.raises(bt.StudyError, match="budget: expected more than the 4 trials"):
        make_function_study(4).tuner(tmp_path / "run", earlier=runs)


def test_limits_relative_to_the_default(make_function_study, function, tmp_path):
    """What the default had beside them is not known."""
    study = make_function_study(
        constraints={"peak": {"kind": "worst_case", "metric": "peak", "upper": "1.1 * default"}}
    )
    with pytest.raises(bt.StudyError, match="earlier: expected none, since limits are relative"):
        study.tuner(tmp_path / "run", earlier=earlier(function, 0.1))
