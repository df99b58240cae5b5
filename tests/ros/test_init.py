"""The command `init` on running nodes: what it sees, what it asks, and what it writes."""

import errno
import math
import os
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import rclpy
from commands import environment
from geometry_msgs.msg import PoseWithCovarianceStamped
from in_process import call
from node_threads import at_work
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.action import ActionServer
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image, JointState, LaserScan, PointCloud2
from servo import System, study
from std_msgs.msg import Float64, Float64MultiArray
from terminals import converse
from test_msgs.action import Fibonacci
from trajectory_msgs.msg import JointTrajectory
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros.fields import field_reader
from bo_tuner.backends.ros.graph import _described
from bo_tuner.backends.ros.isolation import DomainClaim
from bo_tuner.backends.ros.messages import (
    interface_class,
    is_bulky,
    number_arrays,
    number_fields,
)
from bo_tuner.backends.ros.survey import _ends, _look, _together
from bo_tuner.cli import check, init, tune
from bo_tuner.cli.chooser import numbers
from bo_tuner.errors import StudyError
from bo_tuner.study.descriptors import Described
from bo_tuner.study.fields import parsed_field
from bo_tuner.study.offers import parameter_offers
from bo_tuner.study.seen import Seen, SeenNode, SeenTopic
from bo_tuner.study.study_file import load_study, parse_study, study_to_yaml

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def servo():
    with at_work(System) as node:
        yield node


@pytest.fixture
def quick(monkeypatch):
    """What runs in this process is discovered at once, and nothing there changes by itself."""
    for name, seconds in (
        ("graph.LOOK_AROUND", 0.1),
        ("bringup.LOOK_AROUND", 0.1),
        ("survey.CHANGES", 0.1),
    ):
        monkeypatch.setattr(f"bo_tuner.backends.ros.{name}", seconds)


@pytest.fixture
def run(quick, tmp_path, capsys, monkeypatch):
    """Function that runs a command in this process, in the folder of the test."""
    commands = {"init": init, "check": check, "tune": tune}
    monkeypatch.chdir(tmp_path)
    return lambda command, *arguments: call(commands[command], capsys, *arguments)


def test_no_node_is_told_in_a_line(empty_domain, run, tmp_path):
    code, out, err = run("init")
    assert (code, out) == (2, "")
    assert err.startswith("error: no node with parameters found in 5 s in domain ")
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_an_idle_node_is_told_in_a_line(empty_domain, run, tmp_path):
    """The items of an array are known from messages only."""

    def idle(context):
        node = Node("idle", context=context)
        node.declare_parameter("gain", 1.0)
        node.create_publisher(JointState, "joint_states", 10)
        return node

    with at_work(idle):
        code, out, err = run("init")
    assert code == 2
    assert out == (
        "note: left out: /joint_states: silent for 1 s, so the items of its arrays are unknown\n"
        "nodes found: idle\n"
    )
    assert err == ("error: no topic has a number that could be a signal while the nodes are idle\n")
    assert not list(tmp_path.iterdir())


def test_without_a_terminal_the_suggestions_are_taken(servo, run, tmp_path):
    code, out, err = run("init")
    assert (code, err) == (0, "")
    assert "check study.yaml" in out
    study = load_study(tmp_path / "study.yaml")
    assert list(study.parameters) == ["gain"]
    assert study.parameters["gain"].default == servo.get_parameter("gain").value
    assert {(signal.topic, signal.field) for signal in study.signals.values()} == {
        ("/setpoint", "data"),
        ("/joint_states", "position[other]"),
        ("/joint_states", "position[motor]"),
        ("/plain", "data[0]"),
        ("/plain", "data[1]"),
        ("/limit", "data"),
    }
    assert study.run.start[0].publish.topic == "/setpoint"
    text = (tmp_path / "study.yaml").read_text()
    assert "# limited: {node: servo, type: double, bounds: [0.0, 2.0]," in text
    assert "# count: {node: servo, type: integer," in text
    assert "# serial of servo: read-only" in text
    assert "- call: {service: /servo/reset}" in text


def test_with_options_it_writes_a_study_that_passes_the_check(servo, run, tmp_path):
    code, _, err = run(
        *("init", "servo.yaml", "--nodes", "/servo", "--parameters", "servo:gain"),
        *("--signals", "/setpoint", "/joint_states:position[motor]"),
    )
    assert (code, err) == (0, "")
    study = load_study(tmp_path / "servo.yaml")
    assert (list(study.parameters), list(study.signals)) == (
        ["gain"],
        ["setpoint", "position_motor"],
    )
    code, out, err = run("check", "servo.yaml", "--no-sensitivity")
    assert (code, err) == (0, "")
    assert "the nodes match the study: 1 parameter and 2 signals" in out


