"""Whatever becomes of the tuner, an attached machine is stopped and has its safe values again."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import guarded_tuner
import pytest
from commands import Fork, environment, finish, python_path
from guarded_tuner import STOP
from made_runs import INITIAL, make_run
from node_threads import at_work
from rclpy.node import Node
from servo import SAFE, Simulation, System, gain, study
from signal_runs import signal_study
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.backends.ros.guard.messages import (
    BEAT_TOPIC,
    BEATS,
    GUARD,
    LATEST,
    STATE_TOPIC,
    State,
)
from bo_tuner.backends.ros.guard.plan import Plan
from bo_tuner.backends.ros.isolation import profile_variable
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_to_yaml

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def patience(monkeypatch, tmp_path):
    """What the killed have left is no matter of other tests."""
    monkeypatch.delenv("BO_TUNER_GUARD_TIMEOUT")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def long_lease(tmp_path, monkeypatch):
    """Who is stopped for a moment of a busy computer is not forgotten."""
    profile = Path(os.environ[profile_variable()]).read_text()
    changed = profile.replace("<leaseDuration><sec>2<", "<leaseDuration><sec>60<")
    assert changed != profile
    path = tmp_path / "profile.xml"
    path.write_text(changed)
    monkeypatch.setenv(profile_variable(), str(path))


@pytest.fixture
def system(ros_environment):
    with at_work(System) as system:
        yield system


class Tuner:
    """A tuner in a process of its own, and what it has said."""

    def __init__(self, folder, kind="plain", **changes):
        self.folder = folder
        script = Path(guarded_tuner.__file__)
        self.process = subprocess.Popen(
            [sys.executable, script, folder, kind, json.dumps(changes)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment() | {"PYTHONPATH": python_path(script.parent)},
        )
        self.said = []
        self._listener = threading.Thread(target=self._listen)
        self._listener.start()

    def _listen(self):
        for line in self.process.stdout:
            self.said.append(json.loads(line))

    def evaluate(self, what="run"):
        self.process.stdin.write(f"{what}\n")
        self.process.stdin.flush()

    def expect(self, key):
        """The next thing that it says of a kind."""
        return self.expect_all(key)[key]

    def expect_all(self, key):
        """The next line with a thing of a kind."""

        def is_there():
            return any(key in facts for facts in self.said)

        wait_until(is_there, key, None if is_there() else self.process, lambda: self.said)
        found = next(facts for facts in self.said if key in facts)
        self.said.remove(found)
        return found

    def end(self):
        """Let it end by itself."""
        self.process.stdin.close()
        self.process.wait(DEADLINE)
        self.expect("closed")

    def close(self):
        """End it, whatever state it is in."""
        self.process.send_signal(signal.SIGCONT)
        self.process.kill()
        self.process.wait()
        self._listener.join()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()

    @property
    def acts(self):
        path = Path(self.folder) / "guard.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    @property
    def guards(self):
        """Processes of guards that it has started, by their record."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                if b"bo_tuner.backends.ros.guard" in path.read_bytes() and str(
                    Path(self.folder) / "guard.log"
                ) == str(Path(path.parent, "fd", "2").readlink()):
                    found.append(int(path.parent.name))
            except OSError:
                continue
        return found


@pytest.fixture
def tuner(system, tmp_path):
    """Function that starts a tuner and waits until it is at work, in a run unless told not to."""
    started = []

    def begin(kind="plain", *, in_run=True, refused=False, **changes):
        made = Tuner(tmp_path / f"log{len(started)}", kind, **changes)
        started.append(made)
        if refused:
            return made
        made.expect("open")
        if in_run:
            system.setpoint = 0.0
            made.evaluate()
            wait_until(lambda: system.setpoint == 1.0, "a run", made.process)
        return made

    yield begin
    for made in started:
        made.close()
        wait_until(lambda made=made: not made.guards, "the end of the guard")


def is_safe(system):
    return gain(system) == SAFE and system.setpoint == STOP


def test_a_normal_run_has_nothing_of_it(tuner, system):
    made = tuner("short")
    for _ in range(3):
        made.evaluate()
    made.evaluate("fit")
    for _ in range(4):
        assert made.expect("state") == "complete"
    assert made.expect("fitted")
    assert gain(system) == 0.75
    assert len(made.guards) == 1
    made.end()
    assert (made.acts, gain(system)) == ([], SAFE)
    wait_until(lambda: not made.guards, "the end of the guard")


