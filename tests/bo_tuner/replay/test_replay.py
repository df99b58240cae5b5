"""Running recorded evaluations again; tests/ros has it on nodes."""

import json
from dataclasses import replace
from math import nextafter

import numpy as np
import pytest
from axis import node, write_axis
from bag_readers import READERS, with_rosbags
from in_process import call, complaint
from made_runs import INITIAL, make_run
from recorded_trials import event, joints

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.protocol import SequentialBackend, opened_backend
from bo_tuner.cli import replay as command
from bo_tuner.errors import OutputError, RunRecordError, StudyError
from bo_tuner.recording.bag import NANOSECONDS
from bo_tuner.recording.recovery import read_messages
from bo_tuner.recording.retention import custom_data
from bo_tuner.replay.replay import changed_provenance, find_evaluation, find_trial, replay
from bo_tuner.replay.side_by_side import write_side_by_side
from bo_tuner.storage.trust import trust
from bo_tuner.study.study_file import load_study, parse_study, study_to_yaml
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, TrialState


@pytest.fixture
def axis(tmp_path, monkeypatch):
    """Class of a small object, which fails evaluations with gains above 0.7."""
    error = "(self.gain - 0.3) ** 2 + self.load + self.seed % 97 / 1000"
    write_axis(
        tmp_path,
        "replayed_axis",
        error=error,
        peak="self.gain * self.load",
        fails="self.gain > 0.7",
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, "replayed_axis", raising=False)
    axis = __import__("replayed_axis").Axis
    axis.reason = "stalled at 3 mm"
    return axis


@pytest.fixture
def record(tmp_path, axis, make_study):
    study = make_study(
        nodes=node("replayed_axis"),
        budget=INITIAL | {"trials": 5, "initial_trials": 5},
    )
    made = make_run(tmp_path / "run", study, InProcessBackend(study), result=2)
    states = {trial.state for trial in made.trials}
    assert states == {TrialState.COMPLETE, TrialState.FAILED}, "the seed gives both"
    trust(study)
    return made


def run(capsys, *arguments):
    return call(command, capsys, *arguments)


def refusal(capsys, *arguments):
    return complaint(command, capsys, *arguments)


def complete(record):
    return [trial for trial in record.trials if trial.state is TrialState.COMPLETE]


class TestMilling:
    def test_every_evaluation_of_a_run_comes_out_bit_for_bit(self, tmp_path, capsys):
        study = load_study("benchmark").replace(
            trials=2, initial_trials=2, drawn_contexts=1, search_evaluations=1
        )
        record = make_run(tmp_path / "run", study, InProcessBackend(study))
        files = sorted(record.path.rglob("*"))
        assert len(record.evaluations) == 4
        for recorded in record.evaluations:
            evaluation = recorded
            code, out, err = run(
                capsys, record.path, "--trial", evaluation.trial, "--evaluation", evaluation.index
            )
            assert code == 0
            assert out.count("equal") == len(study.metrics)
            assert "complete, as recorded\nconfirmed" in out
            assert "no bag: a test run in process has no messages" in err
            backend = InProcessBackend(study)
            backend.open()
            result = replay(record, recorded, backend)
            assert dict(result.replayed.outcome.metrics) == dict(evaluation.outcome.metrics)
        assert sorted(record.path.rglob("*")) == files


