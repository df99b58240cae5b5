"""Which signals are suggested, which is the reference, and what starts a run."""

from dataclasses import replace

import pytest

from bo_tuner.study.descriptors import Described
from bo_tuner.study.first_run import published
from bo_tuner.study.first_study import first_study
from bo_tuner.study.offers import parameter_offers
from bo_tuner.study.seen import Seen, SeenNode, SeenTopic, with_joints
from bo_tuner.study.signal_offers import (
    SignalOffer,
    is_sure,
    partner,
    reference,
    signal_offers,
    suggested_signals,
)
from bo_tuner.study.study_file import parse_study

NODES = ("base",)


def scalar(name, publishers=(), listeners=()):
    return SeenTopic(name, "std_msgs/msg/Float64", {"data": 0.0}, publishers, listeners)


def topic(name, kind, fields, publishers=(), listeners=()):
    return SeenTopic(name, kind, dict.fromkeys(fields, 0.0), publishers, listeners)


TWIST = ("linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z")
POSE = (*(f"position.{a}" for a in "xyz"), *(f"orientation.{a}" for a in "xyzw"))
COMMAND = topic("/cmd_vel", "geometry_msgs/msg/Twist", TWIST, (), ("base",))
ODOMETRY = topic(
    "/odom",
    "nav_msgs/msg/Odometry",
    [*(f"pose.pose.{name}" for name in POSE), *(f"twist.twist.{name}" for name in TWIST)],
    ("base",),
)
SCAN = topic(
    "/scan",
    "sensor_msgs/msg/LaserScan",
    [
        *("angle_min", "angle_max", "angle_increment", "time_increment"),
        *("scan_time", "range_min", "range_max"),
    ],
    ("lidar",),
    ("base",),
)
JOINTS = topic(
    "/joint_states",
    "sensor_msgs/msg/JointState",
    [f"{kind}[j{i}]" for kind in ("position", "velocity", "effort") for i in range(7)],
    ("driver",),
    ("base",),
)


def names(offers):
    return [str(offer) for offer in offers]


def written(node, topics):
    seen = Seen((node,), tuple(topics))
    signals = suggested_signals(topics, [node.name])
    text = first_study("first.yaml", seen, [node], parameter_offers(node)[0], signals)
    return text, parse_study(text)


class TestSuggested:
    def test_the_reference_and_its_partner_come_first_then_plain_numbers(self):
        battery = scalar("/battery", ("base",))
        found = names(suggested_signals([SCAN, JOINTS, ODOMETRY, battery, COMMAND], NODES))
        assert found[:2] == ["/cmd_vel:linear.x", "/odom:twist.twist.linear.x"]
        assert found[2] == "/battery:data"
        assert len(found) == 6

    def test_of_a_scan_nothing_and_of_odometry_how_it_moves(self):
        assert names(suggested_signals([SCAN, ODOMETRY], NODES)) == [
            "/odom:twist.twist.linear.x",
            "/odom:twist.twist.angular.z",
        ]

    def test_no_angle_of_a_scan_follows_a_reference(self):
        setpoint = scalar("/setpoint", (), ("base",))
        assert names(suggested_signals([SCAN, setpoint, ODOMETRY], NODES)) == [
            "/setpoint:data",
            "/odom:pose.pose.position.x",
            "/odom:twist.twist.linear.x",
            "/odom:twist.twist.angular.z",
        ]

    def test_of_joints_the_positions(self):
        assert names(suggested_signals([JOINTS], NODES)) == [
            f"/joint_states:position[j{i}]" for i in range(6)
        ]

    def test_of_other_messages_a_few_numbers(self):
        state = SeenTopic(
            "/state",
            "x_msgs/msg/State",
            {"seq": 4, "mode": 1, "is_on": True, "a": 0.0, "b": 0.0, "c": 0.0, "d": 0.0},
            ("base",),
        )
        assert names(suggested_signals([state], NODES)) == ["/state:a", "/state:b", "/state:c"]

    def test_what_is_silent_is_offered_only(self):
        """A run without a message of a signal fails."""
        fault = SeenTopic("/fault", "x_msgs/msg/X", {"a": 0.0}, ("base",), is_silent=True)
        assert names(suggested_signals([fault, ODOMETRY], NODES)) == [
            "/odom:twist.twist.linear.x",
            "/odom:twist.twist.angular.z",
        ]
        assert signal_offers(fault)[0].remark == "from base; silent now"

    def test_a_reference_whose_partner_is_unknown_is_not_suggested(self):
        """A step of an altitude by 1 from where the aileron is would end in the ground."""
        surfaces = topic("/surfaces", "x_msgs/msg/X", ["position[aileron]"], ("base",))
        height = scalar("/altitude_setpoint", (), ("base",))
        node = SeenNode("base", {"kp": Described("double", 0.5)})
        text, study = written(node, [surfaces, height])
        assert [signal.topic for signal in study.signals.values()] == ["/surfaces"]
        assert study.run.start == study.run.before == ()
        assert "#   - publish: {topic: /altitude_setpoint," in text
        # With a partner of its name it is.
        altitude = SeenTopic("/altitude", "x_msgs/msg/X", {"data": 260.04}, ("base",))
        _, study = written(node, [surfaces, height, altitude])
        assert study.run.start[0].publish.message == {"data": 261.04}
        assert study.metrics["error"].of == "altitude_setpoint - altitude"

    def test_a_command_of_the_tuned_node_is_among_them(self):
        many = [scalar(f"/a{i}", ("sensor",), ("base",)) for i in range(9)]
        output = scalar("/z_torque", ("base",))
        assert "/z_torque:data" in names(suggested_signals([*many, output], NODES))


