"""Messages and requests that no well-behaved node sends: none takes a node away from the others."""

import itertools
import math

import pytest
from builtin_interfaces.msg import Duration, Time
from cuts import expected_commands
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from milling_nodes import Loop
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from feed_axis_common.parameters import specifications
from milling_plant.cut import MillingPlant
from mpc_controller.controller import MpcController
from mpc_controller.settings import ControllerSettings

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PERIOD = 20_000_000
NANOSECONDS = 1_000_000_000
LAST = Time(sec=2**31 - 1, nanosec=2**32 - 1)
starts = itertools.count(1_500_000_000 * NANOSECONDS, 100 * NANOSECONDS)
NAMES = [spec.name for spec in specifications(ControllerSettings)]

any_stamp = st.builds(Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
any_double = st.floats() | st.sampled_from([1e308, -1e308, 5e-324])
any_text = st.text(max_size=30) | st.sampled_from(["x_axis", "x" * 100_000])
any_value = st.builds(
    ParameterValue,
    type=st.integers(0, 255) | st.integers(0, 9),
    bool_value=st.booleans(),
    integer_value=st.integers(-(2**63), 2**63 - 1),
    double_value=any_double,
    string_value=any_text,
    byte_array_value=st.lists(st.binary(min_size=1, max_size=1), max_size=3),
    bool_array_value=st.lists(st.booleans(), max_size=3),
    integer_array_value=st.lists(st.integers(-(2**63), 2**63 - 1), max_size=3),
    double_array_value=st.lists(any_double, max_size=3),
    string_array_value=st.lists(any_text, max_size=3),
)
any_parameters = st.lists(
    st.builds(
        Parameter, name=st.sampled_from([*NAMES, "use_sim_time"]) | any_text, value=any_value
    ),
    max_size=4,
)
any_state = st.builds(
    JointState,
    header=st.builds(Header, stamp=any_stamp, frame_id=any_text),
    name=st.lists(any_text, max_size=3),
    velocity=st.lists(any_double, max_size=3),
)
any_point = st.builds(
    JointTrajectoryPoint,
    velocities=st.lists(any_double, max_size=2),
    time_from_start=st.builds(
        Duration, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1)
    ),
)
any_trajectory = st.builds(
    JointTrajectory,
    header=st.builds(Header, stamp=any_stamp),
    joint_names=st.lists(any_text, max_size=2),
    points=st.lists(any_point, max_size=3),
)
over_the_wire = settings(
    max_examples=40,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    # Shrinking would run the nodes through hundreds of further cases.
    phases=[Phase.explicit, Phase.generate],
)


def check_cut(drive, start):
    """Run a short cut; its commands are those of the controller object."""
    reference, velocities = [0.5, 0.5, 0.7, 0.7], [0.5, 0.49, 0.52, 0.6]
    drive.results.clear()
    drive.reference(reference, start=start)
    commands = []
    for k, velocity in enumerate(velocities):
        drive.state(start + k * PERIOD, [velocity])
        commands.append(drive.command_for(start + k * PERIOD))
    assert commands == expected_commands(velocities, reference)
    values, _, _ = drive.result(start)
    assert values["status"] == "ok"


class TestParameters:
    @pytest.mark.parametrize("service", [SetParameters, SetParametersAtomically])
    @pytest.mark.parametrize("kind", [10, 200, 255])
    @pytest.mark.parametrize("node", ["milling_plant", "mpc_controller"])
    def test_a_type_that_does_not_exist_is_refused(self, client, node, service, kind):
        name = "set_parameters" + ("_atomically" if service is SetParametersAtomically else "")
        request = service.Request(
            parameters=[
                Parameter(name="gain", value=ParameterValue(type=3, double_value=2.0)),
                Parameter(name="dead_time", value=ParameterValue(type=kind)),
            ]
        )
        answer = client.call(service, f"{node}/{name}", request)
        results = [answer.result] if service is SetParametersAtomically else answer.results
        assert [result.successful for result in results] == [False] * len(results)
        assert {result.reason for result in results} == {
            f"dead_time: unknown parameter type {kind}"
        }
        assert client.get_parameters(node, ["gain"]) == [1.0]

    @over_the_wire
    @given(parameters=any_parameters)
    def test_any_request_is_answered_and_leaves_a_set_in_force_that_holds(self, client, parameters):
        request = SetParametersAtomically.Request(parameters=parameters)
        name = "mpc_controller/set_parameters_atomically"
        result = client.call(SetParametersAtomically, name, request).result
        assert result.successful or result.reason
        values = dict(zip(NAMES, client.get_parameters("mpc_controller", NAMES), strict=True))
        MpcController().set_parameters(values)


