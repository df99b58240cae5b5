"""``tune --confirm``: what is shown, asked and put on record before each trial."""

import json
import sys
from types import SimpleNamespace

import pytest
from axis import write_study
from in_process import complaint
from terminals import converse

from bo_tuner.cli import confirm, tune
from bo_tuner.cli.confirm import Confirmation, asked_about, in_lines, refused_in
from bo_tuner.codec.reading import JSON, read
from bo_tuner.codec.writing import to_json
from bo_tuner.method_names import SAFE
from bo_tuner.methods.registry import METHODS
from bo_tuner.optimizers.base import REPETITION
from bo_tuner.plans import Event, EventKind
from bo_tuner.storage.record import read_run
from bo_tuner.tuning.question import Asked, Given, Question, Reply

OPTIONS = ("--backend", "inprocess", "--confirm")
ASKED = "the trials: "


@pytest.fixture
def study_file(tmp_path, make_study):
    return write_study(tmp_path, make_study(safe_search=True))


def test_each_answer_is_on_record(tmp_path, study_file):
    """The first trial is allowed, the second refused, another one allowed, and then no more."""
    command = (sys.executable, "-m", "bo_tuner", "tune", *OPTIONS, "--study", str(study_file))
    answers = [b"y\n", b"maybe\n", b"n\n", b"y\n", b"e\n"]
    converse(command, [(ASKED, answer) for answer in answers], cwd=tmp_path)
    record = read_run(tmp_path / "runs" / "latest")
    kinds = [event.kind for event in record.events]
    accept, refuse = EventKind.ACCEPT, EventKind.REFUSE
    assert kinds == [accept, refuse, accept, refuse, EventKind.FINISH]
    assert [event.tasks for event in record.events] == [0, 1, 1, 2, 2]
    allowed = [json.loads(e.detail) for e in record.events if e.kind is accept]
    assert [dict(trial.parameters) for trial in record.trials] == [a["parameters"] for a in allowed]
    assert all(answer["on"] == "terminal" and answer["at"] for answer in allowed)
    for refused in refused_in(record.events):
        assert refused not in [answer["parameters"] for answer in allowed]


def test_shows_differences_predictions_and_the_nearest(make_study, function_backend):
    from bo_tuner.tuning.driver import Driver
    from bo_tuner.tuning.loop import Tuning

    study = make_study(start=["default"])

    def run(gain, load, seed, **_):
        return {"error": 1.0 - gain, "peak": 0.3 + 0.1 * load}

    trials = list(Tuning(study, Driver(function_backend(study, run)), METHODS[SAFE]))
    last = trials[-1].parameters["gain"]
    asked = asked_about(study, METHODS[SAFE], trials, {"gain": 0.625}, REPETITION)
    # What goes to the live page comes back as it was.
    assert read(Asked, json.loads(json.dumps(to_json(asked))), JSON) == asked
    lines = list(in_lines(asked))
    assert lines[:2] == [
        "next, trial 5: the same again, to learn its noise",
        f"  gain: 0.625 (trial before {last:.4g}, default 0.5)",
    ]
    # The peak in the worst context is 0.5 whatever the gain, and the error falls with it.
    error = next(line for line in lines if line.startswith("  predicted error"))
    peak = next(line for line in lines if line.startswith("  predicted peak"))
    assert float(error.split()[2]) == pytest.approx(0.375, abs=0.05)
    assert float(peak.split()[2]) == pytest.approx(0.5, abs=0.02)
    assert peak.endswith("limit 1")
    nearest = max(trials, key=lambda trial: trial.parameters["gain"])
    assert f"nearest tried, trial {nearest.number}: " in lines[-2]


class Unanswered:
    """A question that is answered after so many looks; each takes a minute."""

    def __init__(self, looks, monkeypatch):
        self.looks, self.now = looks, 0.0
        monkeypatch.setattr(confirm.time, "monotonic", lambda: self.now)

    def __call__(self, question):
        self.now += 60.5
        self.looks -= 1
        if self.looks == 0:
            question.answer(Given(Reply.ACCEPT, "live page"))


class TestWaiting:
    @pytest.fixture
    def wait(self, make_study, monkeypatch, capsys):
        """Function that waits for an answer for some minutes; returns what is said meanwhile."""

        def waited(minutes, is_terminal):
            monkeypatch.setattr(confirm.sys.stdin, "isatty", lambda: is_terminal, raising=False)
            confirmation = Confirmation(make_study(), METHODS[SAFE], lambda: [])
            look = Unanswered(minutes, monkeypatch)
            monkeypatch.setattr(confirmation, "_look_at_terminal", look)
            task = SimpleNamespace(parameters={"gain": 0.5}, origin="start")
            assert confirmation.ask(task, Question(), lambda: None).allowed
            out, err = capsys.readouterr()
            return out + err

        return waited

    def test_a_terminal_has_one_line_that_counts(self, wait):
        said = wait(4, is_terminal=True)
        assert said.count("still waiting") == 4
        lines = [line for line in said.split("\n") if "still waiting" in line]
        assert len(lines) == 1
        assert lines[0].split("\r")[-1].startswith("\x1b[Kstill waiting, 4 min; try it?")

    def test_a_file_is_told_ever_more_rarely(self, wait):
        said = wait(9, is_terminal=False)
        told = [line for line in said.splitlines() if "still waiting" in line]
        assert told == [f"still waiting, {minutes} min" for minutes in (1, 2, 4, 8)]


class TestRefused:
    def test_without_a_safe_search(self, tmp_path, make_study, capsys):
        study = write_study(tmp_path, make_study())
        message = complaint(tune, capsys, *OPTIONS, "--study", study)
        assert message == (
            "error: --confirm: expected a study with `safe_search: true` (see tune --help)"
        )

    def test_without_a_terminal(self, study_file, capsys):
        message = complaint(tune, capsys, *OPTIONS, "--study", study_file)
        assert message == (
            "error: --confirm: no terminal to ask on; add --web --web-control to answer on the "
            "live page (see tune --help)"
        )

    def test_with_several_workers(self, study_file, capsys):
        options = (*OPTIONS, "--study", study_file, "--workers", "2")
        message = complaint(tune, capsys, *options)
        assert message == "error: --confirm: expected 1 worker, found 2 (see tune --help)"

    def test_beside_json_lines(self, study_file, capsys):
        message = complaint(tune, capsys, *OPTIONS, "--study", study_file, "--json-lines")
        assert (
            message == "error: --confirm: asks in words; leave --json-lines out (see tune --help)"
        )


def test_refused_sets_are_read_from_events():
    refused = Event("tuning", 3, EventKind.REFUSE, json.dumps({"parameters": {"kp": 0.4}}))
    allowed = Event("tuning", 3, EventKind.ACCEPT, json.dumps({"parameters": {"kp": 0.5}}))
    assert refused_in([refused, allowed]) == [{"kp": 0.4}]
