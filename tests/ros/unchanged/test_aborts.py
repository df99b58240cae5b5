"""A run that is aborted leaves a bag of what the signals said in the 5 s before."""

import json

import pytest
from bag_readers import READERS
from commands import Fork, finish
from example_nodes import UNCHANGED, start_script
from servo import ROOM, UNSTABLE, failure, run

from bo_tuner.metrics.latest_messages import KEPT, MEMORY, LatestMessage, LatestMessages
from bo_tuner.recording.abort_bags import AbortBags
from bo_tuner.recording.retention import custom_data
from bo_tuner.study import strict_yaml
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

BOTH_WAYS = {"abort_when": "abs(angle) > 3", "end": {"when": "t > 1"}, "timeout": 60.0}


def test_only_the_latest_messages_are_kept():
    latest = LatestMessages()
    times = range(0, 8_000_000_001, 1_000_000_000)
    for time in times:
        latest.add(LatestMessage(time, "/a", "std_msgs/msg/Float64", b"data"))
    assert [m.received for m in latest.now()] == [t for t in times if t >= times[-1] - KEPT]
    large = LatestMessage(times[-1], "/b", "std_msgs/msg/Float64", bytes(MEMORY // 2))
    for _ in range(3):
        latest.add(large)
    assert list(latest.now()) == [large, large]


def test_the_signals_until_a_run_was_aborted(backend, system, tmp_path):
    made = backend(run=BOTH_WAYS)
    told = []
    made.at_abort = AbortBags(tmp_path, made._study, told.append)
    assert run(made, 0.5).state is EvaluationState.COMPLETE
    assert not (tmp_path / "aborts").exists()
    reason = failure(run(made, UNSTABLE))
    assert reason.startswith("aborted at ")
    bag = tmp_path / "aborts" / "0001"
    assert [path.name for path in bag.parent.iterdir()] == ["0001"]
    notes = custom_data(bag)
    assert notes["reason"].startswith("aborted at ")
    assert reason.startswith(notes["reason"])
    assert json.loads(notes["parameters"]) == {"gain": UNSTABLE}
    for read in READERS:
        messages = read(bag)
        angles = [
            (time, message.position[1])
            for topic, time, message in messages
            if topic == "/joint_states"
        ]
        assert {topic for topic, _, _ in messages} == {"/setpoint", "/joint_states"}
        assert angles[-1][0] - angles[0][0] <= KEPT
        # At 100 Hz, from before the run on until the angle was beyond 3.
        assert len(angles) > 5
        assert [abs(angle) > 3.0 for _, angle in angles[-5:]].count(True) >= 1
        assert abs(angles[0][1]) <= 3.0
    assert not told


def test_a_bag_that_cannot_be_written_does_not_end_the_run(backend, system, tmp_path):
    made = backend(run=ROOM)
    told = []
    (tmp_path / "aborts").write_text("in the way")
    made.at_abort = AbortBags(tmp_path, made._study, told.append)
    failure(run(made, UNSTABLE))
    (line,) = told
    assert line.startswith(f"warning: no bag of the aborted run: {tmp_path / 'aborts'}: ")


def test_tune_writes_one_whatever_else_is_recorded(empty_domain, tmp_path):
    study = strict_yaml.parse((UNCHANGED / "study.yaml").read_text()).value
    study["run"]["abort_when"] = "t > 0.2 and abs(angle) < 100"
    (tmp_path / "study.yaml").write_text(strict_yaml.dump(study))
    started = [
        start_script(UNCHANGED / f"{node}_node.py", tmp_path / f"{node}.txt")
        for node in ("motor", "pid")
    ]
    try:
        tune = Fork(
            *("tune", "--study", "study.yaml", "--attach", "--quiet", "--record", "none"),
            *("--trials", "2"),
            folder=tmp_path,
        )
        code, _, err = finish(tune)
    finally:
        for process in started:
            process.kill()
            process.wait()
    assert code == 3, err
    (folder,) = (path for path in (tmp_path / "runs").iterdir() if not path.is_symlink())
    bags = sorted((folder / "aborts").iterdir())
    assert [custom_data(bag)["trial"] for bag in bags] == ["0", "1"]
    assert not (folder / "bags").exists()