def test_what_is_named_is_waited_for(servo, quick, tmp_path, capsys, monkeypatch):
    """A busy machine shows its nodes one by one."""
    monkeypatch.setattr("bo_tuner.backends.ros.survey.DISCOVERY", DEADLINE)
    monkeypatch.setattr("bo_tuner.backends.ros.survey.QUIET", 0.0)
    looks = []

    def look(tuner, named):
        seen, notes = _look(tuner, named)
        looks.append(seen)
        if len(looks) == 2:
            servo.declare_parameter("late", 1.0)
        return seen, notes

    monkeypatch.setattr("bo_tuner.backends.ros.survey._look", look)
    try:
        code, out, err = call(init, capsys, tmp_path / "study.yaml", "--parameters", "servo:late")
    finally:
        servo.undeclare_parameter("late")
    assert (code, err) == (0, "")
    assert len(looks) >= 3
    assert "nodes found: servo\n" in out
    assert list(load_study(tmp_path / "study.yaml").parameters) == ["late"]


def test_a_plant_whose_controller_is_not_there_is_not_tuned(capsys):
    """A simulator has noise, and hears a command that nobody gives yet."""
    names = ("vibration", "gyro_bias")
    simulator = SeenNode("sim", {name: Described("double", 0.1) for name in names})
    topics = (
        SeenTopic("/angle", "std_msgs/msg/Float64", {"data": 0.0}, ("sim",), ()),
        SeenTopic("/torque", "std_msgs/msg/Float64", {"data": 0.0}, (), ("sim",)),
    )
    offers = {"sim": parameter_offers(simulator)[0]}
    assert init._suggested_nodes(Seen((simulator,), topics), offers) == []
    assert capsys.readouterr().out.startswith("note: sim: a plant by its topics and parameters;")
    # One that closes a loop of its own, with gains, is tuned.
    closed = SeenNode("sim", simulator.parameters | {"kp": Described("double", 0.1)})
    offers = {"sim": parameter_offers(closed)[0]}
    assert init._suggested_nodes(Seen((closed,), topics), offers) == ["sim"]


class Lidar(Node):
    """Publishes 360 ranges, and an empty list; takes a trajectory, and an array."""

    def __init__(self, context):
        super().__init__("lidar", context=context)
        self.declare_parameter("kp", 1.0)
        self.declare_parameter("joints", ["left", "right"])
        scan = self.create_publisher(LaserScan, "scan", 10)
        state = self.create_publisher(JointState, "joint_states", 10)
        self.create_publisher(JointState, "silent", 10)
        self.create_subscription(JointTrajectory, "joint_trajectory", lambda _: None, 10)
        self.create_subscription(Float64MultiArray, "currents", lambda _: None, 10)
        self.create_timer(0.02, lambda: scan.publish(LaserScan(ranges=[2.0] * 360)))
        joints = JointState(name=["right", "left"], position=[0.25, -0.5])
        self.create_timer(0.02, lambda: state.publish(joints))


def test_an_item_of_a_long_or_silent_array_is_taken_by_its_name(empty_domain, run, tmp_path):
    """As by a study; of an array that the run is to publish, with all items before it."""
    names = (
        "/scan:ranges[17]",
        "/scan:min(ranges)",
        "/silent:position[elbow]",
        "/currents:data[2]",
    )
    with at_work(Lidar):
        code, _, err = run("init", "--signals", *names)
        assert (code, err) == (0, "")
        for name, problem in (
            ("/scan:ranges[360]", "a message has 360 items in ranges, none for [360]"),
            ("/scan:rangs[0]", "sensor_msgs/msg/LaserScan has no field 'rangs'; did you mean"),
            ("/scan:ranges[", "expected a field such as data, "),
        ):
            code, _, err = run("init", "no.yaml", "--signals", name)
            assert code == 2
            assert err.splitlines()[-1].startswith(f"error: --signals: {name}: {problem}")
    study = load_study(tmp_path / "study.yaml")
    assert [f"{s.topic}:{s.field}" for s in study.signals.values()] == list(names)
    assert study.run.before[0].publish.message == {"data": [0.0, 0.0, 0.0]}