class TestReference:
    def test_what_nobody_publishes_comes_first_and_what_the_tuned_nodes_hear(self):
        of_others = scalar("/target", ("planner",), ("base",))
        elsewhere, own = scalar("/ref", (), ("other",)), scalar("/x/setpoint", (), ("base",))
        offers = [SignalOffer(t, "data") for t in (of_others, elsewhere, own)]
        assert str(reference(offers, NODES)) == "/x/setpoint:data"
        assert str(reference(offers[:2], NODES)) == "/ref:data"
        assert str(reference(offers[:1], NODES)) == "/target:data"

    @pytest.mark.parametrize("name", ["/disturbance", "/brake", "/preference_x", "/u", "/referee"])
    def test_a_name_that_tells_nothing_is_none(self, name):
        expected = name in ("/preference_x",)
        found = reference([SignalOffer(scalar(name, (), ("base",)), "data")], NODES)
        assert (found is not None) == expected

    @pytest.mark.parametrize(
        ("wanted", "others", "expected"),
        [
            (scalar("/speed_setpoint"), ["/angle", "/speed"], "/speed:data"),
            (scalar("/setpoint"), ["/torque", "/angle"], "/angle:data"),
            (scalar("/torque_ref"), ["/angle", "/torque"], "/torque:data"),
            (scalar("/current_pose_goal"), ["/speed", "/pose"], "/pose:data"),
        ],
    )
    def test_its_partner_is_of_the_same_quantity(self, wanted, others, expected):
        offers = [SignalOffer(scalar(name, ("plant",)), "data") for name in others]
        assert str(partner(SignalOffer(wanted, "data"), offers, NODES)) == expected

    def test_its_partner_is_rather_measured_than_commanded(self):
        wanted = SignalOffer(scalar("/setpoint", (), ("base",)), "data")
        offers = [
            SignalOffer(scalar("/a", ("base",), ("plant",)), "data"),
            SignalOffer(scalar("/b", ("plant",), ("logger",)), "data"),
            SignalOffer(scalar("/c", ("plant",), ("base",)), "data"),
        ]
        assert str(partner(wanted, offers, NODES)) == "/c:data"

    @pytest.mark.parametrize(
        ("wanted", "measured", "sure"),
        [
            ("/setpoint", "/heater_temperature", True),
            ("/setpoint", "/angle", True),
            ("/setpoint", "/speed", False),
            ("/speed_setpoint", "/velocity", True),
            ("/speed_setpoint", "/angle", False),
            ("/altitude_goal", "/altitude", True),
            ("/altitude_goal", "/y", False),
        ],
    )
    def test_a_partner_is_sure_if_names_say_so(self, wanted, measured, sure):
        pair = [
            SignalOffer(scalar(name, publishers, ("base",)), "data")
            for name, publishers in ((wanted, ()), (measured, ("plant",)))
        ]
        assert is_sure(*pair) == sure

    def test_a_step_that_is_not_sure_waits_for_nothing(self):
        """Who names both gets a study of both, which says what is not known."""
        height, other = scalar("/height_goal", (), ("base",)), scalar("/y", ("plant",))
        node = SeenNode("base", {"kp": Described("double", 0.5)})
        signals = [SignalOffer(height, "data"), SignalOffer(other, "data")]
        seen = Seen((node,), (height, other))
        text = first_study("first.yaml", seen, [node], parameter_offers(node)[0], signals)
        study = parse_study(text)
        assert [step.waits for step in study.run.before] == [False]
        assert "{data: 0.0}}  # CHECK: where it is now is not known" in text
        assert "# CHECK: what good means, and whether y is to follow height_goal" in text


