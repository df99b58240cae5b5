"""`tune --time`: the run finishes early, which is on record, so that it can be repeated."""

from dataclasses import replace

import pytest
from axis import node
from command_runs import Runs

from bo_tuner.plans import Event, EventKind, Phase
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.trials import CHECKS, TUNING
from bo_tuner.tuning.summary import with_summary

OVER_AT_ONCE = ("--time", "0.001s")
FINISHED = (
    Event(Phase.TUNING, 1, EventKind.FINISH),
    Event(Phase.CHECKING, 1, EventKind.FINISH),
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    seed = {"node": "axis", "parameter": "seed"}
    study = make_study(nodes=node("timed_axis"), seed_parameter=seed)
    error = "25 * (self.gain - 0.3) ** 2 + self.load * (1 + 0.001 * (self.seed % 100))"
    folder = tmp_path_factory.mktemp("runs")
    return Runs(folder, study, error=error, peak="self.load * self.gain")


@pytest.fixture(scope="module")
def short(runs):
    """Errors of a run whose time is over at once."""
    code, _, err = runs.begin("short", *OVER_AT_ONCE)
    assert code in (0, 3), err
    return err


@pytest.fixture
def stages(runs):
    """Function that counts the evaluations of a run: of trials, to settle the answer, others."""

    def count(name):
        found = [e.stage for e in read_run(runs.latest(name)).evaluations]
        trials, checks = (sum(s in kind for s in found) for kind in (TUNING, CHECKS))
        return trials, checks, len(found) - trials - checks

    return count


def test_a_run_whose_time_is_over_still_has_a_result(runs, short, stages):
    record = read_run(runs.latest("short"))
    assert record.events == FINISHED
    assert len(record.trials) == 1
    _, checks, validation = stages("short")
    assert checks == 1
    assert validation == 2 * record.study.budget.validation_draws
    assert "asked to finish after 1 trial; the best so far is then settled and validated" in short
    assert "asked to finish after 1 run that settles the answer; the best" in short
    assert "warning: it took longer than the --time, by " in short


def test_its_result_is_made_from_the_record_as_well(runs, short):
    record = read_run(runs.latest("short"))
    made = with_summary(replace(record, summary=None), lambda line: None).summary
    assert made is not None
    assert made == {name: record.summary[name] for name in made}


def test_a_resumed_run_repeats_it(runs, short, stages):
    """It was killed in the validation, and the time of the next session is not limited."""
    trials, checks, _ = stages("short")
    code, _, _ = runs.begin("killed", *OVER_AT_ONCE, kill=trials + checks + 3)
    assert code == -9
    runs.resume("killed")
    assert runs.results("killed") == runs.results("short")
    assert read_journal(runs.latest("killed") / "journal.sqlite").events == FINISHED


def test_it_can_be_given_more_trials(runs, short, stages):
    runs.copy("short", "more")
    runs.resume("more", "--trials", 3)
    record = read_run(runs.latest("more"))
    assert [event.kind for event in record.events] == [*["finish"] * 2, "extend"]
    assert len(record.trials) == 3
    # One of before, and as many as the answer takes, which needs several of its own.
    assert stages("more")[1] > 2
    assert with_summary(replace(record, summary=None), lambda line: None).summary is not None


def test_with_time_enough_it_is_the_run_without_a_limit(runs):
    for name, arguments in (("free", ()), ("long", ("--time", "5h"))):
        assert runs.begin(name, "--trials", 3, *arguments)[0] == 0
    assert runs.results("free") == runs.results("long")


def test_bad_input(runs):
    code, out, err = runs.begin("bad", "--time", "10")
    assert (code, out) == (2, "")
    assert "argument --time: 10: expected a time such as 90s, 10min or 2h" in err
