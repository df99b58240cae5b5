"""JSON lines: strict, complete, and no reason for a run to end."""

import dataclasses
import io
import json
import signal
import time

import pytest
from axis import write_study
from commands import Fork, finish, start
from strict_json import strict
from waiting import DEADLINE

from bo_tuner.cli.tune import make_parser
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.stopping import StopAdvice
from bo_tuner.monitoring.json_lines import JsonLines
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.plans import Phase
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.trials import WorstCase


@pytest.fixture
def tune(tmp_path, make_study):
    write_study(tmp_path, make_study())

    def begin(*arguments, how=Fork, **environment):
        return how("tune", *arguments, folder=tmp_path, env=environment)

    return begin


NEW = ("--study", "axis.yaml", "--backend", "inprocess")


def ended(process):
    code, out, err = finish(process)
    return code, [strict(line) for line in out.splitlines()], err


class TestRun:
    def test_events_match_the_record(self, tune, tmp_path):
        code, events, err = ended(tune(*NEW, "--json-lines"))
        assert (code, err) == (0, "")
        assert [event["event"] for event in events[:2]] == ["run", "phase"]
        left = [event["time_left"] for event in events if event["event"] == "phase"]
        assert left[0] is None
        assert len(left) == 3
        assert min(left[1:]) > 0.0
        # Report and bundle are shown as messages.
        ends = ["result", "message", "message", "end"]
        assert [event["event"] for event in events[-4:]] == ends
        assert events[-1]["exit_code"] == 0
        times = [event["time"] for event in events]
        assert times == sorted(times)
        folder = tmp_path / events[0]["folder"]
        content = read_journal(folder / "journal.sqlite")
        told = [event for event in events if event["event"] == "evaluation"]
        assert [
            (
                evaluation["parameters"],
                evaluation["context"],
                evaluation["seed"],
                evaluation["metrics"],
            )
            for evaluation in told
        ] == [
            (
                dict(c.parameters),
                dict(c.context),
                c.seed,
                dict(c.outcome.metrics),
            )
            for c in content.evaluations
        ]
        told = [event for event in events if event["event"] == "trial"]
        assert [trial["parameters"] for trial in told] == [
            dict(trial.parameters) for trial in content.trials
        ]
        for event, trial in zip(told, content.trials, strict=True):
            # A repetition is in the worst context alone.
            errors = trial.observations("error")
            mean = sum(errors) / len(errors) if errors else None
            assert event["mean_metrics"].get("error") == mean
            assert event["recalled"] is False
        summary = json.loads((folder / "summary.json").read_text())
        assert events[-4].items() >= summary.items()

    def test_quiet_shows_the_result_alone(self, tune):
        process = tune(*NEW, "--quiet")
        code, out, err = finish(process)
        assert (code, err) == (0, "")
        assert out.splitlines()[0].endswith("; no limit broken in 5 test runs; not certified yet")

    def test_an_interruption_is_shown_and_the_rest_recalled(self, tune, tmp_path):
        process = tune(*NEW, "--json-lines", how=start, PACE="0.05")
        lines = iter(process.stdout.readline, "")
        first = [strict(next(lines)) for _ in range(2)]
        for line in lines:
            first.append(strict(line))
            if first[-1]["event"] == "trial":
                break
        process.send_signal(signal.SIGTERM)
        code, events, err = ended(process)
        assert code == 143
        assert events[-1] == {"event": "end", "time": events[-1]["time"], "exit_code": 143}
        assert events[-2]["event"] == "message"
        assert events[-2]["text"] in err
        trials = len(read_journal(tmp_path / first[0]["folder"] / "journal.sqlite").trials)
        code, events, _ = ended(tune("--resume", "runs/latest", "--json-lines"))
        assert code == 0
        told = [event for event in events if event["event"] == "trial"]
        assert [event["recalled"] for event in told] == [True] * trials + [False] * (5 - trials)
        assert [event["trial"] for event in told] == list(range(5))

    def test_a_reader_that_goes_away_does_not_end_the_run(self, tune, tmp_path):
        process = tune(*NEW, "--json-lines", how=start, PACE="0.02")
        assert strict(process.stdout.readline())["event"] == "run"
        process.stdout.close()
        with process.stderr as stderr:
            err = stderr.read()
        assert process.wait(DEADLINE) == 0, err
        (line,) = err.splitlines()
        assert line == "no more JSON lines: Broken pipe; the run continues"
        assert (tmp_path / "runs/latest/summary.json").exists()


def test_not_together_with_quiet(capsys):
    with pytest.raises(SystemExit) as ended:
        make_parser().parse_args(["--json-lines", "--quiet"])
    assert ended.value.code == 2
    assert "--quiet: not allowed with argument --json-lines" in capsys.readouterr().err


def test_what_is_not_a_number_becomes_null(make_study, make_trial):
    study, out = make_study(), io.StringIO()
    status = RunStatus(study, METHODS["IV"])
    lines = JsonLines(study, status, out)
    trial = make_trial(0, {"gain": float("inf")}, [1.0])
    trial = dataclasses.replace(
        trial,
        worst_cases={"peak": WorstCase(float("nan"), {"load": float("-inf")}, 0.5)},
        warnings=("ü\n",),
    )
    before = time.time()
    lines.begin(Phase.TUNING, 5)
    lines.trial(trial, None)
    lines.advise(StopAdvice(1, 4, float("nan"), 0.5))
    lines.pause(True)
    phase, told, advice, pause = [strict(line) for line in out.getvalue().splitlines()]
    assert before <= phase["time"] <= time.time()
    assert told["parameters"] == {"gain": None}
    assert told["worst_cases"]["peak"]["value"] is None
    assert told["worst_cases"]["peak"]["context"]["load"] is None
    assert told["incumbent"] is told["overhead"] is None
    assert told["warnings"] == ["ü\n"]
    assert (advice["expected_gain"], advice["noise"]) == (None, 0.5)
    assert pause["paused"] is True
