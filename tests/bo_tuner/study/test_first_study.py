"""The text of a first study: it parses, takes what was chosen, and offers the rest in comments."""

import math

import pytest

from bo_tuner.numerics.signal_metrics import MEASURES
from bo_tuner.study.descriptors import Described
from bo_tuner.study.first_study import first_study
from bo_tuner.study.offers import parameter_offers, suggested_nodes, suggested_parameters
from bo_tuner.study.seen import Seen, SeenAction, SeenNode, SeenTopic
from bo_tuner.study.signal_offers import SignalOffer, signal_offers, suggested_signals
from bo_tuner.study.strict_yaml import dump_line, parse
from bo_tuner.study.study_file import parse_study

STATES = SeenTopic(
    "/joint_states",
    "sensor_msgs/msg/JointState",
    {"position[motor]": 0.1, "velocity[motor]": 0.0},
    ("motor",),
    ("pid",),
)
TORQUE = SeenTopic("/torque", "std_msgs/msg/Float64", {"data": 0.2}, ("pid",), ("motor",))
SETPOINT = SeenTopic("/setpoint", "std_msgs/msg/Float64", {"data": 0.0}, (), ("pid",))
CAMERA = SeenTopic("/exposure", "std_msgs/msg/Int32", {"data": 3}, ("camera",))


HALF = Described("double", 0.5)


def pid(**parameters):
    return SeenNode("pid", {"kp": Described("double", 0.5)} | parameters)


def offers(**parameters):
    found, others = parameter_offers(SeenNode("pid", parameters))
    return {offer.name: offer for offer in found}, others


def written(nodes, topics, signals=None, take=lambda offer: offer.suggested, source="first.yaml"):
    """The text for these, and the study that it is."""
    parameters = [o for node in nodes for o in parameter_offers(node)[0] if take(o)]
    if signals is None:
        signals = suggested_signals(topics, [node.name for node in nodes])
    seen = Seen(tuple(nodes), tuple(topics), ("/motor/reset",))
    text = first_study(source, seen, nodes, parameters, signals)
    return text, parse_study(text)