@pytest.mark.parametrize("in_run", [True, False])
def test_a_tuner_that_is_killed(tuner, system, in_run):
    made = tuner("plain" if in_run else "short")
    if not in_run:
        assert made.expect("state") == "complete"
        assert gain(system) == 0.75
        system.setpoint = 1.0
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")
    wait_until(lambda: not made.guards, "the end of the guard")
    (act,) = made.acts
    assert act["reason"] == "the tuner has ended without leaving the machine safe"
    assert act["problems"] == []


@pytest.mark.slow
def test_a_tuner_that_is_killed_before_the_first_run(tuner, system):
    made = tuner(in_run=False)
    system.set_gain(0.9)
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")


@pytest.mark.slow
def test_a_tuner_that_is_stopped_and_lives_again_waits_for_somebody(long_lease, tuner, system):
    made = tuner()
    made.process.send_signal(signal.SIGSTOP)
    wait_until(lambda: is_safe(system), "a safe machine")
    wait_until(lambda: made.acts, "the record")
    # Whoever changes something meanwhile does not leave it unsafe.
    system.set_gain(0.9)
    wait_until(lambda: gain(system) == SAFE, "safe values once more")
    made.process.send_signal(signal.SIGCONT)
    assert "no heartbeat of the tuner for" in made.expect("halt")
    assert made.expect("state") == "lost"
    assert is_safe(system)
    # Once somebody lets it, it goes on, and is watched as before.
    system.setpoint = 0.0
    made.evaluate()
    wait_until(lambda: system.setpoint == 1.0, "the next run", made.process)
    assert gain(system) == 0.75
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")
    wait_until(lambda: len(made.acts) == 2, "the record")


def test_a_tuner_that_does_not_look_any_more_in_a_run(tuner, system):
    made = tuner("hung")
    wait_until(lambda: is_safe(system), "a safe machine")
    assert "no heartbeat" in made.expect("halt")
    assert made.expect("state") == "lost"


def test_an_abort_condition_that_the_tuner_overlooks(tuner, system):
    made = tuner("blind")
    assert "the abort condition holds" in made.expect("halt")
    assert made.expect("state") == "lost"
    assert is_safe(system)


class Pulse(Node):
    """Publishes `value` once, then zeros, 5 times a second."""

    def __init__(self, context):
        super().__init__("sensor", context=context)
        self.value = 0.0
        self.publisher = self.create_publisher(Float64, "pulse", 10)
        self.create_timer(0.2, self.publish)

    def publish(self):
        self.publisher.publish(Float64(data=self.value))
        self.value = 0.0


PULSE = {
    "signals": signal_study()["signals"] | {"pulse": {"topic": "pulse", "field": "data"}},
    "run": {**guarded_tuner.GUARDED["run"], "abort_when": "pulse > 3"},
}


@pytest.mark.slow
def test_an_abort_condition_that_holds_in_a_single_message(tuner, ros_environment):
    with at_work(Pulse) as sensor:
        made = tuner("blind", **PULSE)
        sensor.value = 5.0
        wait_until(lambda: made.acts, "an act", made.process)
        assert made.acts[0]["reason"].startswith("the abort condition holds")


@pytest.mark.slow
def test_the_time_in_a_condition_is_that_of_the_simulation(tuner, ros_environment):
    """Here it passes ten times slower than that of the machine."""
    with at_work(Simulation) as simulation:
        simulation.speed = 0.1
        angle = {"topic": "/joint_states", "field": "position[motor]", "time": "reception"}
        run = {
            **guarded_tuner.GUARDED["run"],
            "clock": "sim",
            "end": {"after": 0.3},
            "abort_when": "t > 0.5",
        }
        made = tuner(signals=signal_study()["signals"] | {"angle": angle}, run=run)
        said = made.expect_all("state")
        assert (said["state"], made.acts) == ("complete", []), said


