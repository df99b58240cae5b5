"""Nodes that are started by any command, restarted in a step, or killed in the middle of a run."""

import os
import re
import shutil
import signal
import sys
import threading
from functools import partial
from pathlib import Path

import pytest
from example_nodes import UNCHANGED, start_script
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.parameters.nodes import NodeParameters
from bo_tuner.backends.ros.signals import SignalRecorder
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.run_notes import Death
from bo_tuner.study.study_file import (
    load_study,
    parse_study,
    study_from_mapping,
    study_to_mapping,
    study_to_yaml,
)
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

KILLED = re.compile(
    r"pid was ended by SIGKILL; its last line is '.*\[pid\]: ready', see .*/pid\.log$"
)
TRIAL = {"kp": 2.0, "ki": 0.0, "kd": 0.375}


def command(node):
    return f"'{sys.executable}' '{UNCHANGED / f'{node}_node.py'}'"


def position(**changes):
    """The study of the example, with short runs and changes of `run` and `nodes`.

    Nodes may be slow here: a controller that gets no processor for a moment lets the motor run on,
    which ends no run.
    """
    mapping = study_to_mapping(load_study(str(UNCHANGED / "study.yaml")))
    for signal_of in mapping["signals"].values():
        signal_of["largest_gap"] = 5.0
    mapping["run"] = mapping["run"] | {"end": {"after": 0.5}} | changes.get("run", {})
    del mapping["run"]["abort_when"]
    mapping["nodes"] = changes.get("nodes", mapping["nodes"])
    mapping["park"] = changes.get("park", {})
    return study_from_mapping(mapping)


def run(backend):
    return backend.outcome(Evaluation(0, 0, Stage.DRAWN, TRIAL, {}, 1))


@pytest.fixture
def backend(tmp_path):
    """Function that opens a backend."""
    opened = []

    def make(study, attach=False, guard=False):
        opened.append(RosBackend(study, tmp_path, attach=attach, guard=guard))
        opened[-1].open()
        return opened[-1]

    yield make
    for made in opened:
        made.close()


@pytest.mark.parametrize("guard", [False, True])
def test_any_command_with_its_environment_and_a_restart_before_each_run(backend, tmp_path, guard):
    """Of nodes that come and go with the tuner a guard does not mind that they do."""
    nodes = {
        "pid": {"node": "pid", "command": command("pid"), "env": {"GREETING": "good day"}},
        "motor": {"node": "motor", "command": command("motor")},
    }
    before = [
        {"restart": "pid"},
        {"publish": {"topic": "/setpoint", "message": {"data": 0.0}}},
        {"call": {"service": "/motor/reset"}},
        {"wait": 0.1},
    ]
    made = backend(position(nodes=nodes, run={"before": before}), guard=guard)
    pids = []
    for _ in range(2):
        outcome = run(made)
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason
        pids.append(made._started.processes["pid"].pid)
    assert pids[0] != pids[1]
    environment = Path(f"/proc/{pids[1]}/environ").read_bytes().split(b"\0")
    assert b"GREETING=good day" in environment
    assert "ready" in (tmp_path / "motor.log").read_text()
    assert (tmp_path / "guard.log").exists() == guard
    assert not (tmp_path / "guard.jsonl").exists()


def test_commands_are_relative_to_the_study_file(backend, tmp_path, monkeypatch):
    """Wherever the tuner is called, and so does a run that is continued from elsewhere."""
    folder = tmp_path / "machine"
    shutil.copytree(UNCHANGED, folder)
    script = folder / "start_pid"
    script.write_text(f"#!/bin/sh\nexec '{sys.executable}' pid_node.py\n")
    script.chmod(0o755)
    nodes = {
        "pid": {"node": "pid", "command": "./start_pid"},
        "motor": {"node": "motor", "command": f"'{sys.executable}' motor_node.py"},
    }
    (folder / "study.yaml").write_text(study_to_yaml(position(nodes=nodes)))
    on_record = study_to_yaml(load_study(folder / "study.yaml"))
    monkeypatch.chdir("/")
    assert run(backend(parse_study(on_record))).state is EvaluationState.COMPLETE


