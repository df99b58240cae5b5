"""A result set on real nodes, read back, refused, and taken back."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from unittest.mock import Mock

import pytest
import yaml
from commands import Fork, environment
from in_process import call
from made_runs import INITIAL, make_run, write_certificate
from node_threads import at_work
from rclpy.node import Node
from servo import System
from signal_runs import signal_study
from terminals import converse, gone
from waiting import DEADLINE, wait_until

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.backends.ros.parameters.messages import UnknownType
from bo_tuner.backends.ros.tuner_node import END_OTHERS
from bo_tuner.cli import apply as command
from bo_tuner.deploy.apply import ApplyError, NodeError, Way, set_values
from bo_tuner.deploy.live_parameters import LiveParameters
from bo_tuner.interruption import Interrupted
from bo_tuner.study.study_file import study_from_mapping, study_to_mapping

pytestmark = pytest.mark.ros

NAMES = ("control_horizon", "prediction_horizon", "lambda_mpc", "input_upper")


def make_study(**sections):
    """Tune the controller, and with it one parameter of the plant."""
    node = {"node": "controller"}
    mapping = {
        "name": "two_nodes",
        "nodes": {
            "plant": {
                "node": "milling_plant",
                "result": "~/cut_result",
                "object": "milling_plant.cut:MillingPlant",
            },
            "controller": {
                "node": "mpc_controller",
                "result": "~/cut_result",
                "object": "mpc_controller.controller:MpcController",
                "parameters": {"input_upper": 1.1},
                "inprocess_parameters": {"return_time": "modelled"},
            },
        },
        "parameters": {
            "window": {
                "node": "plant", "type": "integer", "bounds": [2, 9], "default": 5,
                "parameter": "overshoot_window", "unit": "samples",
            },
            "control_horizon": node | {"type": "integer", "bounds": [1, 20], "default": 15},
            "prediction_horizon": node | {"type": "integer", "tied_to": "control_horizon"},
            "lambda_mpc": node | {"type": "double", "bounds": [-5.0, 1.0], "default": -3.0},
        },
        "seed_parameter": {"node": "plant", "parameter": "seed"},
        "trigger": {"node": "plant", "service": "~/run_cut"},
        "metrics": {"tracking_error": {"node": "plant"}},
        "objective": {"metric": "tracking_error"},
        "seed": 4,
        "budget": INITIAL | {"trials": 2, "initial_trials": 2, "drawn_contexts": 1},
    }  # fmt: skip
    return study_from_mapping(mapping | sections)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """There is no other tuner to be discovered, but where a test says so."""
    monkeypatch.setattr("bo_tuner.deploy.live_parameters.LOOK_AROUND", 0.1)


def no_end():
    """Nobody asks for the end."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run with a certified result."""
    study = make_study()
    folder = tmp_path_factory.mktemp("apply") / "run"
    record = make_run(folder, study, InProcessBackend(study), result=1)
    write_certificate(record, record.trials[1])
    return record


@pytest.fixture
def record(made):
    """The same, as nobody has applied it yet."""
    for path in (made.path / "deploy").glob("*"):
        path.unlink()
    return made


@pytest.fixture
def now(client):
    """Function that reads what the two nodes run."""

    def read():
        values = dict(zip(NAMES, client.get_parameters("mpc_controller", NAMES), strict=True))
        (values["window"],) = client.get_parameters("milling_plant", ("overshoot_window",))
        return values

    return read


def tuned(record):
    return dict(record.trials[1].parameters) | {"input_upper": 1.1}


def apply(capsys, record, *arguments):
    return call(command, capsys, record.path, *arguments)


def rollback_file(record):
    values = yaml.safe_load((record.path / "deploy" / "rollback.yaml").read_text())
    sections = {node: section["ros__parameters"] for node, section in values.items()}
    controller = sections.pop("/**/mpc_controller")
    (plant,) = sections.values()
    return controller | {"window": plant["overshoot_window"]}