@pytest.mark.slow
def test_a_guard_that_is_stopped_keeps_nobody_from_watching_the_machine(tuner, ros_environment):
    """Nothing is heard of it then, and meanwhile the tuner itself aborts the run.

    ROS forgets it soon, which is not to look as if the publisher of a signal were gone.
    """
    with at_work(Pulse) as sensor:
        made = tuner(**PULSE)
        (guard,) = made.guards
        os.kill(guard, signal.SIGSTOP)
        sensor.value = 5.0
        said = made.expect_all("state")
        assert (said["state"], said["reason"].split(" at ")[0]) == ("failed", "aborted"), said

        def ended():
            """Whether it has ended: a run that is aborted at once does not look at the guard."""
            if not made.said:
                made.evaluate()
                wait_until(lambda: made.said, "what came of a run", None)
            if "state" in made.said[0]:
                made.said.clear()
            return any("error" in facts for facts in made.said)

        wait_until(ended, "the end of the run")
        assert made.expect("error").startswith("the guard of the nodes has ended: nothing is heard")
        assert made.expect("closed")
        assert made.guards == []


@pytest.mark.slow
def test_while_nobody_can_see_to_the_machine_it_is_left_safe_before_anybody_waits(
    long_lease, tuner, system
):
    made = tuner()
    (guard,) = made.guards
    for pid in (guard, made.process.pid):
        os.kill(pid, signal.SIGSTOP)
    # For longer than the lease of ROS may be: the guard is waited for.
    time.sleep(2.0)
    made.process.send_signal(signal.SIGCONT)
    wait_until(lambda: is_safe(system), "a safe machine", made.process)
    assert not any("error" in facts or "state" in facts for facts in made.said)
    os.kill(guard, signal.SIGCONT)
    said = made.expect_all("state")
    assert said["state"] == "lost"
    assert said["reason"].startswith("the guard of the nodes is silent")
    # Both are at work again.
    system.setpoint = 0.0
    made.evaluate()

    def runs():
        """Whether a run is under way; one that came before the guard's next sign is lost, too."""
        if any("state" in facts for facts in made.said):
            made.said.clear()
            made.evaluate()
        return system.setpoint == 1.0

    wait_until(runs, "the next run", made.process)
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")


@pytest.mark.slow
def test_an_act_while_the_tuner_waits_for_a_node_is_not_forgotten(long_lease, tuner, system):
    """Whoever waits for a node has many reasons why it is not there; this is not one of them."""
    made = tuner("waiting")
    for count, key in ((1, "open"), (2, "waiting")):
        if key == "waiting":
            made.expect(key)
        made.process.send_signal(signal.SIGSTOP)
        wait_until(lambda count=count: len(made.acts) == count, "the record")
        made.process.send_signal(signal.SIGCONT)
    assert made.expect("halt")
    assert made.expect("state") == "lost"
    made.evaluate()
    assert "no heartbeat" in made.expect("halt")
    assert made.expect("state") == "lost"


@pytest.mark.slow
def test_a_full_disk_keeps_the_guard_from_nothing(tuner, system, tmp_path):
    folder = tmp_path / "log0"
    folder.mkdir()
    (folder / "guard.log").symlink_to("/dev/full")
    made = tuner()
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")
    wait_until(lambda: made.acts, "the record")


@pytest.mark.slow
def test_an_abort_condition_that_the_tuner_judges_late(tuner, system):
    """It would have done the same, so nobody has to look before it goes on."""
    made = tuner("slow")
    said = made.expect_all("state")
    assert said["state"] == "failed"
    assert said["reason"].startswith("aborted at ")
    assert "the guard has stopped the machine: the abort condition holds" in said["reason"]
    assert not any("halt" in facts for facts in made.said)
    assert is_safe(system)
    made.process.kill()


@pytest.mark.slow
def test_a_tuner_that_was_stopped_until_ros_had_forgotten_it(tuner, system, peer):
    """It goes on where the middleware lets it, or ends; it does not wait for what never comes."""
    made = tuner()
    made.process.send_signal(signal.SIGSTOP)
    wait_until(lambda: is_safe(system), "a safe machine")
    peer.spin_until(lambda: "bo_tuner" not in peer.node.get_node_names(), "the lease to end")
    made.process.send_signal(signal.SIGCONT)

    def told():
        return [facts for facts in made.said if "error" in facts or "state" in facts]

    wait_until(told, "an end", None, lambda: made.said)
    (found,) = told()
    if "error" in found:
        assert found["error"].startswith("this process was stopped for ")
        assert found["error"].endswith("look at the machine, then resume the run")
        assert made.expect("closed")
    else:
        assert found["state"] == "lost"
    assert is_safe(system)