def test_a_domain_that_was_found_is_not_taken_for_the_users(backend, monkeypatch):
    """The next backend in this process is to look for a free one again."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    nodes = {name: {"node": name, "command": command(name)} for name in ("pid", "motor")}
    made = backend(position(nodes=nodes))
    assert os.environ["ROS_DOMAIN_ID"] == str(made._claim.domain)
    made.close()
    assert "ROS_DOMAIN_ID" not in os.environ


def test_a_restart_of_several_nodes_brings_them_up_together(backend, tmp_path):
    """Each of them waits for the other one, as a simulator and its controller may."""
    os.mkfifo(tmp_path / "meeting")
    script = tmp_path / "both.py"
    script.write_text(
        "import os, sys\n"
        "way = {'pid': os.O_RDONLY, 'motor': os.O_WRONLY}[sys.argv[1]]\n"
        f"os.close(os.open('{tmp_path}/meeting', way))\n"
        f"node = f'{UNCHANGED}/{{sys.argv[1]}}_node.py'\n"
        "os.execv(sys.executable, [sys.executable, node])\n"
    )
    nodes = {
        name: {"node": name, "command": f"'{sys.executable}' '{script}' {name}"}
        for name in ("pid", "motor")
    }
    before = [
        {"restart": ["pid", "motor"]},
        {"publish": {"topic": "/setpoint", "message": {"data": 0.0}}},
        {"wait": 0.1},
    ]
    made = backend(position(nodes=nodes, run={"before": before}))
    first = {key: process.pid for key, process in made._started.processes.items()}
    outcome = run(made)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert all(made._started.processes[key].pid != pid for key, pid in first.items())


def test_a_restart_of_a_process_with_several_nodes(backend, tmp_path):
    """All of them have forgotten what they were told, not only the one that is named."""
    both = tmp_path / "both.py"
    both.write_text(
        "import signal, subprocess, sys\n"
        f"nodes = [subprocess.Popen([sys.executable, '{UNCHANGED}/' + name])\n"
        "         for name in ('pid_node.py', 'motor_node.py')]\n"
        "signal.signal(signal.SIGTERM, lambda *_: [node.terminate() for node in nodes])\n"
        "signal.signal(signal.SIGINT, lambda *_: [node.terminate() for node in nodes])\n"
        "sys.exit(max(node.wait() for node in nodes))\n"
    )
    nodes = {
        "motor": {"node": "motor", "command": f"{sys.executable} {both}"},
        "pid": {"node": "pid"},
    }
    before = [{"restart": "motor"}, {"publish": {"topic": "/setpoint", "message": {"data": 0.0}}}]
    made = backend(position(nodes=nodes, run={"before": [*before, {"wait": 0.1}]}))
    for _ in range(2):
        outcome = run(made)
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason


@pytest.fixture
def running(ros_environment, tmp_path, monkeypatch):
    """Function that starts a node of the example, which a backend may wait for."""
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", DEADLINE)
    started = []

    def start(node):
        log = tmp_path / f"{node}{len(started)}.txt"
        started.append(start_script(UNCHANGED / f"{node}_node.py", log))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.parametrize("signum", [signal.SIGKILL, signal.SIGTERM])
def test_a_controller_that_restarts_in_mid_run(running, backend, in_run, signum):
    """It has no result topic; with its own gains it goes on as if nothing had happened."""
    running("motor")
    pid = running("pid")
    made = backend(position(run={"end": {"after": 4.0}}), attach=True)

    def restart():
        pid.send_signal(signum)
        pid.wait()
        running("pid")

    in_run(made, restart)
    found = run(made)
    assert found.state is not EvaluationState.COMPLETE
    assert "pid" in found.reason.split(";")[0]
    assert "motor" not in found.reason.split(";")[0]
    # It is told its parameters again.
    assert any(run(made).state is EvaluationState.COMPLETE for _ in range(3))


def test_a_node_that_is_slow_to_hear_of_the_tuner_loses_no_message(running, backend, monkeypatch):
    """The tuner knows its publishers at once; the first run waits until it knows the tuner, too."""
    motor, _ = running("motor"), running("pid")
    connect, thawed = SignalRecorder.connect, threading.Event()

    def thaw():
        thawed.set()
        motor.send_signal(signal.SIGCONT)

    def frozen(*arguments):
        motor.send_signal(signal.SIGSTOP)
        connect(*arguments)
        threading.Timer(0.5, thaw).start()

    monkeypatch.setattr(SignalRecorder, "connect", frozen)
    made = backend(position(), attach=True)
    assert thawed.is_set()
    outcome = run(made)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason


def test_a_node_that_ends_in_mid_run_is_started_anew_and_the_machine_parked(
    backend, in_run, monkeypatch
):
    renewed, read_anew = [], NodeParameters.read_anew

    def noted(self, key):
        renewed.append(key)
        return read_anew(self, key)

    monkeypatch.setattr(NodeParameters, "read_anew", noted)
    nodes = {
        "pid": {"node": "pid", "command": command("pid")},
        "motor": {"node": "motor", "command": command("motor")},
    }
    made = backend(position(nodes=nodes, run={"end": {"after": 2.0}}))
    pid = made._started.processes["pid"].pid
    renewed.clear()
    in_run(made, partial(os.kill, pid, signal.SIGKILL))
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert KILLED.match(found.reason)
    # What they declare then is no change by others, also if it becomes known late.
    assert sorted(renewed) == ["motor", "pid"]
    assert run(made).state is EvaluationState.COMPLETE


@pytest.mark.parametrize("death", ["failure", "ignore"])
def test_what_it_means_that_a_node_ends_in_mid_run(backend, in_run, death):
    """Under a guard, too, which does not mind what the tuner has started."""
    nodes = {
        "pid": {"node": "pid", "command": command("pid"), "death": death},
        "motor": {"node": "motor", "command": command("motor")},
    }
    made = backend(position(nodes=nodes, run={"end": {"after": 2.0}}), guard=True)
    in_run(made, partial(os.kill, made._started.processes["pid"].pid, signal.SIGKILL))
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert found.notes.death == Death("pid", anyway=death == "ignore")
    # With the values of no test run it is nobody's death.
    pid = made._started.processes["pid"]
    os.kill(pid.pid, signal.SIGKILL)
    wait_until(lambda: pid.exit_reason is not None, "its end")
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert found.notes.death is None
    assert run(made).state is EvaluationState.COMPLETE


@pytest.mark.parametrize("between_runs", [False, True])
def test_a_node_that_ends_while_a_run_is_prepared(backend, monkeypatch, between_runs):
    """With the safe values in force it is nobody's death."""
    nodes = {
        "pid": {"node": "pid", "command": command("pid")},
        "motor": {"node": "motor", "command": command("motor")},
    }
    park = {"between_runs": between_runs}
    made = backend(position(nodes=nodes, run={"before": [{"wait": 5.0}]}, park=park))
    prepare, pid = made._procedure.prepare, made._started.processes["pid"].pid

    def killed():
        os.kill(pid, signal.SIGKILL)
        prepare()

    monkeypatch.setattr(made._procedure, "prepare", killed)
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert KILLED.match(found.reason)
    assert found.notes.death == (None if between_runs else Death("pid"))