class TestVerdict:
    def test_one_bit_is_a_difference(self, record, axis, capsys):
        trial = complete(record)[0].number
        assert run(capsys, record.path, "--trial", trial)[0] == 0
        axis.drift = True
        code, out, _ = run(capsys, record.path, "--trial", trial)
        assert code == 3
        assert "NOT confirmed" in out
        lines = {line.split()[1]: line for line in out.splitlines() if line.startswith("│")}
        assert "DIFFERENT" in lines["error"]
        assert "equal" in lines["peak"]

    def test_a_failed_evaluation_fails_again_for_the_same_reason(self, record, axis, capsys):
        (number, *_) = [t.number for t in record.trials if t.state is TrialState.FAILED]
        code, out, _ = run(capsys, record.path, "--trial", number)
        assert code == 0
        assert "failed, as recorded: axis: stalled at 3 mm" in out
        axis.reason = "stalled at 4 mm"
        code, out, _ = run(capsys, record.path, "--trial", number)
        assert code == 3
        assert "recorded: failed: axis: stalled at 3 mm" in out
        assert "replayed: failed: axis: stalled at 4 mm" in out

    @pytest.mark.parametrize(
        ("there", "here", "confirmed"),
        [
            ("inprocess", "inprocess", False),
            ("ros", "inprocess", True),
            ("inprocess", "ros", True),
            ("ros", "ros", True),
        ],
    )
    def test_what_a_clock_measures_is_judged_in_process_only(self, record, there, here, confirmed):
        metrics = dict(record.study.metrics)
        metrics["peak"] = replace(metrics["peak"], reproducible=False)
        record = replace(record, study=replace(record.study, metrics=metrics), backend=there)
        recorded = find_evaluation(record, complete(record)[0].number, None)

        class Backend(SequentialBackend):
            name = here
            changed = "peak"

            def outcome(self, planned):
                found = dict(recorded.outcome.metrics)
                found[self.changed] = nextafter(found[self.changed], 9.0)
                return Outcome(EvaluationState.COMPLETE, found)

        backend = Backend(record.study)
        assert replay(record, recorded, backend).confirmed is confirmed
        backend.changed = "error"
        assert not replay(record, recorded, backend).confirmed

    def test_without_a_metric_that_can_be_judged_only_the_end_is_confirmed(self, record):
        """As of metrics of signals, which differ from run to run."""
        metrics = {
            name: replace(metric, reproducible=False)
            for name, metric in record.study.metrics.items()
        }
        record = replace(record, study=replace(record.study, metrics=metrics), backend="ros")
        recorded = find_evaluation(record, complete(record)[0].number, None)

        class Backend(SequentialBackend):
            name = "ros"
            ends = Outcome(EvaluationState.COMPLETE, dict(recorded.outcome.metrics))

            def outcome(self, planned):
                return self.ends

        backend = Backend(record.study)
        found = replay(record, recorded, backend)
        assert found.confirmed
        assert "the way the test run ended is confirmed; no metric" in found.verdict
        backend.ends = Outcome(EvaluationState.FAILED, reason="stalled")
        assert replay(record, recorded, backend).verdict == "NOT confirmed"

    def test_a_study_without_a_seed_parameter_says_that_noise_differs(
        self, record, tmp_path, make_study, capsys
    ):
        noise = "noise, if there is any, was not the same"
        assert noise not in run(capsys, record.path)[1]
        study = make_study(
            nodes=node("replayed_axis"),
            seed_parameter=None,
            budget=INITIAL | {"trials": 5, "initial_trials": 5},
        )
        made = make_run(tmp_path / "seedless", study, InProcessBackend(study), result=2)
        trust(study)
        assert noise in run(capsys, made.path)[1]

    def test_an_evaluation_that_fails_now_is_not_confirmed(self, record, function_backend, failed):
        recorded = find_evaluation(record, complete(record)[0].number, None)
        backend = function_backend(record.study, lambda **values: failed("axis: stalled"))
        result = replay(record, recorded, backend)
        assert not result.confirmed
        assert all(row.difference is None and not row.agrees for row in result.metrics)
        assert backend.calls == [
            dict(recorded.parameters) | dict(recorded.context) | {"seed": recorded.seed}
        ]

    @pytest.mark.parametrize(("peak", "confirmed"), [(0.1, True), (50.0, False)])
    def test_one_that_was_cut_short_is_held_against_its_bounds(self, record, peak, confirmed):
        """The replay is whole: a metric is at least as large, or the record is not confirmed."""
        whole = find_evaluation(record, complete(record)[0].number, None)
        outcome = Outcome.cut_short(0.5, {"peak": peak}, "peak at least")
        backend = InProcessBackend(record.study)
        with opened_backend(backend):
            result = replay(record, replace(whole, outcome=outcome), backend)
        assert result.replayed.outcome.complete
        assert result.confirmed == confirmed
        assert [row.metric.name for row in result.metrics if row.judged] == ["peak"]


