"""Evaluations that were recorded in process, run again on nodes, and the bag of it."""

import json
from collections import defaultdict
from dataclasses import replace

import pytest
from bag_readers import READERS, with_rosbags
from commands import Fork, finish
from cuts import cut_in_process
from in_process import Uninterrupted, call
from made_runs import make_run
from short_cuts import small_study
from waiting import DEADLINE

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.cli import replay as command
from bo_tuner.recording.retention import custom_data
from bo_tuner.replay.replay import find_evaluation
from bo_tuner.storage.run_files import HELD_PARAMETERS
from bo_tuner.study.study_file import study_from_mapping

pytestmark = pytest.mark.ros

SAMPLES, PERIOD = 270, 20_000_000
LOOP = {
    "joint_states": "measurement",
    "mpc_controller/command": "command",
    "mpc_controller/estimated_state": "estimate",
}


CALM = {
    "kind": "chance", "metric": "tracking_error", "upper": "1.1 * default", "probability": 0.9,
}  # fmt: skip


def study_of(constraints=None, **plant):
    mapping = small_study(2, plant=plant, drawn_contexts=1, search_evaluations=1, seed=3)
    return study_from_mapping(
        mapping | {"constraints": mapping["constraints"] | (constraints or {})}
    )


@pytest.fixture(scope="module", params=[{}, {"calm": CALM}], ids=["alone", "beside the default"])
def attached(shared_pair, tmp_path_factory, request):
    """A run, and what the command says of its trial 1 on nodes that run already.

    A run of the default beside an evaluation is in no bag.
    """
    study = study_of(request.param)
    folder = tmp_path_factory.mktemp("replay") / "run"
    record = make_run(folder, study, InProcessBackend(study))
    with pytest.MonkeyPatch.context() as patch:
        lines = []
        patch.setattr(command, "say", lines.append)
        # They may still be starting, on a busy machine.
        patch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", DEADLINE)
        code = command.run(
            [str(folder), "--trial", "1", "--backend", "ros", "--attach"], Uninterrupted()
        )
    return record, code, lines


def test_nodes_with_other_parameters_than_in_the_run_are_refused(attached, capsys):
    """Of those that the study does not set."""
    record, _, _ = attached
    held = record.path / "log" / HELD_PARAMETERS
    held.parent.mkdir(exist_ok=True)
    held.write_text(json.dumps({"plant": {"noise_variance": 0.5}, "controller": {}}))
    try:
        code, _, err = call(
            command, capsys, record.path, "--trial", "1", "--backend", "ros", "--attach"
        )
    finally:
        held.unlink()
    assert code == 2
    last = err.splitlines()[-1]
    expected = "parameter noise_variance is 0.001, expected 0.5, as when the run began; set it back"
    offer = "or if the node changes it by itself: unwatched: [noise_variance] in nodes.plant"
    assert last == f"error: plant: {expected}, {offer}"


def test_the_metrics_are_equal_and_what_the_clock_measures_is_not_judged(attached):
    record, code, lines = attached
    assert code == 0
    assert lines[0] == "measured, so different in each run, and not judged: solve time (p99)"
    assert lines[1:3] == ["complete, as recorded", "confirmed"]
    data = custom_data(bag_of(record))
    recorded = find_evaluation(record, 1, None).outcome.metrics
    replayed = json.loads(data["tuned"])["metrics"]
    assert replayed.keys() == recorded.keys()
    for name in recorded.keys() - {"return_time"}:
        assert replayed[name] == recorded[name]


def bag_of(record):
    evaluation = find_evaluation(record, 1, None)
    return record.path / "replay" / f"trial_0001_evaluation_{evaluation.index:02d}"


@pytest.mark.parametrize("read", READERS)
def test_default_and_tuned_run_side_by_side(attached, read):
    record, _, lines = attached
    bag = bag_of(record)
    assert lines[-1] == f"bag of default and tuned: {bag}"
    recorded = find_evaluation(record, 1, None)
    values = defaultdict(dict)
    times = defaultdict(list)
    for topic, time, message in read(bag):
        times[topic].append(time)
        if topic.endswith(tuple(LOOP)):
            stamp = message.header.stamp
            assert time == stamp.sec * 1_000_000_000 + stamp.nanosec
            values[topic][time] = message.velocity[0]
    sides = {
        "default": record.study.search_space().defaults,
        "tuned": recorded.parameters,
    }
    (start,) = {times[f"/{side}/mpc_controller/joint_trajectory"][0] for side in sides}
    for side, parameters in sides.items():
        kept = cut_in_process(dict(recorded.context) | {"seed": recorded.seed}, parameters).kept
        for topic, name in LOOP.items():
            found = values[f"/{side}/{topic}"]
            assert [found[start + k * PERIOD] for k in range(SAMPLES)] == kept[name]
            assert len(found) == SAMPLES
        for node in ("milling_plant", "mpc_controller"):
            assert len(times[f"/{side}/{node}/cut_result"]) == 1
    assert {topic.split("/")[1] for topic in times} == set(sides)


def test_the_metadata_tell_both(attached):
    record, _, _ = attached
    data = custom_data(bag_of(record))
    recorded = find_evaluation(record, 1, None)
    assert json.loads(data["context"]) == dict(recorded.context)
    assert (data["trial"], data["seed"]) == ("1", str(recorded.seed))
    assert data["lost_messages"] == "0"
    default, tuned = json.loads(data["default"]), json.loads(data["tuned"])
    assert tuned["parameters"] == dict(recorded.parameters)
    assert default["parameters"] == dict(record.study.search_space().defaults)
    assert default["metrics"]["tracking_error"] != tuned["metrics"]["tracking_error"]


def test_a_failed_evaluation_on_nodes_of_its_own(ros_environment, tmp_path):
    """The command as a process, as a user starts it: nodes, the same failure, and a bag."""
    study = study_of(velocity_limit=0.6)
    folder = tmp_path / "run"
    record = make_run(folder, study, InProcessBackend(study))
    evaluation = record.trials[0].evaluations[-1]
    assert "the loop diverged" in evaluation.outcome.reason
    process = Fork(
        *("replay", folder, "--trial", "0", "--backend", "ros", "--output", "bags"),
        folder=tmp_path,
        env={"COLUMNS": "120"},
        without=("ROS_DOMAIN_ID",),
    )
    code, out, err = finish(process)
    assert code == 0, err
    assert f"failed, as recorded: {evaluation.outcome.reason}" in out
    bag = tmp_path / "bags" / f"trial_0000_evaluation_{evaluation.index:02d}"
    data = custom_data(bag)
    assert json.loads(data["tuned"])["reason"] == evaluation.outcome.reason
    samples = sum(topic == "/tuned/joint_states" for topic, _, _ in with_rosbags(bag))
    assert 0 < samples < SAMPLES
    assert not (folder / "replay").exists()


def test_a_node_that_is_not_there(ros_environment, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", 1.0)
    study = study_of()
    nodes = {key: replace(spec, node=f"no_{spec.node}") for key, spec in study.nodes.items()}
    study = replace(study, nodes=nodes)
    folder = tmp_path / "run"
    make_run(folder, study, InProcessBackend(study))
    code, _, err = call(command, capsys, folder, "--trial", "0", "--backend", "ros", "--attach")
    assert code == 2
    (line,) = err.splitlines()[1:]
    assert line.startswith("error: no_milling_plant")