def test_a_node_that_dies_of_what_is_not_finite_has_failed_at_once(backend, tmp_path):
    script = tmp_path / "motor.py"
    text = (UNCHANGED / "motor_node.py").read_text()
    publish = "        self._states.publish(message)\n"
    assert publish in text
    script.write_text(
        text.replace(
            publish,
            "        if self._angle > 0.1:\n"
            "            message.position = [math.nan]\n"
            f"    {publish}"
            "            __import__('time').sleep(0.3)\n"
            "            raise SystemExit('diverged')\n"
            f"{publish}",
        )
    )
    nodes = {
        "pid": {"node": "pid", "command": command("pid")},
        "motor": {"node": "motor", "command": f"'{sys.executable}' '{script}'"},
    }
    made = backend(position(nodes=nodes, run={"end": {"after": 2.0}}))
    found = run(made)
    assert found.state is EvaluationState.FAILED
    assert " is nan at " in found.reason


def test_a_node_that_takes_longer_to_start_than_it_may(backend):
    nodes = {
        "pid": {"node": "pid", "command": "sleep 1000", "start_timeout": 0.5},
        "motor": {"node": "motor", "command": command("motor")},
    }
    with pytest.raises(BackendError) as caught:
        backend(position(nodes=nodes))
    assert "it had 0.5 s (nodes.pid.start_timeout); pid runs" in str(caught.value)


