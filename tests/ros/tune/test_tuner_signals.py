"""A tuner that is told to end by any signal, or that is stopped for a while."""

import json
import signal
import time

import pytest
from tuner import environment_of_nodes
from waiting import count_in

from bo_tuner.backends.layers.suspension import LONGEST
from bo_tuner.study.study_file import load_study, study_to_mapping
from bo_tuner.trials import EvaluationState

pytestmark = [pytest.mark.ros, pytest.mark.slow]

NODES = ("milling_plant", "mpc_controller")
SET = {
    "milling_plant": ["stiffness_factor", "damping_factor", "seed"],
    "mpc_controller": ["prediction_horizon", "control_horizon", "lambda_kf"],
}


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_attached_nodes_get_their_parameters_back(tune, start_node, peer, signum):
    """Whatever signal it is, and however often it comes."""
    for node in NODES:
        start_node(node)
    before = {node: peer.get_parameters(node, SET[node]) for node in NODES}
    study = json.loads(json.dumps(study_to_mapping(load_study("benchmark").replace(trials=50))))
    command = tune("--attach", study=study, **environment_of_nodes())
    command.wait_for_trial(0)
    changed = {node: peer.get_parameters(node, SET[node]) for node in NODES}
    for _ in range(3):
        command.popen.send_signal(signum)
        time.sleep(0.05)
    assert command.finish() == 128 + signum
    assert "Traceback" not in command.err
    assert changed != before
    assert {node: peer.get_parameters(node, SET[node]) for node in NODES} == before


def test_what_the_tuner_slept_through_is_no_failure(tune, drive_study, tmp_path):
    """It is stopped in an evaluation, for longer than that may take."""
    study = drive_study(trigger={"timeout": 5.0})
    command = tune(study=study, DRIVE="3:mute")
    command.wait_for(lambda: count_in(tmp_path / "cuts") >= 3, "the third evaluation")
    command.popen.send_signal(signal.SIGSTOP)
    time.sleep(LONGEST + 2.0)
    command.popen.send_signal(signal.SIGCONT)
    assert command.finish() in (0, 3), command.err
    states = {e.outcome.state for trial in command.trials() for e in trial.evaluations}
    assert states == {EvaluationState.COMPLETE}
