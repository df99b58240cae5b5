"""Bags without ROS: what is in them, and which are kept."""

import json
import os
import shutil
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest
from bag_readers import READERS, with_mcap, with_rosbags
from recorded_trials import (
    CONTEXT,
    JOINTS,
    PARAMETERS,
    START,
    STUDY,
    evaluation_of,
    event,
    joints,
    record,
    scalar,
    trial_of,
)

from bo_tuner.plans import Phase
from bo_tuner.recording import recorder as recorder_module
from bo_tuner.recording.bag import NANOSECONDS, TrialBag, make_topic, stamp, timed
from bo_tuner.recording.recorder import Recorder
from bo_tuner.recording.retention import MADE, Policy, RecordOptions, custom_data
from bo_tuner.recording.run_recording import RunRecording
from bo_tuner.recording.topic_listener import TopicListener
from bo_tuner.study.limits import outcome_in_words
from bo_tuner.trials import (
    EvaluationState,
    Outcome,
    Stage,
    TrialState,
)


class TestTime:
    def test_is_that_of_the_header(self):
        assert stamp(joints(START + 17)) == START + 17

    @pytest.mark.parametrize("message", [scalar(1.0), event(), joints(0), (JOINTS, b"\0\1\0\0")])
    def test_none_without_a_header_that_is_set(self, message):
        assert stamp(message) is None

    def test_a_message_without_a_stamp_stays_behind_the_one_before_it(self):
        messages = [scalar(0.0), joints(START), scalar(1.0), joints(START + 9), scalar(2.0)]
        times = [time for time, _ in timed(messages)]
        assert times == [START, START, START, START + 9, START + 9]
        assert [message for _, message in timed(messages)] == messages
        assert timed([event()], START)[0][0] == START

    def test_messages_are_put_in_order(self):
        messages = [joints(START + 2), joints(START + 1)]
        assert [time for time, _ in timed(messages)] == [START + 1, START + 2]