def test_a_node_that_ends_in_a_pause_is_not_parked_and_started_anew_for_the_next_run(backend):
    """As one that hung, and was killed for that."""
    nodes = {
        "pid": {"node": "pid", "command": command("pid")},
        "motor": {"node": "motor", "command": command("motor")},
    }
    made = backend(position(nodes=nodes))
    pid = made._started.processes["pid"]
    os.kill(pid.pid, signal.SIGKILL)
    wait_until(lambda: pid.exit_reason is not None, "its end")
    (problem,) = made.park()
    assert problem.startswith("pid is not parked: pid does not answer ")
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert KILLED.match(found.reason)
    assert run(made).state is EvaluationState.COMPLETE
    assert made.park() == []


@pytest.mark.parametrize(
    ("nodes", "run_changes", "attach", "complaint"),
    [
        ({"pid": {"node": "pid", "command": "no_such_program -x"}}, {}, False,
         "nodes.pid.command: there is no program no_such_program"),
        ({"pid": {"node": "pid"}}, {}, False, "nodes.pid: no package and executable; add them, or"),
        ({"pid": {"node": "pid"}}, {"before": [{"restart": "pid"}]}, True,
         "run.before[0].restart: pid is attached; only a node that the tuner has started can be"),
    ],
)  # fmt: skip
def test_nodes_that_cannot_be_started(running, backend, nodes, run_changes, attach, complaint):
    if attach:
        running("motor")
        running("pid")
    with pytest.raises(StudyError) as caught:
        backend(position(nodes=nodes, run=run_changes), attach=attach)
    assert str(caught.value).startswith(complaint)


def test_a_launch_file_needs_a_ros_installation(backend, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert shutil.which("ros2") is None
    nodes = {"pid": {"node": "pid", "launch": "my_robot bringup.launch.py"}}
    with pytest.raises(StudyError) as caught:
        backend(position(nodes=nodes))
    assert str(caught.value).startswith("nodes.pid.launch: there is no 'ros2 launch' here; source")


def test_a_launch_file_is_started_by_ros2_launch(backend, monkeypatch, tmp_path):
    """A program of the test stands in for the installation: it starts both nodes."""
    ros2 = tmp_path / "bin" / "ros2"
    ros2.parent.mkdir()
    ros2.write_text(
        f"#!/bin/sh\necho \"$@\" > '{tmp_path}/arguments'\n{command('motor')} &\n{command('pid')}\n"
    )
    ros2.chmod(0o755)
    monkeypatch.setenv("PATH", f"{ros2.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr("sys.prefix", str(tmp_path / "none"))
    nodes = {
        "pid": {"node": "pid", "launch": "my_robot bringup.launch.py gains:='a b'"},
        "motor": {"node": "motor"},
    }
    made = backend(position(nodes=nodes))
    assert (tmp_path / "arguments").read_text() == "launch my_robot bringup.launch.py gains:=a b\n"
    assert run(made).state is EvaluationState.COMPLETE
