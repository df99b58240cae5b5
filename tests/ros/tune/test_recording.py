"""Bags of a run on the shipped nodes, opened by two readers that know nothing of each other."""

import json
from collections import Counter, defaultdict
from itertools import pairwise

import numpy as np
import pytest
from bag_readers import READERS
from cuts import cut_in_process
from short_cuts import SHORT, small_study

from bo_tuner.recording.recovery import partial_bags, recover
from bo_tuner.recording.retention import custom_data
from bo_tuner.trials import TrialState
from milling_plant.cut import MillingPlant, reference_velocity

pytestmark = pytest.mark.ros

SAMPLES = 60
PERIOD = 20_000_000
LOOP = {
    "/x_axis/joint_states": "measurement",
    "/x_axis/mpc_controller/command": "command",
    "/x_axis/mpc_controller/estimated_state": "estimate",
}
RESULTS = ("/x_axis/milling_plant/cut_result", "/x_axis/mpc_controller/cut_result")
REFERENCE = "/x_axis/mpc_controller/joint_trajectory"


CALM = {
    "kind": "chance", "metric": "tracking_error", "upper": "1.1 * default", "probability": 0.9,
}  # fmt: skip


@pytest.fixture(scope="module", params=[{}, {"calm": CALM}], ids=["alone", "beside the default"])
def recorded(start_tune, request):
    """A run that keeps all bags; its trials and their bags.

    A run of the default beside an evaluation is in none of them.
    """
    study = small_study(2)
    study["constraints"] |= request.param
    command = start_tune(
        "--record",
        "all",
        "--ros-args",
        "-r",
        "__ns:=/x_axis",
        study=study,
        AMENT_PREFIX_PATH="",
    )
    assert command.finish() in (0, 3), command.err
    trials = command.trials()
    return trials, [command.run_folder / "bags" / f"trial_{t.number:04d}" for t in trials]


@pytest.mark.parametrize("read", READERS)
def test_every_message_of_every_evaluation_is_there(recorded, read):
    trials, bags = recorded
    for trial, bag in zip(trials, bags, strict=True):
        evaluations = json.loads(custom_data(bag)["evaluations"])
        assert custom_data(bag)["lost_messages"] == "0"
        # A measurement whose answer is late is sent again.
        times = defaultdict(set)
        counts = Counter()
        for topic, time, _ in read(bag):
            times[topic].add(time)
            counts[topic] += 1
        expected = {
            evaluation["start"] + k * PERIOD for evaluation in evaluations for k in range(SAMPLES)
        }
        for topic in LOOP:
            assert times[topic] == expected, topic
        for topic in RESULTS:
            assert counts[topic] == len(evaluations)
        assert times[REFERENCE] == {evaluation["start"] for evaluation in evaluations}
        assert counts["/parameter_events"] >= len(evaluations)
        assert "/rosout" not in counts
        of_trial = [e for e in trial.evaluations if not e.stage.startswith("check")]
        assert [e["seed"] for e in evaluations] == [e.seed for e in of_trial]


@pytest.mark.parametrize("read", READERS)
def test_values_are_those_of_the_evaluation_in_process_bit_for_bit(recorded, read):
    _, bags = recorded
    bag = bags[0]
    data = custom_data(bag)
    values = {topic: {} for topic in LOOP}
    references = {}
    for topic, time, message in read(bag):
        if topic in LOOP:
            values[topic][time] = message.velocity[0]
        if topic == REFERENCE:
            references[time] = [point.velocities[0] for point in message.points]
    for evaluation in json.loads(data["evaluations"]):
        plant = SHORT | evaluation["context"] | {"seed": evaluation["seed"]}
        kept = cut_in_process(plant, json.loads(data["parameters"])).kept
        for topic, name in LOOP.items():
            found = [values[topic][evaluation["start"] + k * PERIOD] for k in range(SAMPLES)]
            assert found == kept[name], name
        plant = MillingPlant()
        plant.set_parameters(SHORT)
        np.testing.assert_array_equal(
            references[evaluation["start"]], reference_velocity(plant.settings)
        )