def test_a_node_that_hangs_when_the_tuner_ends_is_safe_when_it_answers_again(tuner, system):
    """Its guard outlives the tuner for that."""
    made = tuner("short")
    assert made.expect("state") == "complete"
    assert gain(system) == 0.75
    hanging, goes_on = threading.Event(), threading.Event()

    def hang():
        hanging.set()
        goes_on.wait(DEADLINE)

    system.create_timer(0.01, hang)
    assert hanging.wait(DEADLINE)
    try:
        made.end()
        assert "until then its guard tries to set the safe values" in made.expect("left")
        assert made.guards
    finally:
        goes_on.set()
    wait_until(lambda: is_safe(system), "a safe machine")
    wait_until(lambda: not made.guards, "the guard's end")


def test_a_guard_that_dies_ends_the_run_with_the_machine_safe(tuner, system):
    made = tuner()
    (guard,) = made.guards
    os.kill(guard, signal.SIGKILL)
    assert made.expect("error").startswith("the guard of the nodes has ended")
    assert made.expect("closed")
    assert is_safe(system)


@pytest.mark.slow
def test_a_guard_that_is_asked_to_end_leaves_the_machine_safe(tuner, system):
    made = tuner()
    (guard,) = made.guards
    os.kill(guard, signal.SIGTERM)
    assert made.expect("error").startswith(
        "the guard has stopped the machine: the guard was asked to end; stop messages after "
    )
    assert is_safe(system)
    assert [act["reason"] for act in made.acts] == ["the guard was asked to end"]


@pytest.mark.slow
def test_a_terminal_that_goes_away_is_none_of_the_guards(tuner, system):
    made = tuner()
    (guard,) = made.guards
    for signum in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTSTP):
        os.kill(guard, signum)
    made.evaluate("fit")
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")


@pytest.mark.slow
def test_a_node_that_refuses_is_tried_until_it_does_not(tuner, system):
    made = tuner()
    system.refusal = "the key is out"
    made.process.kill()
    wait_until(lambda: system.setpoint == STOP, "the stop message")
    log = Path(made.folder) / "guard.log"
    wait_until(lambda: "servo is not safe: servo refused" in log.read_text(), "what is wrong")
    system.refusal = ""
    wait_until(lambda: gain(system) == SAFE, "safe values")


@pytest.mark.slow
def test_a_node_that_hangs_is_safe_once_it_answers(tuner, system):
    made = tuner()
    system.hang = 3.0
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")


@pytest.mark.slow
def test_without_after_there_is_nothing_to_stop_but_values_to_set(tuner, system):
    run = {**guarded_tuner.GUARDED["run"], "after": [], "abort_when": ""}
    made = tuner(run=run)
    made.process.kill()
    wait_until(lambda: gain(system) == SAFE, "safe values")
    assert system.setpoint == 1.0


@pytest.mark.slow
def test_a_condition_that_cannot_be_known_stops_nothing(tuner, system):
    run = {**guarded_tuner.GUARDED["run"], "end": {"when": "t > 0.3"}}
    run["abort_when"] = "log(-1 - abs(angle)) > 0"
    made = tuner(run=run)
    assert made.expect("state") == "complete"
    assert made.acts == []


@pytest.mark.slow
def test_a_stop_message_that_nobody_hears(tuner, system):
    step = {
        "publish": {"topic": "nobody", "message": {"data": 0.0}, "type": "std_msgs/msg/Float64"}
    }
    run = {**guarded_tuner.GUARDED["run"], "after": [step]}
    made = tuner(refused=True, run=run)
    assert made.expect("error").startswith(
        "the guard of the nodes cannot start: publish.topic: nothing subscribes to /nobody"
    )
    assert made.expect("closed")
    assert gain(system) == 0.5