def test_set_and_back(client, record, now, capsys):
    """What was there before is neither the default nor the result."""
    client.set_parameters("mpc_controller", {"lambda_mpc": -2.25, "control_horizon": 7})
    before = now()
    code, out, err = apply(capsys, record, "--yes")
    assert (code, err) == (0, "")
    assert now() == tuned(record)
    assert rollback_file(record) == before
    assert "-2.25" in out
    assert f"apply {record.path} --rollback" in out.replace("\n", "")
    # Again: nothing to do, and the way back stays what it is.
    code, out, _ = apply(capsys, record)
    assert code == 0
    assert "already have these values" in out
    assert rollback_file(record) == before
    code, _, err = apply(capsys, record, "--rollback", "--yes")
    assert (code, err) == (0, "")
    assert now() == before
    assert rollback_file(record) == before


@pytest.fixture(scope="module")
def at_start(tmp_path_factory):
    """A run with a certified result, of a controller that takes parameters only at its start."""
    nodes = study_to_mapping(make_study())["nodes"]
    nodes["controller"]["at_start"] = ["lambda_mpc"]
    study = make_study(nodes=nodes)
    folder = tmp_path_factory.mktemp("apply") / "run"
    record = make_run(folder, study, InProcessBackend(study), result=1)
    write_certificate(record, record.trials[1])
    return record


def values_in(file):
    sections = yaml.safe_load(file.read_text())
    return sections["/**/mpc_controller"]["ros__parameters"]


def test_what_acts_only_at_a_start_is_not_set_but_its_file_named(client, at_start, now, capsys):
    """Nor is what else the node takes; what a file is named for is in it."""
    client.set_parameters("milling_plant", {"overshoot_window": 8})
    before, deploy = now(), at_start.path / "deploy"
    command = f"apply {at_start.path}"

    def said(out, file, option):
        return (
            "nothing was set on mpc_controller, which takes its parameters only while it starts: "
            f"restart it with --ros-args --params-file {deploy / file}, or first put them into its "
            f"own file: {command} {option} --write FILE"
        ) in " ".join(out.split())

    code, out, err = apply(capsys, at_start, "--yes")
    assert (code, err) == (0, "")
    assert now() == before | {"window": at_start.trials[1].parameters["window"]}
    assert said(out, "parameters.yaml", "--trial 1")
    expected = {k: v for k, v in tuned(at_start).items() if k != "window"}
    assert values_in(deploy / "parameters.yaml") == expected
    # Again, and another one.
    code, out, _ = apply(capsys, at_start)
    assert code == 0
    assert "already have these values" in out
    assert said(out, "parameters.yaml", "--trial 1")
    code, out, _ = apply(capsys, at_start, "--yes", "--trial", "0", "--without-certificate")
    assert code == 0
    assert said(out, "trial_0.yaml", "--trial 0")
    found = values_in(deploy / "trial_0.yaml")
    assert found["lambda_mpc"] == at_start.trials[0].parameters["lambda_mpc"]
    code, out, _ = apply(capsys, at_start, "--rollback", "--yes")
    assert code == 0
    assert said(out, "rollback.yaml", "--rollback")
    assert values_in(deploy / "rollback.yaml")["lambda_mpc"] == -3.0


def test_back_to_what_nobody_has_replaced_is_the_default(record, now, capsys):
    code, out, _ = apply(capsys, record, "--rollback")
    assert (code, "deploy/rollback.yaml, the study's default" in " ".join(out.split())) == (2, True)


def test_without_a_terminal_it_only_shows(record, now, capsys):
    before = now()
    code, out, err = apply(capsys, record)
    assert code == 2
    assert err == "error: no terminal to confirm on; use --yes\n"
    assert f"{record.trials[1].parameters['lambda_mpc']:.6g}" in out
    assert now() == before


def test_without_a_certificate_only_if_told_so(record, now, capsys):
    before = now()
    (certificate,) = (record.path / "certificates").glob("*.json")
    content = certificate.read_text()
    certificate.unlink()
    try:
        code, out, err = apply(capsys, record, "--yes")
        assert (code, out) == (3, "")
        assert "no certificate of trial 1" in err
        assert now() == before
        code, out, err = apply(capsys, record, "--yes", "--without-certificate")
        assert code == 0
        assert err.startswith("warning: ")
        assert now() == tuned(record)
    finally:
        certificate.write_text(content)


