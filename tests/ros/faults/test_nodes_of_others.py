"""A backend on nodes that it has not started: restarted by others, and spoken over by others."""

import contextlib
import signal

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from functions import planned
from rclpy.duration import Duration
from std_msgs.msg import String
from waiting import DEADLINE

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from bo_tuner.trials import EvaluationState

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PACKAGES = ("milling_plant", "mpc_controller")


@pytest.fixture
def nodes(start_node):
    return {package: start_node(package) for package in PACKAGES}


@pytest.fixture
def run_cut(nodes, peer, tmp_path, monkeypatch):
    """Function that runs a cut on the nodes, other values each time, and returns its outcome."""
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", DEADLINE)
    mapping = study_to_mapping(load_study("benchmark"))
    mapping["nodes"]["controller"]["parameters"] = {"return_time": "modelled"}
    mapping["nodes"]["plant"]["parameters"] = {"samples_per_level": 20, "command_timeout": 5.0}
    study = study_from_mapping(mapping)
    for package in nodes:
        peer.get_parameters(package, ["gain"])
    backend = RosBackend(study, tmp_path, attach=True)
    parameters = study.search_space().defaults
    context = {"stiffness_factor": 1.125, "damping_factor": 0.875}

    def run(seed):
        return backend.outcome(planned(parameters, context, seed))

    with contextlib.closing(backend):
        backend.open()
        yield run


@pytest.mark.parametrize(
    ("package", "signum"),
    [("milling_plant", signal.SIGTERM), ("mpc_controller", signal.SIGKILL)],
)
def test_a_node_restarted_between_cuts_is_told_everything_again(
    nodes, run_cut, start_node, peer, package, signum
):
    """It is back before it could be missed, but has forgotten all it was told."""
    before = run_cut(seed=1)
    assert before.state is EvaluationState.COMPLETE
    node = nodes[package]
    node.expected_code = 0 if signum == signal.SIGTERM else -signum
    node.send(signum)
    node.wait()
    start_node(package)
    peer.get_parameters(package, ["gain"])
    # A killed node may still get the first call, in place of the new one.
    outcomes = [run_cut(seed=1) for _ in range(3)]
    complete = [outcome for outcome in outcomes if outcome.state is EvaluationState.COMPLETE]
    assert len(complete) >= 2
    for outcome in outcomes:
        assert (outcome.state is EvaluationState.COMPLETE) == (outcome.reason == "")
    for outcome in complete:
        assert outcome.metrics == before.metrics
        assert outcome.details["controller.return_time_source"] == "modelled"
        assert outcome.details["plant.samples"] == "120"
        assert outcome.details["plant.stiffness_factor"] == "1.125"


def test_results_of_others_are_ignored_and_counted(run_cut, peer):
    """Of a foreign publisher: other cuts, no cut, huge texts, no number, and another type."""
    before = run_cut(seed=3)
    assert before.notes.ignored_results == 0
    publisher = peer.node.create_publisher(DiagnosticArray, "milling_plant/cut_result", 100)
    other_type = peer.node.create_publisher(String, "mpc_controller/cut_result", 10)
    peer.spin_until(lambda: publisher.get_subscription_count() > 0, "the tuner")

    def say(*pairs, level=DiagnosticStatus.OK):
        values = [KeyValue(key=key, value=value) for key, value in pairs]
        status = DiagnosticStatus(level=level, name="x", message="\x1b[2J", values=values)
        publisher.publish(DiagnosticArray(status=[status]))

    say(("cut", "1.000000000"), ("tracking_error", "0.0"), ("overshoot", "0.0"))
    say(("cut", "1.000000000"), ("status", "failed"), level=DiagnosticStatus.ERROR)
    say(("cut", ""), ("tracking_error", "nan"))
    say(("tracking_error", "-inf"), level=b"\xff")
    say(("cut", "9" * 1_000_000), ("x" * 1_000_000, "\0\n\x1b"))
    publisher.publish(DiagnosticArray())
    publisher.publish(DiagnosticArray(status=[DiagnosticStatus()] * 20))
    other_type.publish(String(data="no result"))
    assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))
    after = run_cut(seed=3)
    assert after.state is EvaluationState.COMPLETE
    # The return time is measured; the rest of the result depends on nothing but the seed.
    assert after.metrics == before.metrics
    assert after.notes.ignored_results == 25
    assert run_cut(seed=3).notes.ignored_results == 0