class TestController:
    def test_stamps_that_are_no_time_are_ignored_and_counted(self, drive):
        good = [0.5] * 4
        for stamp in (
            LAST,
            Time(sec=2**31 - 1),
            Time(sec=-1),
            Time(sec=-(2**31), nanosec=2**32 - 1),
        ):
            drive._reference.publish(
                JointTrajectory(
                    header=Header(stamp=stamp),
                    joint_names=["x_axis"],
                    points=[JointTrajectoryPoint(velocities=[math.nan])],
                ),
            )
        drive.peer.spin_for(0.2)
        assert drive.results == []
        start = 1_600_000_000 * NANOSECONDS
        drive.reference(good, start=start)
        drive.deliver()
        for stamp in (LAST, Time(sec=-5)):
            drive._state.publish(
                JointState(header=Header(stamp=stamp), name=["x_axis"], velocity=[9.0])
            )
        for k in range(4):
            drive.state(start + k * PERIOD, [0.5])
            assert drive.command_for(start + k * PERIOD) == expected_commands([0.5] * 4, good)[k]
        assert drive.result(start)[0]["ignored_messages"] == "2"

    def test_a_measurement_far_ahead_is_none_of_this_cut(self, drive):
        """Bridged sample by sample, a forged one would keep the controller busy for minutes."""
        start = 1_600_001_000 * NANOSECONDS
        drive.reference([0.5] * 300, start=start)
        drive.deliver()
        drive.state(start + 299 * PERIOD, [9.0])
        for k in (0, 1, 150, 299):
            drive.state(start + k * PERIOD, [0.5])
            drive.command_for(start + k * PERIOD)
        values, _, _ = drive.result(start)
        assert values["ignored_messages"] == "1"
        assert values["fallbacks"] == str(300 - 4)

    def test_velocities_that_no_drive_can_have_are_left_out_and_fail_the_cut(self, drive):
        """In the estimate they would leave no number for the rest of the cut."""
        start = 1_600_002_000 * NANOSECONDS
        drive.reference([0.5] * 6, start=start)
        commands = []
        for k, velocity in enumerate([0.5, 0.5, 1e308, -1e308, 1e308, 0.5]):
            drive.state(start + k * PERIOD, [velocity])
            commands.append(drive.command_for(start + k * PERIOD))
        values, _, message = drive.result(start)
        assert message == "sample 2: measurement is 1e+308"
        assert values["fallbacks"] == "3"
        assert values["status"] == "failed"
        assert all(0.0 <= command <= 1.2 for command in commands)
        check_cut(drive, start + 1_000 * NANOSECONDS)

    @over_the_wire
    @given(messages=st.lists(any_state | any_trajectory, min_size=1, max_size=10))
    def test_any_messages_leave_it_able_to_cut(self, drive, messages):
        for message in messages:
            of_state = isinstance(message, JointState)
            (drive._state if of_state else drive._reference).publish(message)
        drive.peer.spin_for(0.02)
        check_cut(drive, next(starts))


class TestClock:
    def test_a_clock_that_jumps_changes_no_cut(self, start_node, make_peer):
        """By an hour forth and back while cuts run, to before 1970, and to where stamps end."""
        for package in ("milling_plant", "mpc_controller"):
            start_node(package, "-r", "__ns:=/clocked", "-p", "use_sim_time:=true")
        peer = make_peer("/clocked")
        clock = peer.node.create_publisher(Clock, "/clock", 10)
        loop = Loop(peer)
        loop.connect()
        plain = MillingPlant()
        plain.set_parameters({"seed": 5, "samples_per_level": 200})
        expected = plain.run_cut(MpcController())
        loop.set("milling_plant", seed=5, samples_per_level=200)
        peer.spin_until(lambda: clock.get_subscription_count() == 2, "both nodes")
        seconds = 1_000_000
        cuts = []
        for jump in (3_600, -3_600, -900_000):
            cuts.append(loop.start_cut())
            clock.publish(Clock(clock=Time(sec=-1)))
            for step in range(20):
                clock.publish(Clock(clock=Time(sec=seconds + step)))
                peer.spin_for(0.01)
            seconds += jump
            clock.publish(Clock(clock=Time(sec=seconds)))
            for node in ("milling_plant", "mpc_controller"):
                (status,) = loop.result(node, cuts[-1]).status
                assert status.message == ""
            values = {
                v.key: v.value for v in loop.result("milling_plant", cuts[-1]).status[0].values
            }
            assert float(values["tracking_error"]) == expected["tracking_error"]
            assert float(values["overshoot"]) == expected["overshoot"]
        # Stamps never repeat, or a late message could be taken for one of another cut.
        starts = [float(cut) for cut in cuts]
        apart = (abs(b - a) for a, b in itertools.combinations(starts, 2))
        assert all(distance >= 1200 * 0.02 - 1e-6 for distance in apart)

        def refused():
            clock.publish(Clock(clock=LAST))
            answer = peer.trigger("milling_plant/run_cut")
            if answer.success:
                loop.result("milling_plant", answer.message)
            return answer.message == "the cut would end after 2038, the end of ROS time stamps"

        peer.spin_until(refused, "the refusal")