def test_one_node_refuses_and_both_stay_as_they_were(client, record, now, capsys):
    """The upper input limit of the result lies below the lower one that the controller runs."""
    client.set_parameters("mpc_controller", {"input_lower": 1.15})
    before = now()
    assert before["window"] != record.trials[1].parameters["window"]
    code, _, err = apply(capsys, record, "--yes")
    assert code == 1
    (line,) = err.splitlines()
    assert line.startswith("error: mpc_controller refuses: input_upper: ")
    assert "; previous values of milling_plant restored; " in line
    assert now() == before
    assert rollback_file(record) == before


def test_the_way_back_from_an_apply_that_was_killed(client, record, now, capsys, monkeypatch):
    """The next one finds a mixture on the nodes, which is not what they had."""
    before = now()

    def killed(nodes, now, new, *_):
        node = next(iter(new))
        nodes.set(node, new[node])
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("bo_tuner.cli.apply.set_values", killed)
        with pytest.raises(KeyboardInterrupt):
            apply(capsys, record, "--yes")
    assert now() not in (before, tuned(record))
    code, _, err = apply(capsys, record, "--yes")
    assert code == 0
    rollback = record.path / "deploy" / "rollback.yaml"
    assert err == (
        f"warning: an earlier apply did not finish; {rollback} keeps what the nodes had before it\n"
    )
    assert now() == tuned(record)
    assert rollback_file(record) == before
    code, _, err = apply(capsys, record, "--rollback", "--yes")
    assert (code, err) == (0, "")
    assert now() == before


def test_what_did_not_finish_has_once_nothing_is_left_to_set(record, now, capsys):
    """Else the next one would not save the values that it replaces."""
    assert apply(capsys, record, "--yes")[0] == 0
    unfinished = record.path / "deploy" / "unfinished.txt"
    unfinished.write_text("as of a kill after the last value\n")
    code, out, _ = apply(capsys, record, "--yes")
    assert code == 0
    assert "nothing to set" in out
    assert not unfinished.exists()


def test_a_tuner_at_work_on_another_machine(record, now, peer, capsys, monkeypatch):
    """Its lock is not here, but its node is in the graph."""
    monkeypatch.setattr("bo_tuner.deploy.live_parameters.LOOK_AROUND", 5.0)
    before = now()
    tuner = Node("bo_tuner", context=peer.node.context)
    try:
        code, out, err = apply(capsys, record, "--yes")
    finally:
        tuner.destroy_node()
    assert (code, out) == (2, "")
    assert err.startswith("error: another tuner is running as /bo_tuner; wait for it, or use ")
    assert now() == before


@pytest.mark.parametrize("rollback", [False, True])
def test_two_controllers(record, now, start_node, peer, capsys, monkeypatch, rollback):
    before = now()
    if rollback:
        assert apply(capsys, record, "--yes")[0] == 0
        before = now()
    monkeypatch.setattr("bo_tuner.deploy.live_parameters.LOOK_AROUND", 5.0)
    twin = start_node("mpc_controller")
    service = "mpc_controller/set_parameters_atomically"
    peer.spin_until(lambda: peer.node.count_services(service) == 2, "both")
    code, out, err = apply(capsys, record, "--yes", *["--rollback"][:rollback])
    assert (code, out) == (2, "")
    domain = os.environ["ROS_DOMAIN_ID"]
    expected = f"mpc_controller runs more than once in ROS domain {domain}; {END_OTHERS}"
    assert err == f"error: {expected}\n"
    twin.end()
    peer.spin_until(lambda: peer.node.count_services(service) == 1, "one")
    assert now() == before