class TestStart:
    def test_a_twist_is_the_reference_of_the_speed(self):
        node = SeenNode("base", {"kp": Described("double", 0.5)})
        text, study = written(node, [ODOMETRY, COMMAND])
        assert study.run.start[0].publish.message == {"linear": {"x": 0.2}}
        assert study.run.after[0].publish.message == {"linear": {"x": 0.0}}
        assert study.metrics["error"].of == "cmd_vel_linear_x - odom_linear_x"
        assert "CHECK: it is published once; many drives stop without more of them" in text
        assert study.run.before[1].wait_until.condition == "abs(odom_linear_x) < 0.01"

    def test_a_trajectory_moves_one_joint_from_where_all_are(self):
        states = SeenTopic(
            "/joint_states",
            "sensor_msgs/msg/JointState",
            {"position[lift]": 0.5, "position[turn]": -1.204, "position[grip]": 0.02},
            ("broadcaster",),
        )
        node = SeenNode(
            "arm",
            {
                "gains.turn.p": Described("double", 5.0),
                "joints": Described("string_array", ["turn", "lift"]),
            },
        )
        silent = SeenTopic(
            "/arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", {}, (), ("arm",)
        )
        path = with_joints(silent, [node], [states, silent])
        _, study = written(node, [path, states])
        start, after = study.run.start[0].publish, study.run.after[0].publish
        seconds = {"sec": 1}
        assert start.message == {
            "joint_names": ["turn", "lift"],
            "points": [{"positions": [-1.1, 0.5], "time_from_start": seconds}],
        }
        assert after.message["points"] == [{"positions": [-1.2, 0.5], "time_from_start": seconds}]
        assert study.run.before[0].publish == after
        wanted = study.signals["joint_trajectory_turn"]
        assert (wanted.topic, wanted.field) == (path.name, "points[0].positions[0]")
        assert study.metrics["error"].of == "joint_trajectory_turn - position_turn"
        # Offered in a comment, where nothing tells what follows it, it moves as little.
        seen = Seen((node,), (path, states))
        signals = signal_offers(states)[-1:]
        text = first_study("first.yaml", seen, [node], parameter_offers(node)[0], signals)
        assert "#   - publish: {topic: /arm/joint_trajectory," in text
        assert "positions: [-1.1, 0.5]" in text
        condition = study.run.before[1].wait_until.condition
        assert condition == "abs(position_turn + 1.2) < 0.01"

    def test_joints_that_no_parameter_names_are_those_that_are_published(self):
        silent = SeenTopic(
            "/arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", {}, (), ("arm",)
        )
        assert with_joints(silent, [], [JOINTS]).joints == tuple(f"j{i}" for i in range(7))
        assert with_joints(silent, [], []).joints == ()

    def test_a_pose_begins_where_the_machine_is(self):
        goal = topic("/goal_pose", "geometry_msgs/msg/PoseStamped", [f"pose.{n}" for n in POSE])
        goal = replace(goal, listeners=("base",))
        now = {f"pose.pose.{name}": 0.0 for name in POSE} | {
            "pose.pose.position.x": 0.5, "pose.pose.position.z": 1.2,
            "pose.pose.orientation.z": 0.6, "pose.pose.orientation.w": 0.8,
            "twist.twist.linear.x": 3.0,
        }  # fmt: skip
        odometry = SeenTopic("/odom", "nav_msgs/msg/Odometry", now, ("sim",), ("base",))
        node = SeenNode("base", {"kp": Described("double", 0.5)})
        text, study = written(node, [goal, odometry])
        (start,), before = study.run.start, study.run.before[0]
        rotation = {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
        assert start.publish.message == {
            "pose": {"position": {"x": 1.5, "y": 0.0, "z": 1.2}, "orientation": rotation}
        }
        assert before.publish.message["pose"]["position"] == {"x": 0.5, "y": 0.0, "z": 1.2}
        assert study.metrics["error"].of == "goal_pose_position_x - odom_position_x"
        assert "its header needs a frame" in text
        # Of a paused simulation nothing is known, and nothing waited for.
        text, study = written(node, [goal, replace(odometry, is_silent=True)])
        assert study.run.start[0].publish.message["pose"]["position"] == {"x": 1.0}
        assert len(study.run.before) == 1
        assert "# CHECK: where it is now is not known" in text
        assert study.metrics["error"].of == "goal_pose_position_x - odom_position_x"

    def test_a_pose_has_no_rotation_of_zeros(self):
        goal = topic("/goal", "geometry_msgs/msg/Pose", POSE, (), ("base",))
        step = published(signal_offers(goal)[0], 2.0)
        assert step["message"] == {"position": {"x": 2.0}, "orientation": {"w": 1.0}}


def test_several_publishers_of_one_node_are_suggested_and_of_several_one_is_named():
    """Behaviours of one node share its topic; of two nodes somebody has to say which counts."""
    own = scalar("/effort", ("base", "base"))
    shared = scalar("/speed", ("a_joystick", "base"))
    offers = suggested_signals([own, shared], NODES)
    assert [offer.topic for offer in offers] == [own]
    assert offers[0].remark == "from base"
    wanted = SignalOffer(shared, "data")
    assert wanted.remark == (
        "from a_joystick and base; CHECK: publisher names the one that counts, merge: true takes "
        "all"
    )
    node = SeenNode("base", {"kp": Described("double", 1.0)})
    text = first_study(
        "study.yaml", Seen((node,), (own, shared)), [node], parameter_offers(node)[0], [wanted]
    )
    signal = parse_study(text).signals["speed"]
    assert signal.publisher == "a_joystick"
    assert "CHECK: publisher names" in text


def test_a_number_of_several_fields_is_named_after_all_of_it():
    wheels = topic("/odom", "nav_msgs/msg/Odometry", ["norm(twist.linear.x, twist.linear.y)"])
    node = SeenNode("base", {"kp": Described("double", 1.0)})
    offers = signal_offers(replace(wheels, publishers=("base",)))
    text = first_study("a.yaml", Seen((node,), ()), [node], parameter_offers(node)[0], offers)
    assert list(parse_study(text).signals) == ["norm_twist_linear_x_twist_linear_y"]


class TestEstimators:
    """The signals of a node that estimates something, beside its ground truth."""

    truth = topic("/ground_truth/odom", "nav_msgs/msg/Odometry", ("pose.position.x",), ("sim",))
    estimate = topic("/odometry/filtered", "nav_msgs/msg/Odometry", ("pose.position.x",), ("ekf",))
    drive = scalar("/cmd_vel_out", ("teleop",), ("ekf", "sim"))
    node = SeenNode("ekf", {"process_noise": Described("double", 0.5)})

    def test_the_ground_truth_is_what_it_should_find(self):
        _, study = written(self.node, [self.drive, self.truth, self.estimate])
        error = study.metrics["error"]
        target, found = (study.signals[name].topic for name in error.of.split(" - "))
        assert (target, found, error.measure) == ("/ground_truth/odom", "/odometry/filtered", "rms")
        assert "overshoot" not in study.metrics

    def test_a_controller_follows_its_reference_whatever_the_truth(self):
        command = scalar("/torque", ("ekf",), ("sim",))
        target = scalar("/target", (), ("ekf",))
        offers = [SignalOffer(t, name) for t in (self.truth, command, target) for name in t.fields]
        assert str(reference(offers, ("ekf",))) == "/target:data"


@pytest.mark.parametrize("service", ["/go", "/sim/start", "/start_run", "/plant/run_cut"])
def test_a_service_that_sets_it_in_motion_starts_a_run(service):
    node = SeenNode("base", {"kp": Described("double", 0.5)})
    topics = [topic("/odom", "x_msgs/msg/X", ("speed",), ("base",))]
    seen = Seen((node,), tuple(topics), ("/sim/reset", service))
    text = first_study(
        "first.yaml", seen, [node], parameter_offers(node)[0], suggested_signals(topics, ["base"])
    )
    (start,) = parse_study(text).run.start
    assert start.call.service == service
    assert "# - call: {service: /sim/reset}" in text.replace("#   - ", "# - ")
