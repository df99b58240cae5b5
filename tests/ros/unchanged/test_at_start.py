"""Nodes that take parameters only while they start, or are configured, as most of rclpy do."""

import contextlib
import os
import re
import sys
from pathlib import Path

import pytest
import rclpy
import start_node
from commands import Fork, finish
from example_nodes import start_script
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import Float64
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.guard.link import LOG
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_from_mapping, study_to_mapping, study_to_yaml
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

NODE = Path(start_node.__file__)
SAFE = start_node.DEFAULT


def command(*words):
    return " ".join([f"'{sys.executable}'", f"'{NODE}'", *words])


def study(*words, node=None, run=None, **sections):
    """A study of the servo, which is at rest before each run; `used` is what it goes by."""
    servo = {"node": "servo", "command": command(*words), "at_start": True} | (node or {})
    publish = [
        {"publish": {"topic": "setpoint", "message": {"data": value}}} for value in (0.0, 1.0)
    ]
    mapping = {
        "name": "servo",
        "nodes": {"servo": {key: value for key, value in servo.items() if value is not None}},
        "parameters": {
            "gain": {"node": "servo", "type": "double", "bounds": [0.1, 4.0], "default": SAFE},
        },
        "signals": {
            "angle": {"topic": "angle", "field": "data", "largest_gap": 5.0},
            "used": {"topic": "used", "field": "data", "largest_gap": 5.0},
        },
        "run": {"before": publish[:1], "start": publish[1:], "end": {"when": "t > 0.3"}},
        "metrics": {
            "used": {"of": "used", "measure": "maximum"},
            "least": {"of": "used", "measure": "minimum"},
            "first": {"of": "angle", "measure": "minimum"},
            "last": {"of": "angle", "measure": "maximum"},
        },
        "objective": {"metric": "used"},
        "budget": {"trials": 4, "initial_trials": 2},
    }
    mapping["run"] |= run or {}
    return study_from_mapping(mapping | sections)


@pytest.fixture
def backend(tmp_path, monkeypatch):
    """Function that opens a backend; nodes may be slow here."""
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", DEADLINE)
    opened = []

    def make(study, **options):
        opened.append(RosBackend(study, tmp_path, **options))
        opened[-1].open()
        return opened[-1]

    yield make
    for made in opened:
        made.close()


@pytest.fixture
def running(ros_environment, tmp_path):
    """Function that starts a servo which a backend may attach to."""
    started = []

    def begin(*words):
        started.append(start_script(NODE, tmp_path / "running.txt", *words))

    yield begin
    for process in started:
        process.terminate()
        process.wait()


def run(backend, gain, **others):
    return backend.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": gain, **others}, {}, 1))


def complete(backend, gain, **others):
    outcome = run(backend, gain, **others)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    # All the time, and nothing of the process before.
    assert outcome.metrics["used"] == outcome.metrics["least"]
    return outcome


def pid_of(backend):
    return backend._started.processes["servo"].pid


