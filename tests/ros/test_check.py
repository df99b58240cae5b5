"""`check` on running nodes: every mistake at once, then two runs of the default."""

import contextlib
import itertools
import json
import re
import shutil
import sys
from pathlib import Path

import pytest
from commands import Fork, finish
from example_nodes import UNCHANGED
from in_process import call
from node_threads import at_work
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from std_msgs.msg import Float64
from waiting import DEADLINE

from bo_tuner.backends.ros import others, preparation, publication, steps
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.cli import check as check_command
from bo_tuner.cli.test_runs import spread
from bo_tuner.errors import BackendError
from bo_tuner.study.study_file import load_study, study_to_mapping

pytestmark = pytest.mark.ros


class Servo(Node):
    """Approaches /setpoint by `gain` at 100 Hz."""

    def __init__(self, context):
        super().__init__("servo", context=context)
        span = [FloatingPointRange(from_value=0.0, to_value=0.9)]
        self.declare_parameter("gain", 0.25, ParameterDescriptor(floating_point_range=span))
        self.declare_parameter("model", "a", ParameterDescriptor(read_only=True))
        self.declare_parameter("filter", True)
        self.declare_parameter("weights", [1.0, 2.0])
        self.angle = self.setpoint = 0.0
        self.starts = itertools.repeat(0.0)
        self.angles = self.create_publisher(Float64, "angle", 10)
        self.speeds = self.create_publisher(Float64, "speed", 10)
        self.create_subscription(Float64, "setpoint", self.follow, 10)
        self.create_timer(0.01, self.step)

    def follow(self, message):
        self.setpoint, self.angle = message.data, next(self.starts)
        self.speeds.publish(Float64(data=self.setpoint))

    def step(self):
        self.angle += self.get_parameter("gain").value * (self.setpoint - self.angle)
        self.angles.publish(Float64(data=self.angle))


@pytest.fixture(scope="module")
def servo():
    with at_work(Servo) as node:
        yield node


def write_study(tmp_path, **changes):
    node = {"node": "servo"}
    sections = {
        "parameters": {
            "gain": node,
            "filter": node,
            "weights[1]": node | {"bounds": [0.0, 4.0]},
        },
        "signals": {
            "angle": {"topic": "/angle", "field": "data"},
            "setpoint": {"topic": "setpoint", "field": "data"},
        },
        "run": {
            "start": [{"publish": {"topic": "/setpoint", "message": {"data": 1.0}}}],
            "end": {"when": "t > 0.3"},
        },
    }
    for section, items in changes.items():
        sections[section] = sections.get(section, {}) | items if isinstance(items, dict) else items
    mapping = {
        "name": "servo",
        "nodes": {"servo": node},
        "metrics": {"error": {"of": "setpoint - angle", "measure": "iae"}},
        "objective": {"metric": "error"},
        "budget": {"trials": 3, "initial_trials": 2, "drawn_contexts": 1, "validation_draws": 2},
    }
    (tmp_path / "servo.yaml").write_text(json.dumps(mapping | sections))


@pytest.fixture
def study(servo, tmp_path, capsys, monkeypatch):
    """Function that checks a study of the servo without what `test_parameter_runs` is about."""
    # Nobody else is in the domain, and what runs in this process is discovered at once.
    for module in ("graph", "bringup"):
        monkeypatch.setattr(f"bo_tuner.backends.ros.{module}.LOOK_AROUND", 0.1)

    def check(*options, **changes):
        write_study(tmp_path, **changes)
        return call(check_command, capsys, tmp_path / "servo.yaml", "--no-sensitivity", *options)

    return check


def test_noise_of_a_study_that_declares_none(study):
    """No two runs on the clock of a machine have the same error."""
    code, _, err = study(noise="none")
    assert code == 3
    assert "error: the study declares noise: none, but error was " in err
    assert "in two runs of the same parameter set in the same context (seeds " in err