def test_a_trajectory_starts_a_run(empty_domain, run, tmp_path):
    with at_work(Lidar):
        code, out, err = run("init")
        assert (code, err) == (0, "")
        code, out, err = run("check", "study.yaml")
    study = load_study(tmp_path / "study.yaml")
    (start,) = study.run.start
    assert start.publish.topic == "/joint_trajectory"
    assert start.publish.message["joint_names"] == ["left", "right"]
    assert start.publish.message["points"][0]["positions"] == [-0.4, 0.25]
    # Nothing there moves the joints, but the message is one that the node takes.
    assert "the nodes match the study: 1 parameter and 3 signals" in out
    assert not any(signal.topic == "/scan" for signal in study.signals.values())


def test_in_a_namespace_the_commands_that_follow_are_too(empty_domain, run, tmp_path):
    arguments = ("--ros-args", "-r", "__ns:=/left")

    def moved(context):
        node = Node("pid", context=context, namespace="/left")
        node.declare_parameter("kp", 1.0)
        node.declare_parameter("mass", 2.0, ParameterDescriptor(description="of the arm [kg]"))
        angle = node.create_publisher(Float64, "angle", 10)
        heard = []
        node.create_subscription(Float64, "setpoint", heard.append, 10)
        node.create_timer(0.01, lambda: angle.publish(heard[-1] if heard else Float64()))
        return node

    with at_work(moved):
        code, out, err = run("init", *arguments)
        assert (code, err) == (0, "")
        text = (tmp_path / "study.yaml").read_text()
        command = re.search("Then: (check .*)\n", text)[1]
        assert command in out
        check, *options = shlex.split(command)
        code, out, err = run(check, "--no-sensitivity", *options)
        assert (code, err) == (0, "")
    assert "\n#       tune --study study.yaml --attach --ros-args -r __ns:=/left\n" in text
    mass = "mass: {node: pid, distribution: uniform, bounds: [1.6, 2.4], nominal: 2.0, unit: kg}"
    assert f"#   {mass}  # CHECK: a guess, 20% around its value; of the arm [kg]\n" in text


def test_a_file_that_cannot_be_written(servo, quick, tmp_path, capsys, monkeypatch):
    path = tmp_path / "study.yaml"
    open_it = Path.open

    def refuse(file, *arguments, **options):
        if file == path:
            raise PermissionError(errno.EACCES, "Permission denied", str(file))
        return open_it(file, *arguments, **options)

    monkeypatch.setattr(Path, "open", refuse)
    code, _, err = call(init, capsys, path)
    assert code == 2
    assert err.splitlines()[-1] == f"error: {path}: cannot be written: Permission denied"


def test_an_action_is_offered(servo, quick, tmp_path, capsys):
    server = ActionServer(servo, Fibonacci, "count", lambda goal: Fibonacci.Result())
    try:
        code, _, err = call(init, capsys, tmp_path / "study.yaml")
    finally:
        server.destroy()
    assert (code, err) == (0, "")
    step = "- send_goal: {action: /count, goal: {}}  # test_msgs/action/Fibonacci: order (int32)"
    assert step in (tmp_path / "study.yaml").read_text()


def test_the_offers_of_a_node_that_is_not_tuned_have_their_node(servo, run, tmp_path):
    """Uncommented, its lines are a part of the study."""

    def other(context):
        node = Node("other", context=context)
        node.declare_parameter("offset", 2.0)
        return node

    with at_work(other):
        code, out, err = run(*("init", "--parameters", "servo:gain", "--signals", "/setpoint"))
    assert (code, err) == (0, "")
    assert "study.yaml: 1 parameter and 1 signal; 20 trials, at most " in out
    text = (tmp_path / "study.yaml").read_text()
    offered = re.sub(r"^  # (other: |offset: )", r"  \1", text, flags=re.MULTILINE)
    assert offered != text
    assert parse_study(offered).parameters["offset"].node == "other"


def test_a_text_that_is_named_is_not_offered(servo, run):
    code, _, err = run("init", "--parameters", "serial")
    assert code == 2
    assert err == "error: --parameters: serial of servo is not offered: read-only\n"


def test_a_node_that_runs_twice_is_named(servo, run, tmp_path, monkeypatch):
    write_servo(tmp_path)
    monkeypatch.setattr("bo_tuner.backends.ros.graph.LOOK_AROUND", 1.0)
    with at_work(lambda context: Node("servo", context=context)):
        code, _, err = run("check", "servo.yaml")
    assert code == 2
    assert "servo runs more than once in ROS domain " in err


