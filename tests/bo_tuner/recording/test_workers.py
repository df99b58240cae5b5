"""Bags of what several workers run at the same time, without ROS."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from bag_readers import with_rosbags
from recorded_trials import START, STUDY, evaluation_of, joints, trial_of

from bo_tuner.backends.protocol import SequentialBackend
from bo_tuner.backends.workers.answer import Answer
from bo_tuner.metrics.recording import NOTHING_RECORDED, Recording
from bo_tuner.plans import Phase
from bo_tuner.recording import recorder as recorder_module
from bo_tuner.recording import workers
from bo_tuner.recording.bag import TrialBag
from bo_tuner.recording.inbox import Batch
from bo_tuner.recording.retention import Policy, RecordOptions, custom_data
from bo_tuner.recording.run_recording import RunRecording
from bo_tuner.recording.workers import HeardByWorkers, HeardRun, ListeningBackend
from bo_tuner.study.metrics import RelativeMetric
from bo_tuner.trials import EvaluationState, Outcome, Stage

SIGNALS = Recording({}, 2.5)


@pytest.fixture(autouse=True)
def no_wait(monkeypatch):
    for module in (recorder_module, workers):
        monkeypatch.setattr(module, "QUIET", 0.0)


class Nodes(SequentialBackend):
    """Nodes that say two things in each run: how many there were so far, and the seed."""

    name = "ros"

    def __init__(self, study, waiting):
        super().__init__(study)
        self.recording = NOTHING_RECORDED
        self.calls = []
        self._waiting = waiting
        self._runs = 0

    def open(self):
        self.calls.append("open")

    def close(self):
        self.calls.append("close")

    def park(self):
        return ["parked"]

    def outcome(self, planned):
        self._waiting += [joints(START + 1000 * self._runs), joints(START + planned.seed)]
        self._runs += 1
        self.recording = SIGNALS
        return Outcome(EvaluationState.COMPLETE, dict.fromkeys(STUDY.metrics, 0.1))


def listening(study, waiting):
    """A listening backend, its nodes, and a listener that has what waits."""
    nodes = Nodes(study, waiting)

    def listen(backend, sink):
        assert backend is nodes
        assert nodes.calls == ["open"]

        def take():
            while waiting:
                sink.take(*waiting.pop(0))

        def refresh():
            nodes.calls.append("refresh")
            sink.warn("/odd is not recorded")

        return SimpleNamespace(take=take, refresh=refresh, close=lambda: nodes.calls.append("deaf"))

    return ListeningBackend(listen, nodes), nodes


def data(*offsets):
    return [joints(START + offset) for offset in offsets]


class TestWorker:
    def test_each_evaluation_has_what_was_said_in_it(self):
        waiting = []
        backend, nodes = listening(STUDY, waiting)
        assert backend.name == "ros"
        assert backend.park() == ["parked"]
        backend.open()
        waiting += data(77)
        heard = []
        for _ in backend.run([evaluation_of(0, index, seed=index + 5) for index in range(2)]):
            heard.append(backend.heard)
            waiting += data(88)
        assert [item.batch.messages for item in heard] == [data(0, 5), data(1000, 6)]
        assert [item.signals for item in heard] == [SIGNALS, SIGNALS]
        # Nodes that were started anew are heard after the first.
        assert [item.warnings for item in heard] == [(), ("/odd is not recorded",)]
        backend.close()
        assert nodes.calls == ["open", "refresh", "refresh", "deaf", "close"]

    def test_what_the_default_says_beside_one_is_left_out(self):
        gain = RelativeMetric(name="gain", relative="tracking_error")
        study = replace(STUDY, metrics={**STUDY.metrics, "gain": gain})
        backend, _ = listening(study, [])
        backend.open()
        other = {**evaluation_of(0).parameters, "prediction_horizon": 35}
        list(backend.run([evaluation_of(0, seed=5, parameters=other)]))
        assert backend.heard.batch.messages == data(1000, 5)


class Workers:
    """What workers say, in place of a pool."""

    def __init__(self):
        self.answer = None

    def take(self):
        answer, self.answer = self.answer, None
        return answer


@pytest.fixture
def fleet(tmp_path):
    """A recording of two workers, and a function that has one of them run an evaluation."""
    pool = Workers()
    heard = HeardByWorkers(pool.take)
    told = []

    def make(policy=Policy.ALL, **options):
        recording = RunRecording(
            tmp_path, STUDY, RecordOptions(policy, **options), heard.to, told.append,
            lambda: heard.signals, lambda: heard.worker, at_once=2,
        )  # fmt: skip

        def run(worker, evaluation, *messages, lost=0, warnings=()):
            batch = Batch(list(messages), sum(len(raw) for _, raw in messages), lost=lost)
            said = HeardRun(batch, SIGNALS, warnings)
            pool.answer = Answer(worker, evaluation, heard=said)
            recording.evaluation(evaluation)

        return recording, run

    make.told = told
    make.pool = pool
    return make


def bags(folder):
    return {path.name: path for path in (folder / "bags").iterdir() if path.is_dir()}


def indexes(bag):
    return [item["index"] for item in json.loads(custom_data(bag)["evaluations"])]


class TestRun:
    def test_trials_at_the_same_time_have_bags_of_their_own(self, fleet, tmp_path):
        recording, run = fleet()
        with recording:
            run("1", evaluation_of(0, 0), *data(1, 2))
            run("2", evaluation_of(1, 0), *data(1, 3), lost=4)
            # It goes on wherever there is room.
            run("2", evaluation_of(0, 1), *data(5))
            recording.trial(trial_of(0, evaluations=2), None)
            run("1", evaluation_of(1, 1), *data(6))
            recording.trial(trial_of(1, evaluations=2), None)
        found = bags(tmp_path)
        assert sorted(found) == ["trial_0000", "trial_0001"]
        said = {
            name: [time - START for _, time, _ in with_rosbags(bag)] for name, bag in found.items()
        }
        assert said == {"trial_0000": [1, 2, 5], "trial_0001": [1, 3, 6]}
        assert [custom_data(bag)["lost_messages"] for bag in map(found.get, sorted(found))] == [
            "0", "4",
        ]  # fmt: skip
        assert recording.summary["lost_messages"] == 4

    def test_those_of_the_validation_are_apart_by_worker(self, fleet, tmp_path):
        """In one bag nobody could tell what is of which run: they are at the same time."""
        recording, run = fleet()
        with recording:
            recording.begin(Phase.VALIDATION, 4)
            for worker, index in (("1", 0), ("2", 2), ("2", 1), ("1", 3)):
                evaluation = evaluation_of(0, index, stage=Stage.VALIDATION)
                run(worker, evaluation, *data(10 * index, 10 * index + 1))
            recording.end(Phase.VALIDATION)
        found = bags(tmp_path)
        assert {name: indexes(bag) for name, bag in found.items()} == {
            "validation": [0, 3],
            "validation_part2": [2, 1],
        }
        for bag, offsets in (
            ("validation", [0, 1, 30, 31]),
            ("validation_part2", [10, 11, 20, 21]),
        ):
            assert [time - START for _, time, _ in with_rosbags(found[bag])] == offsets
            assert custom_data(found[bag])["complete"] == "true"

    def test_one_limit_holds_for_all_workers(self, fleet, tmp_path):
        def runs(limit):
            recording, run = fleet(limit=limit)
            with recording:
                for number in range(4):
                    run(str(number % 2), evaluation_of(number), *data(*range(200)))
                for number in range(4):
                    recording.trial(trial_of(number), None)
            return recording.summary["bags"]

        assert len(runs(10**9)) == 4
        size = sum(path.stat().st_size for path in (tmp_path / "bags" / "trial_0003").iterdir())
        for bag in bags(tmp_path).values():
            for path in bag.iterdir():
                path.unlink()
        (tmp_path / "bags" / "made.txt").unlink()
        assert runs(int(2.5 * size)) == ["trial_0002_part2", "trial_0003_part2"]
        assert "starting with trial_0000_part2" in fleet.told[-1]

    def test_a_full_disk_ends_the_recording_and_not_the_run(self, fleet, tmp_path, monkeypatch):
        recording, run = fleet()
        with recording:
            run("1", evaluation_of(0), *data(1))
            run("2", evaluation_of(1), *data(1))
            recording.trial(trial_of(0), None)
            run("1", evaluation_of(2), *data(1))
            recording._recorder._writer.submit(lambda: None).result()

            def full(*_):
                raise OSError(28, "No space left on device")

            monkeypatch.setattr(TrialBag, "write", full)
            run("2", evaluation_of(2, 1), *data(2))
            recording.trial(trial_of(1), None)
        (line,) = fleet.told
        assert line == (
            f"recording stopped: {tmp_path / 'bags'}: No space left on device; the run goes on"
        )
        # What was begun makes room for the journal.
        assert [*bags(tmp_path)] == ["trial_0000"]

    def test_all_workers_say_the_same_once(self, fleet):
        recording, run = fleet()
        with recording:
            for worker in "12":
                run(worker, evaluation_of(int(worker)), warnings=["/odd is not recorded"])
                recording.trial(trial_of(int(worker)), None)
        assert fleet.told == ["/odd is not recorded"]
        assert recording.summary["warnings"] == fleet.told

    def test_one_that_was_lost_with_its_worker_has_nothing(self, fleet, tmp_path):
        recording, run = fleet()
        with recording:
            run("1", evaluation_of(0, 0), *data(1))
            lost = Outcome(EvaluationState.LOST, {}, "died")
            recording.evaluation(evaluation_of(0, 1, outcome=lost))
            recording.trial(trial_of(0), None)
        bag = tmp_path / "bags" / "trial_0000"
        assert [time - START for _, time, _ in with_rosbags(bag)] == [1]
        first, second = json.loads(custom_data(bag)["evaluations"])
        assert (first["state"], second["state"]) == ("complete", "lost")
        assert second["start"] is None
