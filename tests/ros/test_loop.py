"""Plant and controller as processes: cuts over topics."""

import subprocess
import sys

import numpy as np
import pytest
from cuts import cut_in_process
from diagnostic_msgs.msg import DiagnosticStatus
from milling_nodes import Loop, values_of
from sensor_msgs.msg import JointState

from feed_axis_common.ros.messages import cut_identifier, from_stamp
from milling_plant.cut import MillingPlant, reference_velocity

pytestmark = pytest.mark.ros


def by_sample(messages, start):
    """Velocities by sample, of one cut; a message that came twice counts once."""
    velocities = {from_stamp(m.header.stamp): m.velocity[0] for m in messages}
    times = sorted(time for time in velocities if time >= start)
    np.testing.assert_array_equal(times, start + np.arange(len(times)) * 20_000_000)
    return [velocities[time] for time in times]


@pytest.mark.parametrize(
    ("plant_values", "controller_values"),
    [
        (
            {"seed": 5, "stiffness_factor": 1.0, "damping_factor": 1.0},
            {"return_time": "modelled"},
        ),
        (
            {"seed": 2**62 + 1, "stiffness_factor": 1.2345678901234567, "damping_factor": 0.7},
            {
                "control_horizon": 2,
                "prediction_horizon": 4,
                "lambda_mpc": -3.9,
                "lambda_kf": 2.0,
                "return_time": "modelled",
            },
        ),
    ],
)
def test_a_cut_over_ros_equals_the_cut_in_process_bit_for_bit(
    loop, plant_values, controller_values
):
    loop.set("milling_plant", **plant_values)
    loop.set("mpc_controller", **controller_values)
    cut = loop.start_cut()
    plant = loop.result("milling_plant", cut)
    controller = loop.result("mpc_controller", cut)

    def references():
        """Those of this cut: what is sent again of an earlier one may still be on its way."""
        return [m for m in loop.references if cut_identifier(from_stamp(m.header.stamp)) == cut]

    loop.peer.spin_until(references, "the reference")
    reference = references()[0]
    start = from_stamp(reference.header.stamp)

    expected = cut_in_process(plant_values, controller_values)
    for received in (loop.measurements, loop.commands):
        loop.peer.spin_until(
            lambda r=received: len(by_sample(r, start)) == 270, "all messages of the cut"
        )
    assert by_sample(loop.measurements, start) == expected.kept["measurement"]
    assert by_sample(loop.commands, start) == expected.kept["command"]
    velocities = [point.velocities[0] for point in reference.points]
    np.testing.assert_array_equal(velocities, reference_velocity(MillingPlant().settings))

    for message, values in ((plant, expected.plant), (controller, expected.controller)):
        (status,) = message.status
        assert status.level == DiagnosticStatus.OK
        assert status.hardware_id == "x_axis"
        assert status.message == ""
        texts = {item.key: item.value for item in status.values}
        for key, value in values.items():
            assert type(value)(texts[key]) == value, key
    assert plant.status[0].name == "milling_plant: cut_result"
    assert controller.status[0].name == "mpc_controller: cut_result"


def test_cuts_follow_one_another_and_come_back(loop):
    loop.set("mpc_controller", return_time="modelled")
    results, identifiers = [], []
    for seed in (1, 2, 1):
        loop.set("milling_plant", seed=seed)
        plant, controller = loop.run_cut()
        identifiers.append(plant.pop("cut"))
        assert controller.pop("cut") == identifiers[-1]
        for counter in ("ignored_messages", "resent_measurements"):
            plant.pop(counter)
        controller.pop("ignored_messages")
        results.append((plant, controller))
    assert results[0] == results[2]
    assert results[0] != results[1]
    assert len(set(identifiers)) == 3
    assert [float(i) for i in identifiers] == sorted(float(i) for i in identifiers)


def test_no_second_cut_while_one_runs_and_abort(loop):
    answer = loop.peer.trigger("milling_plant/abort")
    assert not answer.success
    assert answer.message == "no cut is running"
    loop.set("milling_plant", reference_levels=[0.5], samples_per_level=10_000)
    cut = loop.start_cut()
    refused = loop.peer.trigger("milling_plant/run_cut")
    assert not refused.success
    assert refused.message == f"cut {cut} is still running; wait until it ends, or abort it"
    answer = loop.peer.trigger("milling_plant/abort")
    assert answer.success
    assert answer.message == f"aborted cut {cut}"
    message = loop.result("milling_plant", cut)
    assert message.status[0].level == DiagnosticStatus.ERROR
    assert message.status[0].message.startswith("aborted at sample ")

    # The next cut is as good as any, though the controller never saw the end of this one.
    loop.set("milling_plant", reference_levels=[0.5, 0.8], samples_per_level=20, seed=3)
    plant, controller = loop.run_cut()
    assert (plant["status"], controller["status"]) == ("ok", "ok")
    plain = cut_in_process({"reference_levels": [0.5, 0.8], "samples_per_level": 20, "seed": 3}, {})
    assert float(plant["tracking_error"]) == plain.plant["tracking_error"]