def write_servo(folder):
    (folder / "servo.yaml").write_text(study_to_yaml(study()))
    return folder


def test_beside_a_tuner_values_are_those_of_a_trial(servo, run, tmp_path):
    domain = int(os.environ["ROS_DOMAIN_ID"])
    claim = DomainClaim("/", domain)
    try:
        code, out, err = run("init")
    finally:
        claim.release()
    assert (code, out) == (2, "")
    assert err.startswith(f"error: another tuner is running in ROS domain {domain}, namespace /; ")
    assert not list(tmp_path.iterdir())


def test_the_end_of_the_input_is_no_answer(servo, tmp_path):
    converse(
        [sys.executable, "-m", "bo_tuner", "init", "asked.yaml"],
        [("nodes: numbers", b"\x04")],
        code=2,
        cwd=tmp_path,
        env=environment(tmp_path, TERM="dumb"),
    )
    assert not list(tmp_path.iterdir())


def test_what_is_not_there_is_refused_with_the_nearest_name(
    servo, quick, tmp_path, capsys, monkeypatch
):
    # All that is there is found at once, and for what is not there nobody waits.
    monkeypatch.setattr("bo_tuner.cli.init._has", lambda *_: True)
    for option, name, near in (
        ("--nodes", "sevro", "servo"),
        ("--parameters", "gian", "gain"),
        ("--signals", "/joint_staets", "/joint_states"),
    ):
        code, _, err = call(init, capsys, tmp_path / "study.yaml", option, name)
        assert code == 2
        assert err == f"error: {option}: there is no '{name}'; did you mean '{near}'?\n"
    assert not list(tmp_path.iterdir())


def test_on_a_terminal_it_asks(servo, tmp_path):
    converse(
        [
            *(sys.executable, "-m", "bo_tuner"),
            *("init", "asked.yaml"),
            *("--signals", "/plain"),
        ],
        [
            ("nodes: numbers", b"\n"),
            ("parameters: numbers", b"9\n"),
            ("expected numbers from 1 to 3, found '9'", b"2-3\n"),
        ],
        cwd=tmp_path,
        env=environment(tmp_path, TERM="dumb"),
    )
    assert list(load_study(tmp_path / "asked.yaml").parameters) == ["count", "limited"]


def test_a_file_that_is_there_is_not_overwritten(run, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text("mine")
    code, out, err = run("init", "mine.yaml")
    assert (code, out) == (2, "")
    assert err == ("error: mine.yaml: already exists and is not overwritten; give another name\n")
    assert mine.read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("init", "mine"), "expected a file name that ends in .yaml, or a bag, found mine"),
        (("init", "none/mine.yaml"), "none/mine.yaml: there is no folder none"),
        (("init", "mine.yaml", "--no-attach"), "unrecognized arguments: --no-attach"),
        (("check", "benchmark", "--study", "full"), "unrecognized arguments: --study full"),
        (("check",), "the following arguments are required: STUDY"),
        (("check", "benchmark", "--trials", "0"), "--trials: expected an integer of at least 1"),
        (("check", "benchmark", "--bounds", "gain=2:1"), "--bounds: "),
        (("tune", "--nodes", "pid"), "unrecognized arguments: --nodes pid"),
    ],
)
def test_options_that_do_not_fit(run, arguments, expected):
    code, _, err = run(*arguments)
    assert code == 2
    assert expected in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (Float64(data=2.0), {"data": 2.0}),
        (Float64MultiArray(data=[1.0, 2.0]), {"data[0]": 1.0, "data[1]": 2.0}),
        (
            JointState(name=["a.b", "c"], position=[1.0, 2.0], velocity=[3.0]),
            {"position[a.b]": 1.0, "position[c]": 2.0, "velocity[0]": 3.0},
        ),
        (
            JointState(name=["1", "0"], position=[5.0, 6.0]),
            {"position[0]": 5.0, "position[1]": 6.0},
        ),
        (
            JointState(name=["a", "a"], position=[5.0, 6.0]),
            {"position[0]": 5.0, "position[1]": 6.0},
        ),
    ],
)
def test_the_numbers_in_a_message(message, expected):
    found = number_fields(message)
    assert {key: found.get(key) for key in expected} == expected
    for key, value in found.items():
        assert field_reader(type(message), parsed_field(key))(message) == value