def test_a_second_node_that_comes_before_anything_is_set_has_changed_nothing():
    """Nothing was sent, so nothing is to be restored."""
    with at_work(System) as servo, contextlib.ExitStack() as stack:
        live = LiveParameters(["servo"], [], lambda: None)
        stack.callback(live.close)
        stack.enter_context(at_work(lambda context: Node("servo", context=context)))
        wait_until(lambda: live._clients["servo"].servers() == 2, "both")
        with pytest.raises(ApplyError) as caught:
            set_values(live, {"servo": {"gain": 0.5}}, {"servo": {"gain": 0.75}})
        assert str(caught.value).endswith(f"; {END_OTHERS}; nothing was changed")
        assert caught.value.restored
        assert servo.get_parameter("gain").value == 0.5


class Undecided(System):
    """A servo that takes a gain and goes back on it in its own cycle, 0.3 s later."""

    def __init__(self, context):
        super().__init__(context)
        self.add_post_set_parameters_callback(self.think)
        self.again = None

    def think(self, parameters):
        if self.again is None and any(item.value == 0.75 for item in parameters):
            self.again = self.create_timer(0.3, self.revert)

    def revert(self):
        self.destroy_timer(self.again)
        self.set_gain(0.5)


class Quiet(Undecided):
    """The same, which publishes no events of its parameters."""

    def __init__(self, context):
        super().__init__(context)
        self._parameter_event_publisher = Mock()


@pytest.mark.parametrize("kind", [Undecided, Quiet])
def test_a_node_that_goes_back_on_its_values_does_not_have_them(kind):
    """It read them back at once as they were set."""
    with at_work(kind) as servo, contextlib.closing(LiveParameters(["servo"], [], no_end)) as live:
        with pytest.raises(ApplyError, match=r"servo: .*gain is 0.5.*values of servo restored"):
            set_values(live, {"servo": {"gain": 0.5}}, {"servo": {"gain": 0.75}})
        assert servo.again is not None
        assert servo.get_parameter("gain").value == 0.5


def test_a_value_of_a_type_that_ros_does_not_define(monkeypatch):
    """A node in another language may send one."""
    monkeypatch.setattr(
        "bo_tuner.backends.ros.parameters.services.to_value", lambda value: UnknownType(77)
    )
    with at_work(System), contextlib.closing(LiveParameters(["servo"], [], no_end)) as live:
        with pytest.raises(NodeError) as caught:
            live.get("servo", ["gain"])
        assert str(caught.value) == "servo: gain is of unknown type 77"


def test_a_signal_is_heard_while_a_node_is_asked():
    """One that sends megabytes, or nothing, would keep the command from ending for long."""
    asked = threading.Event()

    def interrupted():
        if asked.is_set():
            raise Interrupted(signal.SIGTERM)

    with at_work(System) as servo, contextlib.ExitStack() as stack:
        live = LiveParameters(["servo"], [], interrupted)
        stack.callback(live.close)
        servo.executor.shutdown()
        asked.set()
        with pytest.raises(Interrupted):
            live.get("servo", ["gain"])


@pytest.mark.parametrize("ends", [False, True])
def test_by_a_ramp_it_goes_there_in_steps_and_back_at_once_if_it_is_to_end(ends):
    ramped = signal_study(run={"end": {"after": 2.0}, "ramp": 0.4})
    before, new = {"servo": {"gain": 0.5}}, {"servo": {"gain": 1.5}}
    way = Way.of(study_from_mapping(ramped), before, new)
    with at_work(System) as servo, contextlib.ExitStack() as stack:

        def interrupted():
            if ends and servo.get_parameter("gain").value == 1.0:
                raise Interrupted(signal.SIGINT)

        live = LiveParameters(["servo"], [], interrupted)
        stack.callback(live.close)
        with pytest.raises(Interrupted) if ends else contextlib.nullcontext():
            set_values(live, before, new, way)
        assert servo.asked_gains == ([0.75, 1.0, 0.5] if ends else [0.75, 1.0, 1.25, 1.5])


def test_what_would_be_shown_on_a_closed_output_is_not_set(record, now):
    before = now()
    arguments = (sys.executable, "-m", "bo_tuner", "apply", record.path, "--yes")
    done = subprocess.run(
        ["sh", "-c", '"$@" >&-', "sh", *arguments],
        env=environment(record.path),
        capture_output=True,
        text=True,
    )
    (line,) = done.stderr.splitlines()
    assert (done.returncode, line.startswith("error: standard output is closed")) == (1, True)
    assert now() == before