def test_a_study_that_is_right(servo, study, tmp_path):
    """Bounds, types, defaults and the array come from the node, which is left as it was.

    Not even safe values stay, as they do after a run.
    """
    code, out, err = study(park={"parameters": {"gain": 0.5}, "between_runs": True})
    assert (code, err) == (0, "")
    assert "the nodes match the study: 3 parameters and 2 signals" in out
    assert "metrics of the default" in out
    assert "█" in out
    assert "…" not in out, "no number is cut off in a terminal of 80 columns"
    # Three trials of a draw, 10 runs in the check of an answer, and two sides in two draws.
    assert "study: at most 17 test runs, about" in out
    # Without a limit on the worst case there is no search for it.
    assert "certificate: probably 30 test runs, about" in out
    assert "if the result passes by a usual margin; at least 30, at most 1000, about" in out
    assert "violations" in out
    assert "note: parameters" not in out
    assert "does not keep" not in out
    assert servo.get_parameter("gain").value == 0.25
    assert list(servo.get_parameter("weights").value) == [1.0, 2.0]
    assert not (tmp_path / "runs").exists()


def test_limits_and_noise_that_ask_for_a_look(servo, study):
    """What the default does not keep, also below a limit, and runs that do not begin alike."""
    limit = {"kind": "worst_case", "metric": "error", "upper": 0.001}
    servo.starts = itertools.cycle([0.0, 0.9])
    try:
        code, out, err = study(
            *("--attach", "--trials", "2"),
            signals={
                "angle": {"topic": "/angle", "field": "data"},
                "setpoint": {"topic": "setpoint", "field": "data"},
                "speed": {"topic": "/speed", "field": "data"},
            },
            constraints={"error": limit, "room": limit | {"upper": 0.3}},
        )
    finally:
        servo.starts = itertools.repeat(0.0)
    assert (code, err) == (0, "")
    assert "note: the initial design takes all of the 2 trials; none is proposed" in out
    assert "2 of 2" in out
    assert "note: error: the default does not keep ≤ 0.001" in out
    assert re.search(r"note: error: differs by [0-9.]+ between runs of the same parameters", out)
    # So may others, which nobody has sent before the first test.
    assert "note: speed: has a value at the start of run 2 and none at that of " in out


def test_a_limit_relative_to_the_default_takes_a_second_run(study):
    """The default, which the check runs, needs none beside it."""
    calm = {"kind": "chance", "metric": "error", "upper": "1.1 * default", "probability": 0.9}
    code, out, err = study(constraints={"calm": calm})
    assert code == 0, err
    assert "error_minus_1.1_default" in out
    said = "note: limits are relative to the default, which is run beside each test run"
    assert said in " ".join(out.split())


def test_a_machine_that_warms_up_and_rests_takes_longer(study):
    code, out, err = study(run={"warm_up": 2, "rest": 3})
    assert code == 0, err
    assert re.search(r"^2 runs to warm up took [\d.]+ s: once for each command$", out, re.MULTILINE)
    rested = re.search(r"^the machine rested ([\d.]+) s ahead of one, which counts$", out, re.M)
    # 3 s from the end of a run on, of which setting parameters back takes a part.
    assert 0.0 < float(rested[1]) < 3.5


@pytest.mark.parametrize(
    ("run", "often"),
    [
        ({"ramp": 0.5}, "once for each parameter set"),
        ({"ramp": 0.5, "rest": 0.1}, "twice for each test run"),
    ],
)
def test_ramps_are_counted(study, run, often):
    code, out, err = study(run=run)
    assert code == 0, err
    assert f"a ramp takes 0.5 s, {often}, which counts" in out


def test_names_of_contexts_constants_and_the_seed_are_checked_too(servo, study):
    spread = {"distribution": "uniform", "bounds": [0.0, 0.5]}
    code, _, err = study(
        nodes={"servo": {"node": "servo", "parameters": {"fliter": True}}},
        contexts={"gian": {"node": "servo"} | spread},
        seed_parameter={"node": "servo", "parameter": "seed"},
    )
    assert code == 2
    *errors, count = err.splitlines()
    assert count == "3 problems found; nothing was set"
    for path, name, near in (
        ("nodes.servo.parameters", "fliter", "did you mean 'filter'?"),
        ("contexts.gian", "gian", "did you mean 'gain'?"),
        ("seed_parameter", "seed", "expected one of "),
    ):
        text = f"error: {path}: the node has no parameter '{name}'; {near}"
        assert sum(line.startswith(text) for line in errors) == 1, err