class TestParameters:
    def test_a_name_that_no_study_takes_gets_one(self):
        names = {"gains.ur5e/pan.p": HALF, "arm:wrist_gain": HALF, "1": HALF}
        _, made = written([pid(**names)], [STATES, SETPOINT], take=lambda offer: True)
        found = {name: item.parameter for name, item in made.parameters.items()}
        assert found == {
            "kp": "kp",
            "gains.ur5e_pan.p": "gains.ur5e/pan.p",
            "arm_wrist_gain": "arm:wrist_gain",
            "_1": "1",
        }

    def test_what_a_node_changes_by_itself_is_left_to_it(self):
        node = SeenNode("pid", {"kp": HALF, "gain_seen": HALF, "mass": HALF}, ("gain_seen", "mass"))
        text, made = written([node], [STATES, SETPOINT])
        assert list(made.parameters) == ["kp"]
        assert made.nodes["pid"].unwatched == ("gain_seen", "mass")
        assert "# gain_seen of pid: the node changes it by itself" in text
        assert "\n# contexts:" not in text

    def test_range_step_and_description_are_those_of_the_node(self):
        described = Described("double", 0.5, 0.0, 2.0, 0.25, description="gain\nof the loop")
        (offer,) = offers(kp=described)[0].values()
        assert offer.fields == {
            "type": "double",
            "bounds": [0.0, 2.0],
            "step": 0.25,
            "default": 0.5,
        }
        assert offer.remark == "range of the node; gain of the loop"
        assert offer.suggested

    @pytest.mark.parametrize(
        ("kind", "value", "bounds", "scale"),
        [
            ("double", 0.5, [0.05, 5.0], "log"),
            ("double", -2.0, [-20.0, -0.2], None),
            ("double", 0.0, [0.0, 1.0], None),
            ("integer", 8, [2, 32], None),
            ("integer", 1, [1, 4], None),
            ("integer", 0, [0, 10], None),
            ("integer", -8, [-32, -2], None),
        ],
    )
    def test_without_a_range_the_bounds_are_a_guess_and_say_so(self, kind, value, bounds, scale):
        offer = offers(kp=Described(kind, value))[0]["kp"]
        assert offer.fields["bounds"] == bounds
        assert offer.fields.get("scale") == scale
        assert "CHECK" in offer.remark

    @pytest.mark.parametrize(
        ("kind", "value", "lower", "upper", "bounds", "told"),
        [
            ("double", 0.5, 0.0, math.inf, [0.05, 5.0], "gives no range but from 0"),
            ("double", 0.5, 0.25, math.inf, [0.25, 5.0], "gives no range but from 0.25"),
            ("double", 0.5, -math.inf, 1.0, [0.05, 1.0], "gives no range but to 1"),
            ("integer", 8, 4.0, math.inf, [4, 32], "gives no range but from 4"),
        ],
    )
    def test_of_a_limit_on_one_side_the_other_bound_is_a_guess(
        self, kind, value, lower, upper, bounds, told
    ):
        """The range in a descriptor has two ends, of which one may be the largest number."""
        offer = offers(kp=Described(kind, value, lower, upper))[0]["kp"]
        assert offer.fields["bounds"] == bounds
        assert offer.remark == f"CHECK: a guess; the node {told}"

    def test_of_an_open_range_with_steps_the_bounds_are_on_them(self):
        stepped = Described("double", 0.5, 0.0, math.inf, 0.1)
        fields = offers(kp=stepped)[0]["kp"].fields
        assert (fields["bounds"], fields["step"]) == ([0.1, 5.0], 0.1)
        count = Described("integer", 8, 4.0, math.inf, 4.0)
        fields = offers(n=count)[0]["n"].fields
        assert (fields["bounds"], fields["step"]) == ([4, 32], 4)

    def test_a_range_of_decades_is_searched_by_its_logarithm(self):
        found, _ = offers(
            wide=Described("double", 1.0, 0.01, 1.0), narrow=Described("double", 1.0, 0.02, 1.0)
        )
        assert found["wide"].fields["scale"] == "log"
        assert "scale" not in found["narrow"].fields

    @pytest.mark.parametrize(
        ("kind", "value", "lower", "upper", "scale"),
        [
            ("double", 0.1, 0.0, 10.0, "symlog"),
            ("integer", 5, 0.0, 5000.0, "symlog"),
            ("double", 0.1, 0.0, 1.0, None),
            ("double", 0.0, 0.0, 10.0, "symlog"),
            ("double", 0.0, 0.0, 1.0, None),
            ("double", 0.1, -10.0, 10.0, None),
        ],
    )
    def test_a_range_from_0_on_far_beyond_the_value(self, kind, value, lower, upper, scale):
        found, _ = offers(kd=Described(kind, value, lower, upper))
        assert found["kd"].fields.get("scale") == scale
        assert found["kd"].fields["bounds"] == [lower, upper]

    def test_suggested_are_real_numbers_and_integers_with_a_range(self):
        found, others = offers(
            kp=Described("double", 0.5),
            port=Described("integer", 8080),
            horizon=Described("integer", 10, 1.0, 50.0),
            filter=Described("boolean", True),
            weights=Described("double_array", [1.0, 2.0]),
            frame=Described("string", "map"),
            serial=Described("double", 7.0, read_only=True),
            use_sim_time=Described("boolean", False),
        )
        assert {name for name, offer in found.items() if offer.suggested} == {"kp", "horizon"}
        assert set(found) == {"kp", "port", "horizon", "filter", "weights[0]", "weights[1]"}
        assert set(others) == {"frame", "serial"}

    def test_of_many_those_are_suggested_whose_names_tell_of_tuning(self):
        plain = {f"number_{k}": Described("double", 1.0, 0.1, 9.0) for k in range(20)}
        tuning = {
            name: Described("double", 1.0, 0.1, 9.0)
            for name in ("kp", "pid.i", "FollowPath.lookahead_dist", "process_noise", "lambda_mpc")
        }
        found, _ = offers(**plain, **tuning, kind=Described("double", 1.0, 0.1, 9.0))
        assert {offer.name for offer in suggested_parameters(found.values())} == set(tuning)

    def test_nodes_are_suggested_that_have_such_a_name(self):
        nodes = {
            "plant": {"mass": 2.0, "friction": 0.1},
            "pid": {"kp": 1.0, "rate": 50.0},
            "observer": {"process_noise": 0.1},
            "clock": {},
        }
        found = {
            name: parameter_offers(
                SeenNode(name, {key: Described("double", value) for key, value in values.items()})
            )[0]
            for name, values in nodes.items()
        }
        assert suggested_nodes(found) == ["pid", "observer"]
        del found["pid"], found["observer"]
        # No mass or friction is a choice.
        assert suggested_nodes(found) == []
        found["other"] = parameter_offers(SeenNode("other", {"offset": Described("double", 1.0)}))[
            0
        ]
        assert suggested_nodes(found) == ["other"]

    def test_few_are_all_suggested_and_many_without_a_telling_name_are_cut(self):
        for count, expected in ((8, 8), (9, 8), (30, 8)):
            found, _ = offers(**{f"offset_{k}": Described("double", 1.0) for k in range(count)})
            assert len(suggested_parameters(found.values())) == expected

    @pytest.mark.parametrize(
        "described",
        [
            Described("double", math.nan),
            Described("double", math.inf),
            Described("double", 1e308),
            Described("double", 5e-324),
            Described("double", 1.0, 1.0, 1.0),
            Described("double", 3.0, 0.0, 2.0),
            Described("integer", 2**62, -(2.0**63), 2.0**63),
            Described("", None),
        ],
    )
    def test_what_a_study_would_refuse_is_told_not_offered(self, described):
        found, others = offers(odd=described)
        assert not found
        assert list(others) == ["odd"]

    def test_set_points_limits_periods_and_the_plant_are_offered_and_not_suggested(self):
        settings = ("target_speed", "max_torque", "stop_distance", "sample_time", "friction")
        found, _ = offers(kp=Described("double", 0.5), **dict.fromkeys(settings, HALF))
        assert [offer.name for offer in suggested_parameters(found.values())] == ["kp"]
        assert set(found) == {"kp", *settings}
        assert found["max_torque"].remark == (
            "by its name a limit; CHECK: a guess; the node gives no range"
        )
        # Few or many, also where nothing else is there.
        found, _ = offers(**dict.fromkeys(settings, HALF))
        assert suggested_parameters(found.values()) == []

    def test_the_unit_is_that_of_the_description(self):
        found, _ = offers(
            kp=Described("double", 0.5, description="gain [V/rad]"),
            ki=Described("double", 0.5, 0.0, 1.0, description="gain in [0, 1]"),
            w=Described("double_array", [1.0], description="weights [1/m]"),
        )
        assert found["kp"].fields["unit"] == "V/rad"
        assert "unit" not in found["ki"].fields
        assert found["w[0]"].fields["unit"] == "1/m"

    def test_a_long_array_offers_its_first_items(self):
        found, others = offers(covariance=Described("double_array", [1.0] * 36))
        assert list(found) == [f"covariance[{i}]" for i in range(12)]
        assert "covariance[0]" in others["covariance"]


