"""The shipped study on the shipped nodes: record, result, repetition and recovery."""

import csv
import json
import os
import signal

import pytest
from short_cuts import SHORT, small_study
from tuner import environment_of_nodes

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.method_names import DEFAULT_METHOD
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import TrialState
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

pytestmark = pytest.mark.ros

NAMESPACE = "/x_axis"
NODES = ("milling_plant", "mpc_controller")
TUNED_OR_SET = {
    "milling_plant": ["stiffness_factor", "damping_factor", "seed"],
    "mpc_controller": ["control_horizon", "prediction_horizon", "lambda_mpc", "lambda_kf"],
}


@pytest.fixture(scope="module")
def finished(start_tune):
    """A whole run in a namespace, on nodes from where pip has put them."""
    command = start_tune(
        "--ros-args", "-r", f"__ns:={NAMESPACE}", study=small_study(3), AMENT_PREFIX_PATH=""
    )
    code = command.finish()
    assert code in (0, 3), command.err
    return command, code


class TestRun:
    def test_the_exit_code_tells_whether_the_result_is_feasible(self, finished):
        command, code = finished
        summary = json.loads((command.run_folder / "summary.json").read_text())
        assert summary["feasible"] is (code == 0)

    def test_the_record_is_whole(self, finished):
        command, _ = finished
        trials = command.trials()
        assert [trial.state for trial in trials] == [TrialState.COMPLETE] * 3
        with (command.run_folder / "evaluations.csv").open(newline="") as file:
            evaluations = list(csv.DictReader(file))
        in_trials = sum(len(trial.evaluations) for trial in trials)
        validated = [row for row in evaluations if row["stage"] == "validation"]
        assert len(validated) == 4
        assert len(evaluations) >= in_trials + 4
        for row in evaluations:
            # The nodes ran what the tuner asked for, and say so.
            for name in ("control_horizon", "prediction_horizon", "lambda_mpc", "lambda_kf"):
                assert float(row[f"details.controller.{name}"]) == float(row[f"parameters.{name}"])
            for name in ("stiffness_factor", "damping_factor"):
                assert float(row[f"details.plant.{name}"]) == float(row[f"context.{name}"])
            assert row["details.plant.seed"] == row["seed"]
            assert row["details.controller.return_time_source"] == "measured"
            assert row["details.plant.cut"] == row["details.controller.cut"]

    def test_bit_for_bit_as_in_this_process(self, finished):
        command, _ = finished
        study = study_from_mapping(small_study(3))
        backend = InProcessBackend(study)
        backend.open()
        expected = list(Tuning(study, Driver(backend), METHODS[DEFAULT_METHOD]))
        for there, here in zip(command.trials(), expected, strict=True):
            assert there.parameters == here.parameters
            assert there.worst_cases == here.worst_cases
            # The candidates that were checked at the end have more evaluations.
            assert len(there.evaluations) >= len(here.evaluations)
            for evaluation, other in zip(there.evaluations, here.evaluations, strict=False):
                assert (evaluation.context, evaluation.seed, evaluation.stage) == (
                    other.context,
                    other.seed,
                    other.stage,
                )
                for metric in ("tracking_error", "overshoot"):
                    assert evaluation.outcome.metrics[metric] == other.outcome.metrics[metric]

    @pytest.mark.parametrize("namespace", ["", "/w1/inner"])
    def test_the_controller_loads_the_result_as_it_is(
        self, finished, start_node, make_peer, namespace
    ):
        command, _ = finished
        summary = json.loads((command.run_folder / "summary.json").read_text())
        arguments = ["--params-file", str(command.run_folder / "best.yaml")]
        arguments += ["-r", f"__ns:={namespace}"] if namespace else []
        start_node("mpc_controller", *arguments)
        expected = summary["tuned"]["parameters"]
        found = make_peer(namespace).get_parameters("mpc_controller", expected)
        assert dict(zip(expected, found, strict=True)) == expected


class TestRecovery:
    @pytest.mark.slow
    def test_killed_nodes_are_replaced(self, tune):
        """Each in turn; the evaluation at hand is lost, with the reason, and run again."""
        command = tune(study=small_study(6), AMENT_PREFIX_PATH="")
        for number, name in ((0, "mpc_controller"), (2, "milling_plant")):
            command.wait_for_trial(number)
            (pid,) = command.nodes(name)
            os.kill(pid, signal.SIGKILL)
        assert command.finish() in (0, 3), command.err
        lost = [evaluation.outcome.reason for evaluation in command.lost()]
        assert lost == [f"{name} was ended by SIGKILL" for name in NODES[::-1]]
        assert [trial.ending for trial in command.trials()] == ["complete"] * 6

    @pytest.mark.slow
    def test_a_frozen_controller_is_replaced(self, tune):
        """The plant misses its command and fails the cut, but it is the controller that is lost."""
        command = tune(
            study=small_study(4, plant=SHORT | {"command_timeout": 5.0}), AMENT_PREFIX_PATH=""
        )
        command.wait_for_trial(0)
        (pid,) = command.nodes("mpc_controller")
        os.kill(pid, signal.SIGSTOP)
        assert command.finish() in (0, 3), command.err
        (lost,) = command.lost()
        assert lost.outcome.reason.startswith("mpc_controller does not answer ")

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("signum", "code"),
        [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)],
    )
    def test_a_signal_to_the_whole_group(self, tune, signum, code):
        """As of Ctrl-C, or of a terminal that is closed; no node is left."""
        command = tune(study=small_study(50), AMENT_PREFIX_PATH="")
        command.wait_for_trial(1)
        assert command.shared_memory() == []
        os.killpg(command.popen.pid, signum)
        assert command.finish() == code
        assert len(command.trials()) >= 2
        assert (command.run_folder / "trials.csv").exists()


@pytest.mark.slow
def test_attached_to_nodes_that_run(tune, start_node, peer):
    for node in NODES:
        start_node(node)
    before = {node: peer.get_parameters(node, TUNED_OR_SET[node]) for node in NODES}
    command = tune("--attach", study=small_study(2), **environment_of_nodes())
    assert command.finish() in (0, 3), command.err
    assert [trial.state for trial in command.trials()] == [TrialState.COMPLETE] * 2
    # They are not ours to end, nor to change.
    assert command.nodes() == []
    assert {node: peer.get_parameters(node, TUNED_OR_SET[node]) for node in NODES} == before