def test_a_run_that_is_refused_leaves_no_folder(servo, tmp_path):
    """Neither what it held nor the tuner's own log is worth one."""
    spread = {"distribution": "uniform", "bounds": [0.0, 0.5]}
    write_study(tmp_path, contexts={"gian": {"node": "servo"} | spread})
    code, _, err = finish(Fork("tune", "--study", "servo.yaml", "--attach", folder=tmp_path))
    assert code == 2
    assert "gian" in err
    assert list((tmp_path / "runs").iterdir()) == []


def test_a_run_that_sends_nothing(study):
    _, out, _ = study(run={"start": []})
    assert "note: run.start: missing, so nothing sends a reference" in out


def test_nodes_that_were_not_started(empty_domain, tmp_path):
    """In a domain without others, one line for each node says what to do."""
    write_study(tmp_path)
    code, _, err = finish(Fork("check", "servo.yaml", folder=tmp_path))
    assert code == 2
    assert err.splitlines() == [
        f"error: servo: no such node in ROS domain {empty_domain}; no other node runs there: "
        "start yours, or set their ROS_DOMAIN_ID"
    ]


@pytest.fixture
def node_in_cell(empty_domain):
    with at_work(lambda context: Node("controller", context=context, namespace="cell")) as node:
        yield node


@pytest.mark.parametrize(
    ("namespace", "name", "full", "meant"),
    [
        ("/", "cell/contrler", "cell/contrler", "cell/controller"),
        ("/", "controller", "controller", "cell/controller"),
        ("/cell", "cell/controller", "/cell/cell/controller", "controller"),
        ("/hall", "controller", "/hall/controller", "/cell/controller"),
    ],
)
def test_the_name_that_is_meant_is_that_of_a_study(
    node_in_cell, empty_domain, namespace, name, full, meant
):
    """It is relative to the namespace of the tuner, as far as the node is in it."""
    tuner = TunerNode(None, ["--ros-args", "-r", f"__ns:={namespace}"], lambda: None)
    with contextlib.closing(tuner):
        assert tuner.wait_until(lambda: others.nodes(tuner.node) == [meant], DEADLINE)
        assert others.absent([meant, name], tuner.node) == (
            f"{full}: no such node in ROS domain {empty_domain}; did you mean '{meant}'?"
        )
        # It has no services for its parameters yet, or none at all.
        assert others.absent([meant], tuner.node).endswith(
            "controller: found, but not with all services and topics that are needed"
        )


def test_every_mistake_is_named_at_once(study):
    node = {"node": "servo"}
    code, out, err = study(
        parameters={
            "gain": node | {"type": "double", "bounds": [0.0, 2.0], "default": 0.6},
            "gian": node | {"type": "double", "fixed": 1.0},
            "model": node | {"type": "string", "fixed": "b"},
            "filter": node | {"type": "integer", "fixed": 1},
        },
        signals={
            "angle": {"topic": "/angle", "field": "dat"},
            "torque": {"topic": "/torque", "field": "data"},
        },
    )
    assert code == 2
    assert sorted(err.splitlines()) == sorted(
        [
            "error: parameters.gain: 2 lies outside the range of 'gain' in the node, [0, 0.9]",
            "error: parameters.gian: the node has no parameter 'gian'; did you mean 'gain'?",
            "error: parameters.model: 'model' is read-only in the node",
            "error: parameters.filter: 'filter' is of type boolean in the node, not integer",
            *[line for line in err.splitlines() if "signals." in line],
            "6 problems found; nothing was set",
        ]
    )
    assert "error: signals.angle.field: std_msgs/msg/Float64 has no field 'dat'" in err
    assert "error: signals.torque.topic: nothing publishes /torque" in err
    # What a node will not take at all needs no word on the value that it has now.
    assert "note: parameters." not in out


