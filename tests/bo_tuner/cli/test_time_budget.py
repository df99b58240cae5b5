"""`tune --time`: the run finishes early, which is on record, so that it can be repeated."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
from axis import node
from command_runs import Runs, noisy_runs

from bo_tuner.cli.time_limit import TimeLimit
from bo_tuner.cli.time_plan import TimePlan
from bo_tuner.evidence.certificate.outlook import probable_certificate
from bo_tuner.evidence.facts import TrialsEnded
from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.plans import TIME_UP, Event, EventKind, Phase
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.trials import CHECKS, TUNING
from bo_tuner.tuning.summary import with_summary

OVER_AT_ONCE = ("--time", "0.001s")
FINISHED = (
    Event(Phase.TUNING, 1, EventKind.FINISH, TIME_UP),
    Event(Phase.CHECKING, 1, EventKind.FINISH, TIME_UP),
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    return noisy_runs(tmp_path_factory.mktemp("runs"), make_study, "timed_axis")


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
    assert "the time is up after 1 trial; the best so far is then settled and validated" in short
    assert "the time is up after 1 run that settles the answer; the best" in short
    ended = TrialsEnded(1, record.study.budget.trials, time_up=True)
    assert ended in run_verdict(record).remarks
    assert (record.summary["ended_on_request"], record.summary["ended_by_time"]) == (False, True)
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


class TestCertificate:
    """`--certify`: a certificate follows, within the time."""

    def test_after_a_run_it_is_that_of_its_result(self, runs):
        code, out, err = runs.begin("certified", "--trials", 4, "--time", "5h", "--certify")
        assert code == 0, err
        (certificate,) = (runs.latest("certified") / "certificates").glob("*.json")
        assert "; the limit shown with an assumption" in out
        shown = certificate.resolve().relative_to(runs.folder.resolve())
        assert f"certificate: {shown}" in out
        # What is expected after the initial design, and what came of it.
        assert re.search(
            r"in the time that is left: about \d more trials?, about \d+ s for the answer and its "
            r"validation, a certificate of probably \d+ to \d+ runs, about \d+ s.*, if it passes",
            err,
        )
        assert re.search(r"took \d+ s of 5 h: trials about \d+ s, settling the answer about", err)
        assert re.search(r"took \d+ s of 5 h, with the certificate", err)

    def test_without_time_for_it_there_is_none(self, runs):
        code, _, err = runs.begin("late", *OVER_AT_ONCE, "--certify")
        assert code == 1
        assert "no certificate: no time is left for it; validate " in err
        assert not (runs.latest("late") / "certificates").exists()

    def test_a_result_that_breaks_a_limit_gets_none(self, tmp_path, make_study):
        broken = Runs(
            tmp_path, make_study(nodes=node("broken_axis")), error="self.gain", peak="99.0"
        )
        code, _, err = broken.begin("broken", "--trials", 3, "--certify")
        assert code == 3
        assert "no certificate: " in err
        assert not (broken.latest("broken") / "certificates").exists()

    def test_words_are_not_json(self, runs):
        code, out, err = runs.begin("words", "--certify", "--json-lines")
        assert (code, out) == (2, "")
        assert "--certify: tells its verdict in words; leave --json-lines out" in err

    @pytest.mark.parametrize(
        ("result", "certificate", "finishes"),
        # Of 1000 s at most 500 are kept.
        [(600.0, 300.0, False), (750.0, 300.0, True), (450.0, 1e6, False), (550.0, 1e6, True)],
    )
    def test_time_is_kept_for_it(self, make_study, result, certificate, finishes):
        study, expected = make_study(), []
        status = SimpleNamespace(
            to_finish=result, certificate_seconds=certificate, expect_certificate=expected.append
        )
        limit = TimeLimit(1000.0)
        plan = TimePlan(study, status, limit, print, certify=True)
        assert expected == [probable_certificate(study).high]
        assert plan.has_to_finish is finishes