class TestStudy:
    def test_what_the_tuned_nodes_publish_and_hear_is_recorded_with_the_reference_first(self):
        text, study = written([pid()], [CAMERA, STATES, SETPOINT, TORQUE])
        assert {n: (s.topic, s.field) for n, s in study.signals.items()} == {
            "setpoint": ("/setpoint", "data"),
            "position_motor": ("/joint_states", "position[motor]"),
            "torque": ("/torque", "data"),
        }
        assert study.objective.metric == "error"
        assert "# /exposure (std_msgs/msg/Int32): data" in text
        assert "    # - call: {service: /motor/reset}" in text

    def test_the_run_moves_the_reference_and_brings_it_back(self):
        signals = [
            *signal_offers(SETPOINT),
            SignalOffer(STATES, "position[motor]"),
            *signal_offers(TORQUE),
        ]
        text, study = written([pid()], [STATES, SETPOINT, TORQUE], signals)
        (before, settled), (start,), (after,) = study.run.before, study.run.start, study.run.after
        # From where the motor is, at 0.1.
        assert "{data: 0.1}}  # where it is now" in text
        assert before.publish.message == after.publish.message == {"data": 0.1}
        assert (start.publish.topic, start.publish.message) == ("/setpoint", {"data": 1.1})
        assert settled.wait_until.condition == "abs(position_motor - 0.1) < 0.02"
        assert study.metrics["error"].of == "setpoint - position_motor"
        assert study.metrics["overshoot"].target == "setpoint"
        assert study.metrics["effort"].of == "torque"
        assert {metric.measure for metric in study.metrics.values()} <= set(MEASURES)
        assert (
            "  # Nobody publishes /setpoint, pid listens to it; by its name it is the reference.\n"
            "  start:  # CHECK: this moves the machine, by a step of 1\n"
        ) in text
        uncommented = text.replace("  # abort_when", "  abort_when")
        assert parse_study(uncommented).run.abort_when == "abs(position_motor - 0.1) > 2"

    def test_a_topic_that_nobody_publishes_is_no_reference_for_that_alone(self):
        """It may be a disturbance, or the brake."""
        brake = SeenTopic("/brake", "std_msgs/msg/Float64", {"data": 0.0}, (), ("pid",))
        text, study = written([pid()], [STATES, brake, TORQUE])
        assert "/brake" not in {signal.topic for signal in study.signals.values()}
        assert study.run.start == study.run.before == ()
        step = "  #   - publish: {topic: /brake, message: {data: 1.0}}"
        assert (
            f"{step}  # Nobody publishes /brake, pid listens to it; whether it is the reference is "
            "not known."
        ) in text
        # Who names it gets it published at rest, and nothing that moves the machine.
        _, study = written(
            [pid()], [STATES, brake], [*signal_offers(brake), *signal_offers(STATES)]
        )
        assert [step.publish.message for step in study.run.before] == [{"data": 0.0}]
        assert study.run.start == ()
        assert study.metrics["error"].of == "position_motor"

    def test_what_a_tuned_node_publishes_is_not_its_reference(self):
        command = SeenTopic("/cmd", "std_msgs/msg/Float64", {"data": 0.0}, ("pid",), ("motor",))
        _, study = written([pid()], [STATES, command])
        assert study.metrics["error"].of == "position_motor"
        assert study.metrics["effort"].of == "cmd"
        assert study.run.start == ()

    def test_a_reference_that_another_node_publishes_is_followed(self):
        planned = SeenTopic(
            "/target", "std_msgs/msg/Float64", {"data": 0.0}, ("planner",), ("pid",)
        )
        text, study = written([pid()], [STATES, planned, TORQUE])
        assert study.metrics["error"].of == "target - position_motor"
        assert study.run.start == ()
        assert "# planner publishes /target, pid listens to it; by its name" in text

    @pytest.mark.parametrize(
        ("fields", "message"),
        [
            ({"linear.x": 0.0, "angular.z": 0.0}, {"linear": {"x": 0.2}}),
            ({"data": 0}, {"data": 1}),
            ({"data": False}, {"data": True}),
            ({"data[0]": 0.0}, {"data": [1.0]}),
            ({"a.x[0]": 0.0, "a.x[1]": 0.0, "y[0]": 0.0}, {"a": {"x": [1.0, 0.0]}}),
            (
                {"pose.position.x": 0.0, "pose.orientation.w": 0.0},
                {"pose": {"position": {"x": 1.0}, "orientation": {"w": 1.0}}},
            ),
        ],
    )
    def test_the_step_has_the_form_of_the_message(self, fields, message):
        command = SeenTopic("/command", "x_msgs/msg/X", fields, (), ("pid",))
        _, study = written([pid()], [command], signal_offers(command)[:1])
        assert study.run.start[0].publish.message == message

    def test_everything_taken_parses_too_also_equal_names_in_two_nodes(self):
        left, right = (
            SeenNode(name, {"kp": Described("double", 0.5), "w": Described("double_array", [1.0])})
            for name in ("left/pid", "right/pid")
        )
        _, study = written([left, right], [STATES], take=lambda offer: True)
        assert {key: node.node for key, node in study.nodes.items()} == {
            "left_pid": "left/pid",
            "right_pid": "right/pid",
        }
        assert study.parameters["left_pid.kp"].parameter == "kp"
        assert study.parameters["right_pid.w[0]"].parameter == "w[0]"
        assert study.nodes["left_pid"].parameters == {"w": (1.0,)}

    def test_every_offer_in_a_comment_parses_when_it_is_taken(self):
        node = pid(filter=Described("boolean", True), port=Described("integer", 80))
        text, _ = written([node], [STATES])
        for name in ("filter", "port"):
            text = text.replace(f"# {name}: {{", f"{name}: {{")
        assert set(parse_study(text).parameters) == {"kp", "filter", "port"}

    def test_a_parameter_that_is_the_reference_is_offered_as_a_step(self):
        """By its name; it is not tuned, and not the limit of something else."""
        node = pid(setpoint=HALF, target_speed=Described("double", 2.0, read_only=True))
        text, made = written([node], [STATES])
        offered = [line for line in text.splitlines() if "- set: " in line]
        assert offered == ["  #   - set: {node: pid, parameter: setpoint, value: 1.5}"]
        assert list(made.parameters) == ["kp"]
        taken = text.replace("  # start:", "  start:").replace("  #   - set", "    - set")
        assert parse_study(taken).run.start[0].set.value == 1.5

    def test_nodes_of_one_process_are_named(self):
        (kp,) = parameter_offers(pid())[0]
        for others, told in ((("motor", "pid"), True), (("camera", "motor"), False)):
            seen = Seen((pid(),), (STATES, SETPOINT), together=(others,))
            text = first_study("a.yaml", seen, [pid()], [kp], signal_offers(STATES))
            said = "# motor and pid run in one process: what starts one starts all."
            assert (said in text.splitlines()) is told
            parse_study(text)

    def test_what_sets_it_in_motion_is_something_that_is_there(self):
        turn = SeenAction("/turn", "x_msgs/action/Turn", {"angle": "double"})
        parameters = parameter_offers(pid())[0]
        for actions, expected in (((turn,), "/turn"), ((), "docs/procedure.md")):
            seen = Seen((pid(),), (STATES,), (), actions)
            text = first_study("first.yaml", seen, seen.nodes, parameters, signal_offers(STATES))
            assert "/setpoint" not in text
            assert expected in text
            parse_study(text)
        seen = Seen((pid(),), (STATES,), (), (turn,))
        text = first_study("first.yaml", seen, seen.nodes, parameters, signal_offers(STATES))
        text = text.replace("# start:", "start:").replace("#   - send_goal", "  - send_goal")
        (step,) = parse_study(text).run.start
        assert step.send_goal.action == "/turn"
        assert "# x_msgs/action/Turn: angle (double)" in text

    def test_nodes_in_simulated_time_have_runs_in_simulated_time(self):
        text, study = written([pid(use_sim_time=Described("boolean", True))], [STATES])
        assert study.run.clock == "sim"
        assert "CHECK: the nodes use simulated time" in text
        _, study = written([pid(use_sim_time=Described("boolean", False))], [STATES])
        assert study.run.clock == "wall"

    def test_what_is_not_finite_is_not_suggested(self):
        """As of a joint without a sensor of its effort: it would fail every run."""
        fields = {"position[a]": 0.1, "effort[a]": math.nan}
        states = SeenTopic("/joint_states", "sensor_msgs/msg/JointState", fields, ("motor",))
        text, study = written([pid()], [states])
        assert [signal.field for signal in study.signals.values()] == ["position[a]"]
        assert "effort[a]" in text
        (_, effort) = signal_offers(states)
        assert effort.remark == "from motor; not finite now"
        # Where that is nothing, others may do.
        silent = SeenTopic("/pid/state", "std_msgs/msg/Float64", {"data": math.nan}, ("pid",))
        assert [str(o) for o in suggested_signals([silent, CAMERA], ["pid"])] == ["/exposure:data"]

    def test_a_seed_is_not_tuned(self):
        """Uncommented, it is the study's."""
        node = pid(seed=Described("integer", 0, 0.0, 2.0**31 - 1))
        text, study = written([node], [STATES])
        assert list(study.parameters) == ["kp"]
        study = parse_study(text.replace("# seed_parameter:", "seed_parameter:"))
        assert (study.seed_parameter.node, study.seed_parameter.parameter) == ("pid", "seed")

    def test_properties_of_a_plant_are_offered_as_contexts(self):
        """Of every node, since a plant is not the node that is tuned."""
        plant = SeenNode(
            "plant",
            {
                "mass": Described("double", 2.0, description="of the load [kg]"),
                "friction": Described("double", 0.5, 0.45, 9.0),
                "wind": Described("double", 0.0, -3.0, 3.0),
                "delay": Described("double", 0.0),
                "slope": Described("double", -0.5),
                "gear": Described("integer", 3),
                "inertia": Described("double", 1.0, read_only=True),
                "noise": Described("double", math.nan),
            },
        )
        node = pid(mass=Described("double", 1.0))
        parameters = [o for o in parameter_offers(node)[0] if o.suggested]
        seen = Seen((node, plant), (STATES,))
        text = first_study("first.yaml", seen, [node], parameters, signal_offers(STATES))
        study = parse_study(text)
        assert set(study.parameters) == {"kp"}
        assert set(study.nodes) == {"pid"}
        assert study.contexts == {}
        # Uncommented, it is a part of the study.
        head, _, rest = text.partition("# contexts:\n")
        offered, _, rest = rest.partition("\n\n")
        lines = [line.removeprefix("#") for line in offered.splitlines()]
        head = head.replace("  # plant: {", "  plant: {")
        study = parse_study("\n".join([head, "contexts:", *lines, "", rest]))
        bounds = {
            name: (
                context.node, context.parameter, context.unit,
                context.distribution.bounds, context.distribution.nominal,
            )
            for name, context in study.contexts.items()
        }  # fmt: skip
        # A fifth around the value, within the range of the node.
        assert bounds == {
            "mass": ("pid", "mass", "", (0.8, 1.2), 1.0),
            "plant.mass": ("plant", "mass", "kg", (1.6, 2.4), 2.0),
            "friction": ("plant", "friction", "", (0.45, 0.6), 0.5),
            "wind": ("plant", "wind", "", (-3.0, 3.0), 0.0),
            "delay": ("plant", "delay", "", (0.0, 0.1), 0.0),
            "slope": ("plant", "slope", "", (-0.6, -0.4), -0.5),
        }
        assert offered.count("CHECK") == 6

    def test_a_property_that_is_named_is_a_parameter_and_no_context(self):
        text, study = written([pid(mass=Described("double", 1.0))], [STATES], take=lambda _: True)
        assert set(study.parameters) == {"kp", "mass"}
        assert "# contexts:" not in text

    def test_the_commands_that_follow_have_the_arguments_of_ros(self):
        seen = Seen((pid(),), (STATES,))
        parameters = parameter_offers(pid())[0]
        arguments = ["--ros-args", "-r", "__ns:=/arm one"]
        text = first_study(
            "first.yaml", seen, seen.nodes, parameters, signal_offers(STATES), arguments
        )
        assert (
            "# Then: check first.yaml --ros-args -r '__ns:=/arm one'\n"
            "#       tune --study first.yaml --attach --ros-args -r '__ns:=/arm one'\n"
        ) in text

    def test_names_of_signals_are_valid_and_differ(self):
        topics = [
            SeenTopic("/a/data", "x_msgs/msg/X", {"data": 0.0}, ("pid",)),
            SeenTopic("/b/data", "x_msgs/msg/X", {"data": 0.0}, ("pid",)),
            SeenTopic("/t", "x_msgs/msg/X", {"data": 0.0, "abs": 1.0, "x" * 80: 1.0}, ("pid",)),
            SeenTopic(f"/{'long/' * 20}x", "x_msgs/msg/X", {"x" * 80: 1.0}, ("pid",)),
            SeenTopic("/c", "x_msgs/msg/X", {"position[a b]": 0.0, "position[a.b]": 0.0}, ("pid",)),
        ]
        signals = [offer for topic in topics for offer in signal_offers(topic)]
        _, study = written([pid()], topics, signals)
        assert len(study.signals) == 8

    def test_text_of_a_node_stays_in_its_comment(self):
        text = "a: b\n  evil: {node: pid} # \x1b[2J"
        node = pid(evil=Described("double", 1.0, description=text))
        _, study = written([node], [STATES], source="of mine.yaml")
        assert study.name == "first"
        assert set(study.parameters) == {"kp", "evil"}

    def test_several_publishers_are_not_suggested(self):
        mixed = SeenTopic("/torque", "x_msgs/msg/X", {"data": 0.0}, ("pid", "spy"), ())
        assert suggested_signals([mixed], ["pid"]) == []


@pytest.mark.parametrize(
    "value", [{"a": "position[m]"}, {"a": "on: #x"}, [1e-7, "1e-7", True, "no"], "a" * 300, {}]
)
def test_a_line_of_yaml_reads_back(value):
    line = dump_line({"value": value})
    assert "\n" not in line
    assert parse(line).value == {"value": value}