def test_mistakes_in_the_run_are_named_with_the_others(servo, tmp_path, monkeypatch, capsys):
    """One for each kind of step, beside a mistake in a signal."""
    # What is there is known by now; what is not is waited for, one after the other.
    for module in (preparation, publication, steps):
        monkeypatch.setattr(module, "CONNECT_TIMEOUT", 1.0)
    write_study(
        tmp_path,
        signals={"torque": {"topic": "/torque", "field": "data"}},
        run={
            "before": [
                {"call": {"service": "/servo/reset"}},
                {"lifecycle": {"node": "/servo", "transition": "activate"}},
                {"restart": "servo"},
            ],
            "start": [
                {"publish": {"topic": "/setpiont", "message": {"data": 1.0}}},
                {"publish": {"topic": "/setpoint", "message": {"dat": 1.0}}},
                {"send_goal": {"action": "/turn"}},
            ],
            "clock": "sim",
        },
    )
    code, _, err = call(check_command, capsys, tmp_path / "servo.yaml")
    assert code == 2
    *lines, count = err.splitlines()
    assert count == "8 problems found; nothing was set"
    for text in (
        "signals.torque.topic: nothing publishes /torque",
        "run.clock: nothing publishes /clock",
        "run.before[0].call.service: there is no service /servo/reset",
        "run.before[1].lifecycle.node: there is no lifecycle node /servo",
        "run.before[2].restart: servo is attached",
        "run.start[0].publish.topic: nothing subscribes to /setpiont; did you mean '/setpoint'?",
        "run.start[1].publish.message.dat: std_msgs/msg/Float64 has no field 'dat'",
        "run.start[2].send_goal.action: there is no action /turn",
    ):
        assert sum(line.startswith(f"error: {text}") for line in lines) == 1, text


def test_a_node_that_is_not_set_back_is_told(servo, tmp_path, monkeypatch, capsys):
    close = RosBackend.close

    def refuse(backend):
        close(backend)
        raise BackendError("servo could not be restored: servo does not answer")

    monkeypatch.setattr(RosBackend, "close", refuse)
    write_study(tmp_path)
    code, out, err = call(check_command, capsys, tmp_path / "servo.yaml", "--no-sensitivity")
    assert code == 1
    assert err.splitlines()[-1] == "error: servo could not be restored: servo does not answer"
    assert "metrics of the default" in out


def test_a_node_that_is_not_there(study):
    code, _, err = study(parameters={"kp": {"node": "pid"}})
    assert code == 2
    assert "there is no node 'pid'" in err


def test_a_machine_that_does_not_move(servo, study):
    """Without a gain the servo follows nothing, in both runs."""
    servo.angle = servo.setpoint = 0.0
    gain = {"node": "servo", "type": "double", "bounds": [0.0, 0.9], "default": 0.0}
    code, out, err = study(parameters={"gain": gain})
    assert code == 3
    assert err.startswith("error: nothing moves: angle did not change in 2 runs; see that the ")
    assert "metrics of the default" in out


def test_runs_that_begin_where_the_last_one_was(servo, study):
    """The servo begins again only when it is told a set-point; what was before is in the signal."""
    servo.angle = servo.setpoint = 0.0
    # A busy computer may hear of the angle only after the start.
    heard = [{"wait_until": {"condition": "angle > -1", "hold": 0, "timeout": 10.0}}]
    code, out, err = study(run={"before": heard, "end": {"when": "t > 0.3"}})
    assert (code, err) == (0, "")
    said = r"note: angle: is (1|0\.99\d*) at the start of run 2 and 0 at that of run 1: the "
    assert re.search(said, out), out


@pytest.fixture
def started(tmp_path):
    """Function that writes a study of a motor and its controller, which it starts, with changes."""
    scripts = {key: shutil.copy(UNCHANGED / f"{key}_node.py", tmp_path) for key in ("pid", "motor")}

    def make(**changes):
        mapping = study_to_mapping(load_study(str(UNCHANGED / "study.yaml")))
        # A node that gets no processor for a moment fails no run.
        for spec in mapping["signals"].values():
            spec.pop("largest_gap", None)
        del mapping["run"]["abort_when"]
        mapping["nodes"] = {
            key: {"node": key, "command": f"'{sys.executable}' '{script}'"}
            for key, script in scripts.items()
        }
        for section, items in changes.items():
            mapping[section] |= items
        (tmp_path / "study.yaml").write_text(json.dumps(mapping))

    return make


def check(folder, *options):
    arguments = ("check", "study.yaml", "--no-sensitivity", *options)
    found = finish(Fork(*arguments, folder=folder))
    running = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if path.exists()]
    assert not [line for line in running if str(folder).encode() in line], "a node was left"
    return found