class TestBag:
    @pytest.mark.parametrize("read", READERS)
    def test_two_independent_readers_get_what_was_written(self, recorder, tmp_path, read):
        trial = trial_of(7, evaluations=3)
        it = recorder()
        record(it, trial, best=True)
        it.close()
        found = read(tmp_path / "trial_0007")
        assert [topic for topic, _, _ in found].count("/parameter_events") == 3
        states = [(time, message) for topic, time, message in found if topic == "/joint_states"]
        assert len(states) == 150
        assert [m.velocity[0] for _, m in states] == [0.1 * k for k in range(50)] * 3
        for time, message in states:
            assert message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec == time
        times = [time for _, time, _ in found]
        assert times == sorted(times)

    def test_metadata(self, recorder, tmp_path):
        it = recorder()
        record(it, trial_of(7, evaluations=2), best=True)
        it.close()
        text = (tmp_path / "trial_0007" / "metadata.yaml").read_text()
        assert "version: 9\n" in text
        assert "storage_identifier: mcap\n" in text
        data = custom_data(tmp_path / "trial_0007")
        assert json.loads(data["parameters"]) == PARAMETERS
        evaluations = json.loads(data["evaluations"])
        assert [evaluation["seed"] for evaluation in evaluations] == [7, 8]
        assert [evaluation["context"] for evaluation in evaluations] == [CONTEXT] * 2
        assert [evaluation["start"] for evaluation in evaluations] == [
            START + (700 + k) * 10**10 for k in range(2)
        ]
        assert evaluations[0]["end"] == evaluations[1]["start"] - 10**10 + 49 * 20_000_000
        expected = {
            "study": "benchmark",
            "trial": "7",
            "state": "complete",
            "verdict": "within limits",
            "kept_as": "best so far",
            "complete": "true",
            "dropped_messages": "0",
            "lost_messages": "0",
        }
        assert {key: data[key] for key in expected} == expected

    def test_what_was_missed_is_told(self, recorder, tmp_path):
        it = recorder(Policy.ALL, memory=len(joints(START)[1]) * 20)
        it.lose(3)
        # Nothing is written before the first evaluation ends.
        record(it, replace(trial_of(0)), samples=50)
        summary = it.close()
        data = custom_data(tmp_path / "trial_0000")
        kept = len(with_rosbags(tmp_path / "trial_0000"))
        assert int(data["dropped_messages"]) == summary["dropped_messages"] == 51 - kept > 0
        assert data["lost_messages"] == "3"
        assert summary["lost_messages"] == 3

    def test_what_no_bag_takes_leaves_the_memory(self, recorder, tmp_path):
        """As what comes while candidates are ranked that need no further evaluation."""
        it = recorder(Policy.ALL, memory=len(joints(START)[1]) * 20)
        for index in range(15):
            it.take(*joints(START + index))
        it.phase_ended()
        it._writer.submit(lambda: None).result()
        record(it, trial_of(0), samples=15)
        it.close()
        assert custom_data(tmp_path / "trial_0000")["dropped_messages"] == "0"

    def test_a_trial_that_goes_on_keeps_what_it_had(self, recorder, tmp_path):
        for samples in (10, 20):
            it = recorder(Policy.ALL)
            record(it, trial_of(3), samples=samples)
            bags = it.close()["bags"]
        assert bags == ["trial_0003", "trial_0003_part2"]
        assert [len(with_rosbags(tmp_path / name)) for name in bags] == [11, 21]

    def test_checks_and_validation_have_bags_of_their_own(self, recorder, tmp_path):
        it = recorder(Policy.NOTABLE)
        record(it, trial_of(3), best=True)
        stages = [(Stage.CHECK_DRAWN, 3), (Stage.CHECK_WORST, 3), (Stage.CHECK_DRAWN, 1)]
        for index, (stage, number) in enumerate(stages):
            it.take(*joints(START + 10**12 + index * 10**9))
            it.evaluation(evaluation_of(number, index, stage=stage))
        it.phase_ended()
        for index, parameters in enumerate((PARAMETERS, PARAMETERS | {"lambda_mpc": 0.5})):
            it.take(*joints(START + 10**13 + index * 10**9))
            it.evaluation(evaluation_of(index, 0, stage=Stage.VALIDATION, parameters=parameters))
        it.phase_ended()
        names = ["trial_0003", "check_0003", "check_0001", "validation"]
        assert it.close()["bags"] == names
        assert [len(with_mcap(tmp_path / name)) for name in names[1:]] == [2, 1, 2]
        data = [custom_data(tmp_path / name) for name in names]
        assert all(each["complete"] == "true" for each in data)
        assert [evaluation["stage"] for evaluation in json.loads(data[1]["evaluations"])] == [
            s for s, _ in stages[:2]
        ]
        judged = [e["parameters"]["lambda_mpc"] for e in json.loads(data[3]["evaluations"])]
        assert judged == [PARAMETERS["lambda_mpc"], 0.5]

    def test_types_of_other_packages_are_not_known(self):
        with pytest.raises(KeyError):
            make_topic("/spindle", "spindle_msgs/msg/Load")

    def test_hidden_topics_of_such_types_are_left_out_in_silence(self):
        """Those of an action, of which only its own name is known to whoever looks at a run."""
        said = []
        listener = SimpleNamespace(_sink=SimpleNamespace(warn=said.append))
        for name in ("/load", "/turn/_action/feedback"):
            TopicListener._subscribe(listener, name, "spindle_msgs/msg/Load")
        assert said == ["/load is not recorded: its type spindle_msgs/msg/Load is not known here"]