def test_stamps_after_a_cut_that_failed_are_behind_its_own(loop):
    """The controller cannot take the next cut's first measurement for one of the aborted cut."""
    loop.set("milling_plant", reference_levels=[0.5], samples_per_level=10_000)
    aborted = loop.start_cut()
    loop.peer.trigger("milling_plant/abort")
    loop.set("milling_plant", samples_per_level=3)
    following = loop.start_cut()
    assert values_of(loop.result("milling_plant", following))["status"] == "ok"
    assert float(following) >= float(aborted) + 10_000 * 0.02 - 1e-6


def test_a_change_in_a_cut_takes_effect_with_the_next(loop):
    cuts = []

    def changed_in_the_cut():
        """Whether the changes came before its end, which a busy machine may prevent."""
        loop.set("milling_plant", samples_per_level=150, seed=1, stiffness_factor=1.0)
        loop.set("mpc_controller", lambda_mpc=-3.0)
        cuts.append(loop.start_cut())
        loop.set("milling_plant", seed=2, stiffness_factor=1.1)
        loop.set("mpc_controller", lambda_mpc=-1.0)
        return not loop.has_result("milling_plant", cuts[-1])

    loop.peer.spin_until(changed_in_the_cut, "changes in a cut")
    cut = cuts[-1]
    plant = values_of(loop.result("milling_plant", cut))
    controller = values_of(loop.result("mpc_controller", cut))
    assert (plant["seed"], plant["stiffness_factor"]) == ("1", "1.0")
    assert controller["lambda_mpc"] == "-3.0"
    plain = cut_in_process({"samples_per_level": 150, "seed": 1}, {})
    assert float(plant["tracking_error"]) == plain.plant["tracking_error"]

    plant, controller = loop.run_cut()
    assert (plant["seed"], plant["stiffness_factor"]) == ("2", "1.1")
    assert controller["lambda_mpc"] == "-1.0"


def test_the_estimate_is_published_only_for_those_who_listen(loop):
    samples = 40
    loop.set("milling_plant", reference_levels=[0.5], samples_per_level=samples)
    loop.run_cut()
    estimates = loop.peer.record(JointState, "mpc_controller/estimated_state")

    def all_estimates():
        estimates.clear()
        loop.run_cut()
        loop.peer.spin_for(0.02)
        return len(estimates) == samples

    loop.peer.spin_until(all_estimates, "an estimate for each sample")
    assert all(m.name == ["x_axis"] for m in estimates)
    np.testing.assert_allclose([m.velocity[0] for m in estimates], 0.5, atol=0.15)


def start_pair(start_node, namespace, *arguments):
    """Start a pair in a namespace, away from the one that the tests share."""
    for package in ("milling_plant", "mpc_controller"):
        start_node(package, "-r", f"__ns:={namespace}", *arguments)


def test_both_nodes_move_into_a_namespace_together(start_node, make_peer):
    start_pair(start_node, "/w1")
    peer = make_peer("/w1")
    loop = Loop(peer)
    loop.connect()
    plant, controller = loop.run_cut()
    assert (plant["status"], controller["status"]) == ("ok", "ok")
    for node in ("milling_plant", "mpc_controller"):
        pairs = peer.node.get_publisher_names_and_types_by_node(node, "/w1")
        outside = {topic for topic, _ in pairs if not topic.startswith("/w1/")}
        assert outside <= {"/rosout", "/parameter_events"}


def test_cuts_need_no_clock(start_node, make_peer):
    """With simulated time and nobody who publishes it, time stands still."""
    start_pair(start_node, "/still", "-p", "use_sim_time:=true")
    loop = Loop(make_peer("/still"))
    loop.connect()
    first, _ = loop.run_cut()
    second, _ = loop.run_cut()
    assert (first["status"], second["status"]) == ("ok", "ok")
    assert first["cut"] != second["cut"]
    # A plant that is started anew must not begin with the same ones.
    assert float(first["cut"]) > 1e9


def test_no_cut_without_a_controller(start_node, make_peer):
    start_node("milling_plant", "-r", "__ns:=/alone")
    answer = make_peer("/alone").trigger("milling_plant/run_cut")
    assert not answer.success
    assert answer.message == "no controller subscribes to /alone/mpc_controller/joint_trajectory"


FIELDS = """
import {module}
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import KeyValue
from rcl_interfaces.msg import SetParametersResult
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
for message, field in (
    (Time, "sec"), (KeyValue, "value"), (SetParametersResult, "reason"), (JointState, "name"),
    (Trigger.Response, "message"), (JointTrajectory, "joint_names"),
):
    try:
        message(**{{field: 1.5}})
    except AssertionError:
        continue
    raise SystemExit(f"{{message.__name__}} takes anything")
"""


@pytest.mark.parametrize("module", ["milling_plant.node", "mpc_controller.node"])
def test_a_node_checks_the_fields_of_all_its_messages(monkeypatch, ros_environment, module):
    """Of all messages, also of those that rclpy itself imports."""
    monkeypatch.delenv("ROS_PYTHON_CHECK_FIELDS")
    done = subprocess.run(
        [sys.executable, "-c", FIELDS.format(module=module)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