def test_a_study_that_starts_its_nodes(empty_domain, started, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    started()
    code, out, err = check(tmp_path)
    assert (code, err) == (0, "")
    assert out.startswith("no node of the study is running: the check starts them, and ends them\n")
    assert "the nodes match the study: 3 parameters and 3 signals" in out
    assert "metrics of the default" in out
    assert list(tmp_path.glob("bo_tuner-check-*")) == []


def test_all_mistakes_in_a_study_that_starts_its_nodes(empty_domain, started, tmp_path):
    gain = {"node": "pid", "type": "double", "bounds": [0.1, 10.0], "default": 0.5}
    started(
        parameters={"kpp": gain},
        signals={"speed": {"topic": "/joint_states", "field": "velocity[arm]"}},
        run={"recover": [{"restart": "motor"}]},
    )
    code, _, err = check(tmp_path, "--no-attach")
    assert code == 2
    first, second, count = sorted(err.splitlines(), reverse=True)
    assert first.startswith("error: signals.speed.field: a message on /joint_states has no ")
    assert second == "error: parameters.kpp: the node has no parameter 'kpp'; did you mean 'kp'?"
    assert count == "2 problems found; nothing was set"


def test_what_a_started_node_has_printed_can_be_read(empty_domain, started, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    started(
        nodes={"pid": {"node": "pid", "command": f"'{sys.executable}' -c 'exit(\"no motor\")'"}}
    )
    code, _, err = check(tmp_path)
    assert code == 2
    (folder,) = tmp_path.glob("bo_tuner-check-*")
    where, why = err.splitlines()
    assert where == f"what the nodes have printed is in {folder}"
    said = f"its last line is 'no motor', see {folder / 'pid.log'}"
    assert why == f"error: pid ended with exit code 1; {said}"
    assert (folder / "pid.log").read_text() == "no motor\n"


def test_nodes_that_run_already_are_not_started(study):
    nodes = {"servo": {"node": "servo", "command": "no_such_program"}}
    code, out, err = study(nodes=nodes)
    assert (code, err) == (0, "")
    assert "starts them" not in out


def test_one_value_of_a_metric_without_a_limit_does_not_differ():
    """As where the other run failed."""
    assert spread("error", [0.5], []) is None
    assert spread("error", [0.5, 0.7], []).width == pytest.approx(0.2)


@pytest.fixture
def mode(servo):
    """A parameter of the servo that the study does not vary."""
    yield servo.declare_parameter("mode", 3)
    servo.undeclare_parameter("mode")


STREAM = {
    "publish": {
        "topic": "/setpoint",
        "rate": 20,
        "largest_gap": 20.0,
        "profile": {"data": {"csv": {"file": "ref.csv", "column": "x"}}},
        "follow": {"data": "angle"},
    }
}


def test_a_stream_and_a_parameter_that_a_step_sets(servo, study, mode, tmp_path):
    """How regular the messages were is told, and the node is left as it was."""
    (tmp_path / "ref.csv").write_text("t,x\n0,0\n1,2\n")
    setting = {"set": {"node": "servo", "parameter": "mode", "value": 4}}
    run = {"start": [setting, STREAM], "after": [{"set": setting["set"] | {"value": 5}}]}
    code, out, err = study("--attach", run=run)
    assert (code, err) == (0, "")
    assert re.search(r"^stream on /setpoint: \d+ messages, \d+ left out, late by", out, re.M)
    assert servo.get_parameter("mode").value == 3


def test_mistakes_in_streams_and_in_parameters_that_steps_set(study, mode):
    setting = {"set": {"node": "servo", "parameter": "mode", "value": 1.5}}
    unheard = {"publish": {"topic": "/nobody", "rate": 20}}
    code, _, err = study("--attach", run={"start": [setting, unheard]})
    assert code == 2
    assert "run.start[0].set: 'mode' is of type integer in the node, not double" in err
    assert "run.start[1].publish.topic: nothing subscribes to /nobody" in err
    assert "nothing was set" in err
    code, _, err = study("--attach", run={"start": [STREAM]})
    assert code == 2
    assert err.count("\n") == 1
    assert "ref.csv: cannot be read: No such file" in err