@pytest.mark.parametrize("read", READERS)
def test_time_is_simulated_time_and_only_moves_on(recorded, read):
    _, bags = recorded
    for bag in bags:
        evaluations = json.loads(custom_data(bag)["evaluations"])
        assert all(a["end"] <= b["start"] for a, b in pairwise(evaluations))
        latest = 0
        for topic, time, message in read(bag):
            assert time >= latest
            latest = time
            if topic != "/parameter_events":
                stamp = message.header.stamp
                assert time == stamp.sec * 1_000_000_000 + stamp.nanosec
        assert latest == evaluations[-1]["start"] + SAMPLES * PERIOD


def test_the_metadata_tells_the_trial(recorded):
    trials, bags = recorded
    for trial, bag in zip(trials, bags, strict=True):
        data = custom_data(bag)
        assert json.loads(data["parameters"]) == dict(trial.parameters)
        assert data["state"] == trial.state
        assert data["study"] == "benchmark"
        assert data["complete"] == "true"
        for there, here in zip(json.loads(data["evaluations"]), trial.evaluations, strict=False):
            assert there["context"] == dict(here.context)
            assert there["metrics"] == dict(here.outcome.metrics)


def killed_with_a_bag_in_the_making(command):
    """Kill the tuner as soon as a bag has notes; returns the partial bags that it leaves."""
    bags = command.run_folder / "bags"
    command.wait_for_trial(0)
    command.wait_for(
        lambda: any((p / "notes.json").exists() for p in partial_bags(bags)), "a bag in the making"
    )
    assert len(command.nodes()) == 2
    command.popen.kill()
    command.popen.wait()
    command.wait_for_nodes_to_end()
    return partial_bags(bags)


@pytest.mark.slow
def test_a_killed_tuner_leaves_bags_that_can_be_recovered(tune, tmp_path):
    # The kill may come after the end of that bag, and before the first notes of the next.
    for attempt in range(10):
        folder = tmp_path / f"attempt_{attempt}"
        command = tune(study=small_study(50), folder=folder, AMENT_PREFIX_PATH="")
        partial_ones = killed_with_a_bag_in_the_making(command)
        recovered = [bag for partial in partial_ones if (bag := recover(partial))]
        assert partial_bags(command.run_folder / "bags") == []
        whole = 0
        for bag in recovered:
            data = custom_data(bag)
            assert data["complete"] == "false"
            evaluations = json.loads(data.get("evaluations", "[]"))
            for read in READERS:
                counts = Counter(topic for topic, _, _ in read(bag))
                assert counts["/joint_states"] >= SAMPLES * len(evaluations)
            whole += len(evaluations)
        if whole > 0:
            break
    assert whole > 0


@pytest.mark.slow
def test_a_failed_trial_is_kept(tune):
    """Every trial fails: what the tuner sees of it is all there is."""
    command = tune(
        study=small_study(2, plant=SHORT | {"velocity_limit": 0.0}), AMENT_PREFIX_PATH=""
    )
    assert command.finish() == 3, command.err
    assert [trial.state for trial in command.trials()] == [TrialState.FAILED] * 2
    for number in range(2):
        data = custom_data(command.run_folder / "bags" / f"trial_{number:04d}")
        assert data["kept_as"] == data["verdict"] == "failed"
        assert "reason" in data


@pytest.mark.slow
def test_an_unwritable_folder_ends_the_recording_only(tune):
    command = tune(study=small_study(3), AMENT_PREFIX_PATH="")
    command.wait_for(lambda: (command.run_folder / "bags").is_dir(), "the folder of bags")
    (command.run_folder / "bags").rename(command.run_folder / "moved")
    (command.run_folder / "bags").write_text("not a folder")
    assert command.finish() in (0, 3), command.err
    assert command.err.count("recording stopped") == 1
    assert len(command.trials()) == 3
    recording = json.loads((command.run_folder / "recording.json").read_text())
    assert "recording stopped" in recording["warnings"][0]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--record", "all", "--backend", "inprocess"), "--record needs --backend ros"),
        (("--record", "some"), "--record: invalid"),
        (("--record-limit", "-1"), "-1: expected a positive number of at most"),
        (
            ("--record-limit", "much"),
            "much: expected a positive number of at most",
        ),
    ],
)
def test_wrong_options(tune, arguments, complaint):
    assert complaint in tune(*arguments).refusal()