def test_images_are_not_listened_to():
    """To send them costs a system that is at work."""
    assert [is_bulky(cls) for cls in (Image, PointCloud2, JointState, LaserScan)] == [
        True, True, False, False,
    ]  # fmt: skip
    assert number_arrays(Float64MultiArray) == ["data"]
    assert number_arrays(JointState) == ["position", "velocity", "effort"]
    assert number_arrays(Float64) == []


@pytest.mark.parametrize(
    ("given", "value", "expected"),
    [
        (FloatingPointRange(from_value=0.0, to_value=sys.float_info.max), 1.0, (0.0, math.inf)),
        (FloatingPointRange(from_value=-sys.float_info.max, to_value=2.0), 1.0, (-math.inf, 2.0)),
        (IntegerRange(from_value=1, to_value=2**63 - 1), 3, (1.0, math.inf)),
        (IntegerRange(from_value=-(2**63), to_value=9), 3, (-math.inf, 9.0)),
        (FloatingPointRange(from_value=0.0, to_value=1e6), 1.0, (0.0, 1e6)),
    ],
)
def test_the_largest_number_is_no_end_of_a_range(given, value, expected):
    """As of a limit on one side alone, which a descriptor cannot tell otherwise."""
    kind = "integer" if isinstance(given, IntegerRange) else "floating_point"
    descriptor = ParameterDescriptor(**{f"{kind}_range": [given]})
    found = _described(descriptor, Parameter("kp", value=value).to_parameter_msg().value)
    assert (found.lower, found.upper) == expected
    assert found.has_range == all(map(math.isfinite, expected))


def test_a_node_of_another_namespace_has_it_in_its_name():
    """Each robot of a fleet has a controller."""
    tuner = SimpleNamespace(node=SimpleNamespace(get_namespace=lambda: "/robot1"))
    ends = [
        SimpleNamespace(node_name="controller", node_namespace=namespace)
        for namespace in ("/robot1", "/robot2")
    ]
    assert _ends(tuner, ends) == ("/robot2/controller", "controller")


def test_nodes_of_one_process(empty_domain):
    """As of a container: the middleware has a participant for each process."""
    contexts = [Context(), Context()]
    nodes = []
    for context, names in zip(contexts, (("pid", "motor"), ("camera",)), strict=True):
        rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        nodes += [Node(name, context=context) for name in names]
    tuner, names = SimpleNamespace(node=nodes[0]), {"pid", "motor", "camera"}
    try:
        wait_until(
            lambda: len(nodes[0].get_publishers_info_by_topic("/parameter_events")) == 3, "all"
        )
        assert [*_together(tuner, names)] == [("motor", "pid")]
        assert [*_together(tuner, names - {"pid"})] == []
    finally:
        for node in nodes:
            node.destroy_node()
        for context in contexts:
            context.try_shutdown()


def test_a_type_that_is_here_and_cannot_be_used(monkeypatch):
    """As one that was built for another Python."""

    class Broken(type):
        _TYPE_SUPPORT = None

        @classmethod
        def __import_type_support__(cls):
            raise RuntimeError("no C extension\nfor this Python")

    module = ModuleType("broken_msgs.msg")
    module.Load = Broken("Load", (), {})
    monkeypatch.setitem(sys.modules, "broken_msgs", ModuleType("broken_msgs"))
    monkeypatch.setitem(sys.modules, "broken_msgs.msg", module)
    with pytest.raises(StudyError) as caught:
        interface_class("broken_msgs/msg/Load")
    assert str(caught.value).startswith(
        "type broken_msgs/msg/Load cannot be loaded: RuntimeError: "
    )
    assert "\n" not in str(caught.value)
    with pytest.raises(StudyError, match="type Load is not installed"):
        interface_class("Load")


def test_stamps_and_long_arrays_are_no_numbers_to_follow():
    pose = number_fields(PoseWithCovarianceStamped())
    assert set(pose) == {
        *(f"pose.pose.position.{axis}" for axis in "xyz"),
        *(f"pose.pose.orientation.{axis}" for axis in "xyzw"),
    }
    assert not any("ranges" in key for key in number_fields(LaserScan(ranges=[1.0] * 300)))


def test_numbers_that_are_chosen():
    assert numbers("1 3-5, 4", 5) == [1, 3, 4, 5]
    for text in ("0", "6", "2-1", "1-6", "x", "-", "1-", "²"):
        with pytest.raises(StudyError):
            numbers(text, 5)