class TestChoice:
    def test_best_is_the_result(self, record):
        assert find_trial(record, "best") == 2
        unfinished = replace(record, summary=None)
        assert find_trial(unfinished, "best") in [trial.number for trial in complete(record)]

    def test_worst_has_the_largest_worst_case(self, record):
        worst = {trial.number: trial.worst_cases["peak"].value for trial in complete(record)}
        assert find_trial(record, "worst") == max(worst, key=worst.get)

    def test_the_default_is_the_best_trial(self, record, capsys):
        assert run(capsys, record.path) == run(capsys, record.path, "--trial", "best")

    def test_the_default_is_the_evaluation_with_the_largest_peak(self, record):
        for trial in complete(record):
            peaks = [evaluation.outcome.metrics["peak"] for evaluation in trial.evaluations]
            found = find_evaluation(record, trial.number, None)
            assert found == trial.evaluations[int(np.argmax(peaks))]
            assert found.parameters == trial.parameters

    @pytest.mark.parametrize(("direction", "pick"), [("minimize", max), ("maximize", min)])
    def test_without_a_worst_case_it_is_the_one_with_the_worst_objective(
        self, record, direction, pick
    ):
        objective = replace(record.study.objective, direction=direction)
        study = replace(record.study, constraints={}, objective=objective)
        trial = complete(record)[0]
        errors = [evaluation.outcome.metrics["error"] for evaluation in trial.evaluations]
        found = find_evaluation(replace(record, study=study), trial.number, None)
        assert found.outcome.metrics["error"] == pick(errors)

    def test_a_failed_evaluation_goes_first(self, record):
        (trial, *_) = [t for t in record.trials if t.state is TrialState.FAILED]
        assert find_evaluation(record, trial.number, None) == trial.evaluations[-1]

    def test_checks_of_a_candidate_are_evaluations_of_its_trial_and_the_validation_is_not(
        self, record
    ):
        trial = complete(record)[0]
        item = record.evaluations[0]

        def extra(stage, index):
            metrics = {"error": 1.0, "peak": 99.0}
            outcome = Outcome(EvaluationState.COMPLETE, metrics)
            return Evaluation(trial.number, index, stage, item.parameters, {}, 1, outcome)

        for stage, found in ((Stage.CHECK_WORST, 50), (Stage.VALIDATION, None)):
            longer = replace(record, evaluations=(*record.evaluations, extra(stage, 50)))
            index = find_evaluation(longer, trial.number, None).index
            assert (index == 50) is (found == 50)

    def test_of_two_evaluations_in_one_place_the_later_counts(self, record):
        """The first was left behind by a kill."""
        trial = complete(record)[0]
        item = next(c for c in record.evaluations if c.trial == trial.number)
        again = replace(item, seed=item.seed + 1)
        longer = replace(record, evaluations=(*record.evaluations, again))
        assert find_evaluation(longer, trial.number, item.index) is again

    def test_what_is_not_there(self, record):
        for which in ("99", "-1", "1.0", "first", "", "9" * 5000, "1\n"):
            with pytest.raises(RunRecordError, match="and the run has trials 0 to 4"):
                find_trial(record, which)
        with pytest.raises(RunRecordError, match="has no test run 7, only 0 to "):
            find_evaluation(record, complete(record)[0].number, 7)
        nothing = replace(record, evaluations=(), trials=(), summary=None)
        for which in ("best", "worst"):
            with pytest.raises(RunRecordError, match=f"so none is {which}"):
                find_trial(nothing, which)
        with pytest.raises(RunRecordError, match="the run has no trials yet"):
            find_trial(nothing, "0")


def test_what_else_has_changed_since(record):
    now = dict(record.provenance) | {"numpy": "0.1", "started": "later", "process": "1"}
    then = record.provenance["numpy"]
    assert changed_provenance(record, now) == [f"numpy {then} -> 0.1"]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--output", "x"), "--output needs --backend ros"),
        (("--attach",), "--attach needs --backend ros"),
        (("--evaluation", "one"), "--evaluation: one: expected a whole number"),
        (("--backend", "gazebo"), "--backend: invalid choice"),
        (("--trial", "99"), "no trial '99'; expected best, worst or a number"),
        (("--trial", "0", "--evaluation", "-3"), "trial 0 has no test run -3"),
    ],
)
def test_wrong_options(record, capsys, arguments, complaint):
    line = refusal(capsys, record.path, *arguments)
    assert line.startswith("error: ")
    assert complaint in line