def heard(topic="used"):
    """What is published on a topic of the domain now."""
    context, values = Context(), []
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = Node("listener", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    node.create_subscription(Float64, topic, lambda message: values.append(message.data), 1)
    wait_until(lambda: executor.spin_once(timeout_sec=0.1) or values, "a message")
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()
    return values[0]


def assign(node, **values):
    """Set parameters of a node, as by ``ros2 param set``."""
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    own = Node("somebody", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(own)
    client = AsyncParameterClient(own, node)
    assert client.wait_for_services(DEADLINE)
    future = client.set_parameters([Parameter(name, value=v) for name, v in values.items()])
    executor.spin_until_future_complete(future, DEADLINE)
    assert all(result.successful for result in future.result().results)
    executor.shutdown()
    own.destroy_node()
    context.try_shutdown()


@pytest.mark.parametrize("words", [(), ("lifecycle",)])
def test_a_node_runs_with_the_values_of_each_trial(backend, words):
    """It starts anew when they change; a lifecycle node is activated, as it was."""
    made = backend(study(*words))
    first = pid_of(made)
    assert complete(made, SAFE).metrics["used"] == SAFE
    assert pid_of(made) == first
    outcome = complete(made, 1.25)
    assert outcome.metrics["used"] == 1.25
    # A fresh process begins at rest, and its angle is not that of the last one.
    assert outcome.metrics["first"] < 0.5
    assert outcome.notes.starts == 1
    assert outcome.notes.start_seconds > 0.0
    second = pid_of(made)
    assert second != first
    assert complete(made, 1.25).notes.starts == 0
    assert pid_of(made) == second


def test_a_simulation_that_starts_with_the_values(backend):
    """Its time begins again, and the wait before each run is by the new one."""
    before = [{"publish": {"topic": "setpoint", "message": {"data": 0.0}}}, {"wait": 0.1}]
    made = backend(study("clock", run={"clock": "sim", "before": before}))
    for gain in (1.0, 2.0):
        outcome = complete(made, gain)
        assert outcome.metrics["used"] == gain
        # At rest, but for what comes between two ticks of its clock.
        assert outcome.metrics["first"] < 0.5


def test_values_that_act_at_any_time_need_no_start(backend):
    mass = {"node": "servo", "type": "double", "bounds": [0.5, 2.0], "default": 1.0}
    gain = {"node": "servo", "type": "double", "bounds": [0.1, 4.0], "default": SAFE}
    made = backend(study(node={"at_start": ["gain"]}, parameters={"gain": gain, "mass": mass}))
    first = pid_of(made)
    complete(made, SAFE, mass=1.5)
    assert pid_of(made) == first
    assert complete(made, 0.75, mass=1.5).metrics["used"] == 0.75
    assert pid_of(made) != first


@pytest.mark.parametrize("words", [("limited",), ("limited", "lifecycle")])
def test_a_node_that_does_not_start_with_the_values(backend, words):
    """That is the parameters' fault, and the next trial goes on."""
    made = backend(study(*words))
    outcome = run(made, 3.0)
    assert outcome.state is EvaluationState.FAILED
    if "lifecycle" in words:
        assert outcome.reason == "servo refused to configure; it was unconfigured"
    else:
        begin = "servo does not start with these parameters: servo ended with exit code 1; "
        assert outcome.reason.startswith(begin)
        assert "its last line is 'a gain of 3.0 is too high', see " in outcome.reason
    assert heard() == SAFE
    assert complete(made, 1.0).metrics["used"] == 1.0


def test_a_node_that_does_not_start_with_the_safe_values(backend):
    with pytest.raises(BackendError, match=r"^servo ended with exit code 1; .*servo.log$"):
        backend(study("limited", park={"parameters": {"gain": 3.0}}))


def test_a_node_that_hangs_while_it_starts(backend):
    made = backend(study("hangs", node={"start_timeout": 5.0}))
    outcome = run(made, 3.0)
    assert outcome.state is EvaluationState.LOST
    assert outcome.reason.startswith("servo does not answer servo/")
    assert complete(made, 1.0).metrics["used"] == 1.0


def test_a_node_that_takes_another_value_of_its_own_accord(backend):
    made = backend(study("clamps"))
    outcome = run(made, 3.0)
    assert outcome.state is EvaluationState.FAILED
    expected = "servo: parameter gain is 1.5, expected 3.0 (not taken by the node at its start)"
    assert outcome.reason == expected
    assert complete(made, 1.0).metrics["used"] == 1.0


def test_a_node_that_does_not_look_at_its_file(backend):
    made = backend(study("ignores"))
    # As it is without any file.
    complete(made, SAFE)
    with pytest.raises(StudyError) as caught:
        run(made, 1.0)
    assert str(caught.value) == (
        "nodes.servo.at_start: servo was started with gain 1.0 in its parameter file, and has "
        f"{SAFE}: a program must pass its arguments on to the node, or its line have "
        "{parameter_file} where the file goes"
    )


def test_safe_values_that_a_node_does_not_look_at(backend):
    with pytest.raises(StudyError, match=r"^nodes.servo.at_start: servo was started with gain 0.2"):
        backend(study("ignores", park={"parameters": {"gain": 0.25}}))


def test_a_node_that_does_not_declare_what_it_is_to_start_with(backend):
    gain = {"node": "servo", "type": "double", "bounds": [0.1, 4.0], "default": SAFE}
    parameters = {"gain": gain, "friction": gain}
    with pytest.raises(StudyError, match=r"friction 0.5 in its parameter file, and has not decl"):
        backend(study(parameters=parameters))


def test_after_a_run_that_failed_a_node_starts_with_the_safe_values(backend):
    """First it is told to stop: a new one, which is to be told, too, comes only later."""
    stop = [{"publish": {"topic": "setpoint", "message": {"data": -1.0}}}]
    made = backend(study(run={"abort_when": "angle > 0.5", "after": stop}))
    outcome = run(made, 3.0)
    assert outcome.state is EvaluationState.FAILED
    assert "angle" in outcome.reason
    assert heard() == SAFE
    wait_until(lambda: heard("angle") < -0.5, "the stop message")


def test_a_restart_before_each_run_has_the_values_of_the_trial(backend):
    before = [{"restart": "servo"}, {"publish": {"topic": "setpoint", "message": {"data": 0.0}}}]
    made = backend(study(run={"before": before}))
    first = complete(made, 1.0)
    second = complete(made, 1.0)
    assert first.metrics["used"] == second.metrics["used"] == 1.0
    assert second.metrics["first"] < 0.5


def test_a_node_that_is_parked_between_runs_knows_what_the_steps_before_have_said(backend):
    """It starts with the values of the trial only after them."""
    set_point = [{"publish": {"topic": "setpoint", "message": {"data": 1.0}}}]
    made = backend(study(run={"before": set_point, "start": []}, park={"between_runs": True}))
    outcome = complete(made, 2.0)
    assert outcome.metrics["used"] == 2.0
    assert outcome.metrics["last"] > 0.5
    assert heard() == SAFE


def test_values_go_ahead_of_all_that_the_nodes_own_file_says(backend, tmp_path, monkeypatch):
    """The last section that is of a node counts, and a file that comes later adds to an earlier."""
    own = tmp_path / "own.yaml"
    own.write_text(
        "servo: {ros__parameters: {gain: 3.5}}\n/**: {ros__parameters: {gain: 3.0, mass: 7.0}}\n"
    )
    program = tmp_path / "lib" / "a_package" / "servo"
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec {command()} "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    node = {
        "command": None,
        "package": "a_package",
        "executable": "servo",
        "parameter_file": own.name,
    }
    made = backend(study(node=node, folder=str(tmp_path)))
    assert complete(made, SAFE).metrics["used"] == SAFE
    assert complete(made, 1.0).metrics["used"] == 1.0
    assert made._client.parameters.known("servo")["mass"] == 7.0


def test_a_launch_file_passes_the_values_of_all_its_nodes_on(backend, tmp_path, monkeypatch):
    """A program of the test stands in for the installation: it starts both nodes."""
    ros2 = tmp_path / "bin" / "ros2"
    ros2.parent.mkdir()
    file = "--ros-args --params-file ${4#params:=}"
    ros2.write_text(f"#!/bin/sh\n{command('second')} {file} &\n{command()} {file}\n")
    ros2.chmod(0o755)
    monkeypatch.setenv("PATH", f"{ros2.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr("sys.prefix", str(tmp_path / "none"))
    (tmp_path / "own.yaml").write_text("/second: {ros__parameters: {gain: 3.5, mass: 7.0}}\n")
    launched = study(
        folder=str(tmp_path),
        nodes={
            "servo": {
                "node": "servo",
                "launch": "a_robot up.launch.py params:={parameter_file}",
                "at_start": True,
            },
            "second": {"node": "second", "at_start": True, "parameter_file": "own.yaml"},
        },
        parameters={
            name: {"node": node, "parameter": "gain", "type": "double", "bounds": [0.1, 4.0],
                   "default": SAFE}
            for name, node in (("gain", "servo"), ("other", "second"))
        },
        signals={
            name: {"topic": topic, "field": "data", "largest_gap": 5.0}
            for name, topic in (("angle", "angle"), ("used", "used"), ("of_other", "second/used"))
        },
        metrics={
            "used": {"of": "used", "measure": "maximum"},
            "least": {"of": "used", "measure": "minimum"},
            "other": {"of": "of_other", "measure": "maximum"},
        },
    )  # fmt: skip
    made = backend(launched)
    for gain, other in ((SAFE, SAFE), (1.0, 2.0), (1.0, 0.75)):
        metrics = complete(made, gain, other=other).metrics
        assert (metrics["used"], metrics["other"]) == (gain, other)
    assert made._client.parameters.known("second")["mass"] == 7.0


def in_braces(*words, **sections):
    """A study of a servo whose gain stands in its command; no node has it as a parameter."""
    gain = {"type": "double", "bounds": [0.1, 4.0], "default": SAFE}
    node = {"at_start": False, "env": {"MASS": "{mass}"}}
    mass = {"type": "double", "fixed": 2.0}
    return study(
        *words, "gain={gain}", node=node, parameters={"gain": gain, "mass": mass}, **sections
    )


def test_values_in_braces_in_what_starts_a_node(backend):
    """It starts anew when they change, and has the safe ones after a failed run."""
    made = backend(in_braces("limited"))
    first = pid_of(made)
    assert complete(made, SAFE).metrics["used"] == SAFE
    assert pid_of(made) == first
    assert complete(made, 1.25).notes.starts == 1
    second = pid_of(made)
    assert second != first
    assert complete(made, 1.25).metrics["used"] == 1.25
    assert pid_of(made) == second
    environment = Path(f"/proc/{second}/environ").read_bytes().split(b"\0")
    assert b"MASS=2.0" in environment
    refused = run(made, 3.0)
    assert refused.state is EvaluationState.FAILED
    assert "a gain of 3.0 is too high" in refused.reason
    assert heard() == SAFE


def test_an_attached_node_has_no_values_in_braces(running, backend):
    running()
    where = r"nodes\.servo\.command: servo is attached, and is not started with gain; leave out"
    with pytest.raises(StudyError, match=where):
        backend(in_braces(), attach=True)


def test_an_attached_node_cannot_be_started_with_values(running, backend):
    running()
    with pytest.raises(StudyError) as caught:
        backend(study(), attach=True)
    assert str(caught.value) == (
        "nodes.servo.at_start: servo is attached, and has no lifecycle; only a node that the tuner "
        "starts can be given values at its start: leave out --attach"
    )


def test_an_attached_lifecycle_node_is_configured_with_the_values(running, backend):
    """In the end it goes by what it had before, and is as it was."""
    running("lifecycle", "active")
    made = backend(study("lifecycle"), attach=True)
    assert complete(made, 1.0).metrics["used"] == 1.0
    assert complete(made, 2.0).metrics["used"] == 2.0
    made.close()
    assert heard() == SAFE


def test_a_lifecycle_node_can_be_configured_anew_in_place_of_a_start(backend):
    made = backend(study("lifecycle", node={"reconfigure": True}))
    first = pid_of(made)
    assert complete(made, 1.0).metrics["used"] == 1.0
    assert complete(made, 2.0).notes.starts == 1
    assert pid_of(made) == first


RELOAD = {"at_start": False, "reconfigure": [{"call": {"service": "servo/reload"}}]}


def test_values_come_into_force_by_steps_of_the_study(running, backend):
    """Parked between two runs, and in the end, it goes by what it had."""
    running("reload")
    parked = study("reload", node=RELOAD, park={"between_runs": True})
    made = backend(parked, attach=True)
    for gain in (1.0, 2.0):
        assert complete(made, gain).metrics["used"] == gain
        assert heard() == SAFE
    made.close()
    assert heard() == SAFE


def test_steps_that_say_no_fail_the_trial_and_not_the_next(running, backend):
    running("reload", "limited")
    made = backend(study("reload", node=RELOAD), attach=True)
    refused = run(made, 3.0)
    assert refused.state is EvaluationState.FAILED
    assert "a gain of 3.0 is too high" in refused.reason
    assert complete(made, 1.0).metrics["used"] == 1.0
    made.close()
    assert heard() == SAFE


TOO_HIGH = {"parameters": {"gain": 3.0}}


def test_safe_values_that_a_node_is_not_configured_with(backend):
    limited = study("lifecycle", "limited", node={"reconfigure": True}, park=TOO_HIGH)
    with pytest.raises(BackendError, match=r"^servo refused to configure"):
        backend(limited)


def test_safe_values_that_a_running_node_does_not_reload(running, backend):
    running("reload", "limited")
    made = backend(study("reload", node=RELOAD, park=TOO_HIGH), attach=True)
    (problem,) = made.park()
    assert problem.startswith("servo is not parked: ")
    assert problem.endswith("a gain of 3.0 is too high")
    with pytest.raises(BackendError, match="but not in force"):
        made.close()


def test_previous_values_that_a_node_does_not_take_at_the_end(running, backend):
    """Somebody had set them, and they were not in force then either."""
    running("reload", "limited")
    assign("servo", gain=3.0)
    made = backend(study("reload", node=RELOAD), attach=True)
    assert complete(made, 1.0).metrics["used"] == 1.0
    with pytest.raises(
        BackendError,
        match=r"servo has its previous parameters, but not in force: .*3\.0 is too high",
    ):
        made.close()


def test_safe_values_that_a_guard_cannot_bring_into_force(running, backend, tmp_path):
    running("reload", "limited")
    made = backend(study("reload", node=RELOAD, park=TOO_HIGH), attach=True, guard=True)
    guard = made._guard._wire._process
    guard.terminate()
    log = tmp_path / LOG
    wait_until(lambda: "too high" in log.read_text(), "its word")
    assert "servo is not safe: /servo/reload refused: a gain of 3.0 is too high" in log.read_text()
    guard.kill()
    with pytest.raises(BackendError, match="but not in force"):
        made.close()


def test_steps_that_nothing_performs(running, backend):
    running("reload")
    astray = [{"call": {"service": "servo/reloads"}}]
    with pytest.raises(
        StudyError, match=r"^nodes\.servo\.reconfigure\[0\]\.call\.service: there is"
    ):
        backend(study("reload", node=RELOAD | {"reconfigure": astray}), attach=True)


def test_a_node_without_the_services_of_a_manager(running, backend):
    running()
    where = r"^nodes\.servo\.reconfigure: "
    with pytest.raises(StudyError, match=where + "there is no service /controller_manager/list"):
        backend(study(node={"reconfigure": "controller_manager"}), attach=True)


def test_a_tuner_that_is_killed_leaves_a_node_reloaded(running, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    running("reload")
    guarded = study(
        "reload",
        node=RELOAD | {"command": None},
        run={"end": {"when": "t > 50"}, "timeout": 60.0},
        park={"parameters": {"gain": 0.25}},
    )
    (tmp_path / "servo.yaml").write_text(study_to_yaml(guarded))
    check = Fork("check", "servo.yaml", folder=tmp_path)
    wait_until(lambda: heard("angle") > 0.1, "a run", check)
    check.kill()
    check.communicate()
    wait_until(lambda: heard() == 0.25, "safe values in force")


def test_apply_brings_values_into_force_and_back(running, empty_domain, tmp_path):
    """Also where they read so already: what was read at the last reload cannot be told."""
    running("reload")
    mapping = study_to_mapping(study("reload", node=RELOAD | {"command": None}))
    mapping["metrics"]["off"] = {"of": "abs(used - 1.5)", "measure": "maximum"}
    mapping |= {"objective": {"metric": "off"}}
    mapping["budget"] |= {"drawn_contexts": 1, "validation_draws": 2}
    (tmp_path / "servo.yaml").write_text(study_to_yaml(study_from_mapping(mapping)))
    code, _, err = finish(Fork("tune", "--study", "servo.yaml", "--attach", folder=tmp_path))
    assert code == 0, err
    folder = (tmp_path / "runs" / "latest").resolve()
    gain = read_run(folder).result.parameters["gain"]
    assert heard() == SAFE
    for words, used in ((("--without-certificate",), gain), (("--rollback",), SAFE)):
        code, out, err = finish(Fork("apply", folder, "--yes", *words, folder=tmp_path))
        assert code == 0, err
        assert "in force: servo was configured anew" in " ".join(out.split())
        assert heard() == used


def test_nobody_starts_the_node(backend):
    nodes = {
        "servo": {"node": "servo", "at_start": True},
        "other": {"node": "other", "command": command("second")},
    }
    with pytest.raises(StudyError) as caught:
        backend(study(nodes=nodes))
    assert str(caught.value) == (
        "nodes.servo.at_start: the study does not say how the tuner starts servo with its values; "
        "add command, executable or launch, or put {parameter_file} into the command or launch "
        "that starts it along"
    )


def test_a_tuner_that_is_killed_leaves_an_attached_node_with_safe_values_in_force(
    running, tmp_path, monkeypatch
):
    """The guard has it configured anew: to set them would do nothing."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    running("lifecycle", "active")
    guarded = study(
        "lifecycle",
        run={"end": {"when": "t > 50"}, "timeout": 60.0},
        park={"parameters": {"gain": 0.25}},
    )
    (tmp_path / "servo.yaml").write_text(study_to_yaml(guarded))
    check = Fork("check", "servo.yaml", folder=tmp_path)
    wait_until(lambda: heard("angle") > 0.1, "a run", check)
    assert heard() == SAFE
    check.kill()
    check.communicate()
    wait_until(lambda: heard() == 0.25, "safe values in force")


def test_a_tuner_that_is_killed_while_a_node_starts_leaves_none(empty_domain, tmp_path):
    (tmp_path / "servo.yaml").write_text(study_to_yaml(study("hangs", start=[{"gain": 3.0}])))
    file = tmp_path / "runs" / "latest" / "log" / "servo.parameters.yaml"
    tune = Fork("tune", "--study", "servo.yaml", folder=tmp_path)
    wait_until(lambda: file.exists() and "gain: 3.0" in file.read_text(), "a start", tune)

    def nodes():
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                found.append(path.read_bytes())
        return [line for line in found if os.fsencode(tmp_path) in line and b"start_node" in line]

    wait_until(nodes, "the node", tune)
    tune.kill()
    tune.communicate()
    wait_until(lambda: not nodes(), "its end")


def test_a_check_tries_a_start_and_tells_what_it_costs(empty_domain, tmp_path):
    (tmp_path / "servo.yaml").write_text(study_to_yaml(study()))
    code, out, err = finish(Fork("check", "servo.yaml", folder=tmp_path))
    assert (code, err) == (0, "")
    said = r"^to start servo with other values took [\d.e-]+ s: once for each parameter set$"
    assert re.search(said, out, re.MULTILINE), out


def test_a_run_and_its_result(empty_domain, tmp_path):
    """Tuning, validation and report go by values that act; apply names the file to start with."""
    target = {"of": "abs(used - 1.5)", "measure": "maximum"}
    mapping = study_to_mapping(study())
    mapping["metrics"]["off"] = target
    mapping["objective"] = {"metric": "off"}
    mapping["budget"] |= {"drawn_contexts": 1, "validation_draws": 2}
    (tmp_path / "servo.yaml").write_text(study_to_yaml(study_from_mapping(mapping)))
    code, out, err = finish(Fork("tune", "--study", "servo.yaml", folder=tmp_path))
    assert code == 0, err
    folder = (tmp_path / "runs" / "latest").resolve()
    record = read_run(folder)
    for evaluation in record.evaluations:
        assert evaluation.outcome.metrics["used"] == evaluation.parameters["gain"]
    assert "starts of nodes with other values" in (folder / "report.html").read_text()
    code, out, err = finish(Fork("apply", folder, "--without-certificate", folder=tmp_path))
    assert code == 0, err
    text = " ".join(out.split())
    file = folder / "deploy" / "parameters.yaml"
    assert text.startswith("nothing was set on servo, which takes its parameters only while it s")
    assert f"--ros-args --params-file {file}" in text
    (gain,) = re.findall(r"gain: ([\d.]+)", file.read_text())
    assert float(gain) == record.result.parameters["gain"]