@pytest.mark.slow
def test_an_apply_that_is_killed_gives_back_what_the_node_had(system, tmp_path):
    """It is killed while the node is about to take the value."""
    made = study(run={"before": []}, budget=INITIAL)
    path = tmp_path / "run"
    backend = RosBackend(made, path / "log", attach=True)
    record = make_run(path, made, backend, result=1, backend_name="ros", attached=True)
    system.set_gain(0.375)
    asked = threading.Event()

    def accepts():
        asked.set()
        # As long as the command lives.
        process.wait(DEADLINE)
        system.accepts = lambda: True
        return True

    system.accepts = accepts
    process = Fork("apply", path, "--yes", "--without-certificate", folder=tmp_path)
    assert asked.wait(DEADLINE)
    process.kill()
    process.communicate()
    log = path / "log" / "guard.jsonl"
    wait_until(log.exists, "the record of the guard")
    assert gain(system) == 0.375
    assert record.trials[1].parameters["gain"] != 0.375


@pytest.mark.slow
def test_a_check_that_is_killed_leaves_the_machine_safe(system, tmp_path):
    changes = guarded_tuner.GUARDED
    (tmp_path / "servo.yaml").write_text(study_to_yaml(study(**changes)))
    check = Fork("check", "servo.yaml", folder=tmp_path)
    wait_until(lambda: system.setpoint == 1.0, "a run", check)
    check.kill()
    check.communicate()
    wait_until(lambda: is_safe(system), "a safe machine")


def patient_run():
    """Changes of the servo's study for a whole run that no busy computer brings to a halt."""
    return guarded_tuner.GUARDED | {
        "budget": INITIAL | {"trials": 3, "validation_draws": 2},
        "run": guarded_tuner.GUARDED["run"] | {"end": {"after": 0.5}},
        "guard": {"timeout": 5.0},
    }


@pytest.mark.slow
def test_a_run_that_was_killed_says_so_when_it_goes_on(system, tmp_path):
    """Of the guard's act the record tells, the terminal and the report."""
    changes = patient_run()
    (tmp_path / "servo.yaml").write_text(study_to_yaml(study(**changes)))
    tune = Fork("tune", "--study", "servo.yaml", "--attach", "--quiet", folder=tmp_path)
    runs = tmp_path / "runs" / "latest"

    def counted():
        return len(read_run(runs).evaluations) if (runs / "journal.sqlite").exists() else 0

    wait_until(lambda: counted() > 2, "some evaluations", tune)
    tune.kill()
    tune.communicate()
    wait_until(lambda: is_safe(system), "a safe machine")
    wait_until((runs / "log" / "guard.jsonl").exists, "the record of the guard")
    code, _, err = finish(Fork("tune", "--resume", runs, "--quiet", folder=tmp_path))
    assert code in (0, 3), err
    assert "the guard has stopped the machine: the tuner has ended without leaving the" in err
    assert "the guard has stopped the machine" in (runs / "report.html").read_text()


@pytest.mark.slow
def test_a_run_that_was_stopped_waits_until_somebody_lets_it_go_on(
    long_lease, system, peer, tmp_path
):
    changes = patient_run()
    (tmp_path / "servo.yaml").write_text(study_to_yaml(study(**changes)))
    said = tmp_path / "said.txt"
    with said.open("w") as output:
        tune = Fork(
            "tune",
            "--study",
            "servo.yaml",
            "--attach",
            folder=tmp_path,
            stderr=output,
            stdout=output,
        )
    journal = tmp_path / "runs" / "latest" / "journal.sqlite"
    wait_until(lambda: journal.exists() and system.setpoint == 1.0, "a run", tune, said.read_text)
    tune.send_signal(signal.SIGSTOP)
    wait_until(lambda: is_safe(system), "a safe machine")
    tune.send_signal(signal.SIGCONT)
    waits = "the run waits until you have looked at the machine"
    wait_until(lambda: waits in " ".join(said.read_text().split()), "the run to wait", tune)
    wait_until(lambda: is_safe(system), "a parked machine")
    assert peer.call(SetBool, "tuner/pause", SetBool.Request(data=False)).success
    wait_until(lambda: tune.poll() is not None, "the end of the run", said=said.read_text)
    assert tune.poll() in (0, 3), said.read_text()