class TestVerdict:
    def test_follows_the_constraints(self):
        assert outcome_in_words(STUDY, trial_of(0)) == "within limits"
        assert outcome_in_words(STUDY, trial_of(0, worst=0.5)) == "violates overshoot"
        stalled = evaluation_of(0, outcome=Outcome(EvaluationState.FAILED, {}, "stalled"))
        failed = replace(trial_of(0, state=TrialState.FAILED), evaluations=(stalled,))
        assert outcome_in_words(STUDY, failed) == "failed"
        metrics = {"tracking_error": 0.1, "overshoot": 0.01, "return_time": 1.0}
        slow = evaluation_of(0, outcome=Outcome(EvaluationState.COMPLETE, metrics))
        trial = replace(trial_of(0), evaluations=(slow,))
        assert outcome_in_words(STUDY, trial) == "violates real_time"


class TestRetention:
    def run(self, it):
        """Run trials of which 0 and 3 are best when they end, 2 and then 4 the worst, 5 fails."""
        for number, worst in enumerate([0.05, 0.04, 0.06, 0.03, 0.08]):
            record(it, trial_of(number, worst), best=number in (0, 3))
        record(it, trial_of(5, state=TrialState.FAILED))
        return it.close()["bags"]

    def test_notable(self, recorder, tmp_path):
        names = ["trial_0000", "trial_0003", "trial_0004", "trial_0005"]
        assert self.run(recorder()) == names
        assert sorted(path.name for path in tmp_path.glob("*/")) == names
        kept_as = [custom_data(tmp_path / name)["kept_as"] for name in names]
        assert kept_as == ["best so far", "best so far", "worst", "failed"]

    def test_all(self, recorder, tmp_path):
        assert len(self.run(recorder(Policy.ALL))) == 6
        assert len(list(tmp_path.glob("*/"))) == 6

    def test_a_later_session_knows_the_worst_of_an_earlier_one(self, recorder):
        self.run(recorder())
        it = recorder()
        record(it, trial_of(6, 0.07))
        record(it, trial_of(7, 0.09))
        assert it.close()["bags"] == ["trial_0000", "trial_0003", "trial_0005", "trial_0007"]

    def test_the_best_of_an_earlier_session_is_the_last_one_whatever_its_time(
        self, recorder, tmp_path
    ):
        """A clock may have been set, and a copy of the folder has the times of the copy."""
        self.run(recorder())
        for age, name in enumerate(("trial_0003", "trial_0000")):
            os.utime(tmp_path / name, (10**9 + age, 10**9 + age))
        size = sum(path.stat().st_size for path in (tmp_path / "trial_0000").iterdir())
        it = recorder(limit=int(2.5 * size))
        record(it, trial_of(6, 0.09))
        assert "trial_0003" in it.close()["bags"]

    def test_limit_of_size(self, recorder, tmp_path):
        record(probe := recorder(Policy.ALL), trial_of(0), best=True)
        probe.close()
        size = sum(path.stat().st_size for path in (tmp_path / "trial_0000").iterdir())
        it = recorder(Policy.ALL, limit=int(3.5 * size))
        for number in range(6):
            record(it, trial_of(number), best=number == 1)
        summary = it.close()
        assert summary["bags"] == ["trial_0001", "trial_0004", "trial_0005"]
        (line,) = summary["warnings"]
        assert "limit" in line
        assert "trial_0000" in line

    @pytest.mark.parametrize("policy", [Policy.ALL, Policy.NOTABLE])
    def test_a_bag_that_has_no_room_beside_the_best_takes_no_other_with_it(
        self, recorder, tmp_path, policy
    ):
        """Not even the one of the worst trial so far, which it would have replaced."""
        it = recorder(policy, limit=1_000_000)
        record(it, trial_of(0, 0.03), best=True)
        record(it, trial_of(1, 0.05))
        record(it, trial_of(2, 0.06), samples=20_000)
        record(it, trial_of(3, 0.05) if policy is Policy.ALL else trial_of(3, 0.055))
        summary = it.close()
        left = [0, 1, 3] if policy is Policy.ALL else [0, 3]
        assert summary["bags"] == [f"trial_{number:04d}" for number in left]
        assert sorted(path.name for path in tmp_path.glob("*/")) == summary["bags"]
        (line,) = summary["warnings"]
        assert "trial_0002" in line
        assert "oldest" not in line

    def test_a_large_bag_of_the_best_takes_the_place_of_others(self, recorder):
        it = recorder(Policy.ALL, limit=1_000_000)
        record(it, trial_of(0), best=True)
        record(it, trial_of(1), best=True, samples=20_000)
        assert it.close()["bags"] == ["trial_0001"]

    def test_bags_of_others_stay(self, recorder, tmp_path):
        """Those that the run has not made, and what a forged list leads to."""
        record(probe := recorder(Policy.ALL), trial_of(0))
        probe.close()
        for name in ("my_own", "trial_9999"):
            shutil.copytree(tmp_path / "trial_0000", tmp_path / name)
        outside = tmp_path.with_name(f"{tmp_path.name}-outside")
        shutil.copytree(tmp_path / "trial_0000", outside)
        (tmp_path / "trial_0008").symlink_to(outside)
        with (tmp_path / MADE).open("a") as made:
            made.write(f"../{outside.name}\n{outside}\nmy_own\ntrial_0008\n.\n\n")
        it = recorder(Policy.ALL, limit=1)
        record(it, trial_of(1))
        it.close()
        assert sorted(p.name for p in tmp_path.glob("*/")) == ["my_own", "trial_0008", "trial_9999"]
        assert (outside / "metadata.yaml").is_file()

    def test_none_records_nothing(self, tmp_path):
        def listen(recorder):
            raise AssertionError

        with RunRecording(tmp_path, STUDY, RecordOptions(Policy.NONE), listen, print) as recording:
            recording.evaluation(evaluation_of(0))
            recording.trial(trial_of(0), None)
        assert recording.summary == {"policy": "none"}
        assert list(tmp_path.iterdir()) == []

    @pytest.fixture
    def of_few_messages(self, tmp_path, monkeypatch):
        """A recording with memory for 20 messages, and the list of those that wait to be heard."""
        monkeypatch.setattr(recorder_module, "QUIET", 0.0)
        size = len(joints(START)[1])
        monkeypatch.setattr(recorder_module.Recorder.__init__, "__defaults__", (20 * size,))
        waiting = []

        def listen(recorder):
            def take():
                while waiting:
                    recorder.take(*waiting.pop(0))

            return SimpleNamespace(take=take, refresh=lambda: False, close=take)

        return RunRecording(
            tmp_path, STUDY, RecordOptions(Policy.ALL), listen, pytest.fail
        ), waiting

    def test_what_comes_while_a_trial_is_proposed_belongs_to_none(self, of_few_messages, tmp_path):
        """As in a pause."""
        recording, waiting = of_few_messages
        with recording:
            waiting += [joints(START)]
            recording.planned(Phase.TUNING)
            for number in range(2):
                waiting += [joints(START + 2000 * number + k) for k in range(1, 10)]
                recording.evaluation(evaluation_of(number, 0))
                recording.trial(trial_of(number), None)
                waiting += [joints(START + 2000 * number + 1000 + k) for k in range(100)]
                recording.planned(Phase.TUNING)
        times = [
            [time - START for _, time, _ in with_rosbags(tmp_path / "bags" / f"trial_000{number}")]
            for number in range(2)
        ]
        assert times == [[*range(1, 10)], [*range(2001, 2010)]]
        assert recording.summary["dropped_messages"] == 0

    def test_the_last_messages_of_a_trial_come_after_it_has_ended(self, of_few_messages, tmp_path):
        """They are asked for: a listener hands over less often than the recorder waits."""
        recording, waiting = of_few_messages
        with recording:
            waiting += [joints(START + 1)]
            recording.evaluation(evaluation_of(0, 0))
            waiting += [joints(START + 2)]
            recording.trial(trial_of(0), None)
            recording.planned(Phase.TUNING)
        bag = with_rosbags(tmp_path / "bags" / "trial_0000")
        assert [time - START for _, time, _ in bag] == [1, 2]

    def test_the_last_messages_of_an_evaluation_are_kept_where_no_trial_is_proposed(
        self, of_few_messages, tmp_path
    ):
        """In the validation one evaluation follows the other at once, while they still come."""
        recording, waiting = of_few_messages
        with recording:
            recording.begin(Phase.VALIDATION, 2)
            for index in range(2):
                recording.planned(Phase.VALIDATION)
                waiting += [joints(START + 2000 * index + k) for k in range(1, 10)]
                recording.evaluation(replace(evaluation_of(0, index), stage=Stage.VALIDATION))
                waiting += [joints(START + 2000 * index + 10)]
            recording.end(Phase.VALIDATION)
        (bag,) = (path for path in (tmp_path / "bags").iterdir() if path.is_dir())
        times = [time - START for _, time, _ in with_rosbags(bag)]
        assert times == [*range(1, 11), *range(2001, 2011)]

    def test_what_comes_in_a_pause_belongs_to_no_evaluation(self, of_few_messages, tmp_path):
        """It would fill the memory, so that the messages of the next evaluation were dropped."""
        recording, waiting = of_few_messages
        with recording:
            waiting += [joints(START + k) for k in range(10)]
            recording.evaluation(evaluation_of(0, 0))
            recording.pause(True)
            waiting += [joints(START + 1000 + k) for k in range(100)]
            recording.pause(False)
            waiting += [joints(START + 2000 + k) for k in range(10)]
            recording.evaluation(evaluation_of(0, 1))
            recording.trial(trial_of(0), None)
        times = [time - START for _, time, _ in with_rosbags(tmp_path / "bags" / "trial_0000")]
        assert times == [*range(10), *range(2000, 2010)]
        assert recording.summary["dropped_messages"] == 0