def test_no_run(tmp_path, capsys):
    assert "no such run folder" in refusal(capsys, tmp_path / "nothing")


class TestReproducible:
    def test_the_shipped_studies_say_what_a_clock_measures(self):
        for name in ("benchmark", "full"):
            metrics = load_study(name).metrics.values()
            assert [m.name for m in metrics if not m.reproducible] == ["return_time"]

    def test_in_a_study_file_and_back(self, make_study):
        study = make_study(
            metrics={"error": {"node": "axis"}, "peak": {"node": "axis", "reproducible": False}}
        )
        assert [m.reproducible for m in study.metrics.values()] == [True, False]
        assert parse_study(study_to_yaml(study)) == study

    def test_only_true_or_false(self, make_study):
        with pytest.raises(StudyError, match=r"metrics\.peak\.reproducible: expected true or"):
            make_study(
                metrics={"error": {"node": "axis"}, "peak": {"node": "axis", "reproducible": 1}}
            )


def state(seconds, velocity):
    return joints(round(seconds * NANOSECONDS), velocity)


class TestSideBySide:
    SIDES = {  # noqa: RUF012
        "default": [event("/axis"), state(100.0, 1.0), state(100.5, 2.0)],
        # A message may overtake another one of the same topic.
        "tuned": [event("/axis"), state(250.75, 3.0), state(251.75, 5.0), state(251.25, 4.0)],
    }

    @pytest.mark.parametrize("read", READERS)
    def test_both_begin_at_the_same_time(self, tmp_path, read):
        bag = tmp_path / "replay" / "trial_0001_evaluation_02"
        assert write_side_by_side(bag, self.SIDES, {"seed": "7", "context": {"load": 1.5}})
        found = [
            (topic, time / 1e9, message.header.stamp.sec + message.header.stamp.nanosec / 1e9,
             message.velocity[0])
            for topic, time, message in read(bag)
            if topic.endswith("/joint_states")
        ]  # fmt: skip
        assert sorted(found) == [
            ("/default/joint_states", 100.0, 100.0, 1.0),
            ("/default/joint_states", 100.5, 100.5, 2.0),
            ("/tuned/joint_states", 100.0, 100.0, 3.0),
            ("/tuned/joint_states", 100.5, 100.5, 4.0),
            ("/tuned/joint_states", 101.0, 101.0, 5.0),
        ]
        events = [(topic, time, m.node, m.stamp.nanosec) for topic, time, m in read(bag)
                  if topic.endswith("/parameter_events")]  # fmt: skip
        assert sorted(events) == [
            (f"/{side}/parameter_events", 100 * NANOSECONDS, "/axis", 5)
            for side in ("default", "tuned")
        ]
        # In the file as well, for those who read it as it comes.
        times = [time for time, _ in read_messages(bag / f"{bag.name}.mcap")]
        assert len(times) == 7
        assert times == sorted(times)
        data = custom_data(bag)
        assert data["seed"] == "7"
        assert json.loads(data["context"]) == {"load": 1.5}

    def test_an_older_bag_is_replaced(self, tmp_path):
        bag = tmp_path / "bag"
        write_side_by_side(bag, self.SIDES, {})
        write_side_by_side(bag, {"default": [state(1.0, 9.0)]}, {})
        assert [(topic, m.velocity[0]) for topic, _, m in with_rosbags(bag)] == [
            ("/default/joint_states", 9.0)
        ]
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]

    def test_a_side_without_stamps_is_at_the_beginning(self, tmp_path):
        bag = tmp_path / "bag"
        sides = {"default": [state(100.0, 1.0)], "tuned": [event("/axis")]}
        write_side_by_side(bag, sides, {})
        assert {time for _, time, _ in with_rosbags(bag)} == {100_000_000_000}

    def test_nothing_heard(self, tmp_path):
        assert not write_side_by_side(tmp_path / "bag", {"default": [], "tuned": []}, {})
        assert list(tmp_path.iterdir()) == []

    def test_a_folder_that_cannot_be_written(self, tmp_path):
        (tmp_path / "file").write_text("in the way")
        with pytest.raises(OutputError, match="cannot be written"):
            write_side_by_side(tmp_path / "file" / "bag", self.SIDES, {})