class Standing:
    """A guard that was started by hand."""

    def __init__(self, folder, **changes):
        path = folder / "guarded.yaml"
        path.write_text(study_to_yaml(study(**{**guarded_tuner.GUARDED, **changes})))
        self.record = folder / "standing.jsonl"
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "bo_tuner", "guard", "--study", path),
                *("--record", self.record),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment() | {"PYTHONUNBUFFERED": "1"},
        )

    def ready(self):
        line = self.process.stdout.readline()
        assert line.startswith("guards /servo for studies like servo"), line

    def end(self):
        self.process.terminate()
        code = self.process.wait(DEADLINE)
        self.process.stdout.close()
        return code


@pytest.fixture
def standing(ros_environment, tmp_path):
    guards = []

    def start(**changes):
        guards.append(Standing(tmp_path, **changes))
        return guards[-1]

    yield start
    for guard in guards:
        if guard.process.poll() is None:
            guard.process.kill()
            guard.process.wait()
        guard.process.stdout.close()


@pytest.mark.slow
def test_a_guard_near_the_machine_is_found_and_outlives_tuners(tuner, system, standing):
    guard = standing()
    guard.ready()
    for _ in range(2):
        made = tuner()
        assert made.guards == []
        made.process.kill()
        wait_until(lambda: is_safe(system), "a safe machine")
    wait_until(lambda: len(guard.record.read_text().splitlines()) == 2, "the record")
    assert guard.end() == 0


def test_a_guard_of_another_study_is_refused(tuner, standing):
    standing(park={"parameters": {"gain": 0.125}}).ready()
    made = tuner(refused=True)
    assert made.expect("error").startswith("the guard of /servo is one of study servo, with other")


@pytest.mark.slow
def test_two_guards_of_one_node_are_refused(system, standing):
    standing().ready()
    second = standing()
    out, _ = second.process.communicate(timeout=DEADLINE)
    assert (second.process.returncode, out) == (
        2,
        "error: /servo has a guard already, of study servo; end that one first\n",
    )


@pytest.mark.slow
def test_a_second_guard_is_refused_also_while_the_first_waits_for_the_node(standing):
    """Started at the same time: one of them stays."""
    guards = [standing(), standing()]
    lines = [guard.process.stdout.readline() for guard in guards]
    assert sorted(line.split(":")[0] for line in lines) == ["error", "waiting"]
    assert "error: /servo has a guard already, of study servo; end that one first\n" in lines


@pytest.mark.slow
def test_a_guard_whose_output_nobody_reads_acts_all_the_same(tuner, system, standing):
    guard = standing()
    guard.ready()
    guard.process.stdout.close()
    made = tuner()
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")
    wait_until(guard.record.exists, "the record")
    assert guard.process.poll() is None


@pytest.mark.slow
def test_a_guard_that_does_not_hear_the_tuner_keeps_the_run_from_beginning(tuner, peer):
    """As over a network that carries messages one way only."""
    plan = Plan.of(study(**guarded_tuner.GUARDED))
    state = State("deaf", plan.digest, "servo", ["/servo"], [], stands=True, settled=True)
    publisher = peer.node.create_publisher(String, STATE_TOPIC, LATEST)
    peer.node.create_timer(0.1, lambda: publisher.publish(String(data=str(state))))
    made = tuner(refused=True)
    peer.spin_until(lambda: any("error" in facts for facts in made.said), "an error")
    assert made.expect("error").startswith("the guard of the nodes does not hear this tuner")


@pytest.mark.slow
@pytest.mark.parametrize(
    "text", ["", "[", "7", '{"guard": 7}', str(State([], 1, {}, "servo", 5, stands="yes"))]
)
def test_what_strangers_publish_is_overlooked(tuner, system, text):
    publishers = [
        system.create_publisher(String, topic, qos)
        for topic, qos in ((STATE_TOPIC, LATEST), (BEAT_TOPIC, BEATS))
    ]

    def publish():
        for publisher in publishers:
            publisher.publish(String(data=text))

    system.create_timer(0.02, publish)
    made = tuner()
    made.process.kill()
    wait_until(lambda: is_safe(system), "a safe machine")


def test_its_nodes_are_known_as_the_tuners_own(tuner, peer, system):
    tuner()
    peer.spin_until(lambda: GUARD in peer.node.get_node_names(), "the guard")