def test_a_parameter_that_a_node_does_not_have(client, tmp_path, capsys):
    study = make_study()
    exchanged = {"plant": "mpc_controller", "controller": "milling_plant"}
    nodes = {key: replace(spec, node=exchanged[key]) for key, spec in study.nodes.items()}
    study = replace(study, nodes=nodes)
    record = make_run(tmp_path / "run", study, InProcessBackend(study), result=1)
    write_certificate(record, record.trials[1])
    code, out, err = apply(capsys, record, "--yes")
    assert (code, out) == (2, "")
    assert err == "error: mpc_controller: has no parameter overshoot_window\n"


def test_in_a_terminal_it_asks(record, now):
    """As a user starts it; what counts as a yes is tested without nodes."""
    before = now()
    program = (
        "import sys; from bo_tuner.interruption import Interruption; stop = Interruption(); "
        "from bo_tuner.cli import apply; sys.exit(apply.run(sys.argv[1:], stop))"
    )

    def yes():
        assert now() == before
        return b"y\n"

    converse(
        [sys.executable, "-c", program, record.path],
        [("set these on milling_plant, mpc_controller? [y/N]", yes)],
        env=environment(TERM="dumb"),
    )
    assert now() == tuned(record)


@pytest.mark.parametrize("to_error", [False, True])
@pytest.mark.parametrize(
    ("kind", "code", "complaint"),
    [
        ("full", 1, "error: output: No space left on device"),
        ("pipe", 141, "error: the output pipe was closed"),
    ],
)
def test_what_cannot_be_shown_is_not_set(record, now, kind, code, complaint, to_error):
    before = now()
    with gone(kind) as output:
        process = Fork(
            *("apply", record.path, "--yes"),
            folder=record.path.parent,
            stdout=output,
            **({"stderr": output} if to_error else {}),
        )
    _, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == code
    if not to_error:
        assert err == f"{complaint}\n"
    assert now() == before


def test_what_is_set_stays_set_when_the_output_goes_after_that(record, now, capsys, monkeypatch):
    """The way back is saved, and the exit code tells to look."""
    before = now()

    def gone(text):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr(command, "say", gone)
    code, _, err = apply(capsys, record, "--yes")
    assert (code, err) == (141, "error: the output pipe was closed\n")
    assert now() == tuned(record)
    assert rollback_file(record) == before


def test_what_changes_while_it_asks_is_not_overwritten(client, record, now, capsys, monkeypatch):
    def confirmed(question, interruption):
        client.set_parameters("mpc_controller", {"lambda_mpc": -1.75})
        return True

    monkeypatch.setattr(command, "confirmed", confirmed)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    code, _, err = apply(capsys, record)
    assert (code, err) == (3, "error: the nodes' values have changed meanwhile\n")
    assert now()["lambda_mpc"] == -1.75
    assert now()["window"] != tuned(record)["window"]


def test_no_such_node(ros_environment, record, capsys, monkeypatch):
    monkeypatch.setattr("bo_tuner.deploy.live_parameters.DISCOVERY_TIMEOUT", 1.0)
    code, out, err = apply(capsys, record, "--yes", "--ros-args", "-r", "__ns:=/nowhere")
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("error: /nowhere/milling_plant and /nowhere/mpc_controller: no such")


@pytest.mark.parametrize(
    ("arguments", "environment", "complaint"),
    [
        (("--ros-args", "-r", "__ns:=/1x"), {}, "error: cannot use --ros-args"),
        ((), {"ROS_DOMAIN_ID": "many"}, "error: cannot use --ros-args or ROS_DOMAIN_ID"),
    ],
)
def test_what_ros_does_not_take(record, capsys, monkeypatch, arguments, environment, complaint):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    code, out, err = apply(capsys, record, "--yes", *arguments)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith(complaint)