class TestTrouble:
    def test_a_full_disk_ends_the_recording_only(self, recorder, tmp_path, monkeypatch):
        it = recorder(Policy.ALL)
        record(it, trial_of(0))

        def full(*arguments):
            raise OSError(28, "No space left on device")

        it._writer.submit(lambda: None).result()
        monkeypatch.setattr(TrialBag, "write", full)
        record(it, trial_of(1))
        record(it, trial_of(2))
        summary = it.close()
        (line,) = summary["warnings"]
        assert "No space left on device; the run goes on" in line
        assert summary["bags"] == ["trial_0000"]
        # What was begun makes room for the journal.
        assert [path.name for path in tmp_path.glob("*/")] == ["trial_0000"]

    def test_a_folder_that_cannot_be_made(self, tmp_path):
        (tmp_path / "bags").write_text("a file")
        it = Recorder(tmp_path / "bags", STUDY, RecordOptions())
        record(it, trial_of(0))
        (line,) = it.close()["warnings"]
        assert "File exists" in line

    def test_a_slow_disk_delays_no_message(self, recorder, monkeypatch):
        """With the writer stuck, messages and evaluations are still taken, up to the memory."""
        stuck = threading.Event()
        original = TrialBag.write

        def write(bag, *arguments):
            stuck.wait()
            original(bag, *arguments)

        monkeypatch.setattr(TrialBag, "write", write)
        it = recorder(Policy.ALL, memory=20_000)
        for number in range(20):
            record(it, trial_of(number))
        stuck.set()
        summary = it.close()
        assert summary["dropped_messages"] > 0
        assert summary["bags"][0] == "trial_0000"

    def test_news_is_told_once_and_logged(self, tmp_path):
        (tmp_path / "log").mkdir()
        (tmp_path / "bags").write_text("a file")
        told = []

        class Listener:
            def refresh(self):
                return False

            def take(self):
                pass

            def close(self):
                pass

        def listen(recorder):
            return Listener()

        with RunRecording(tmp_path, STUDY, RecordOptions(), listen, told.append) as recording:
            recording.evaluation(evaluation_of(0))
            recording.trial(trial_of(0), None)
        assert len(told) == 1
        assert (tmp_path / "log" / "recording.log").read_text() == f"{told[0]}\n"
        assert recording.summary["warnings"] == told
