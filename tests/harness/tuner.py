"""The tuner as a process of its own, and a small node that misbehaves to order."""

import contextlib
import json
import os
import re
import signal
import sys
import uuid
from pathlib import Path

from commands import Fork
from functions import NODE, study_mapping
from reaper import marked
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros.isolation import PROFILE_VARIABLES
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.trials import EvaluationState

MARK = "TUNE_TEST_MARK"

# A node with one parameter to tune. What it does in its n-th cut, restarts not counted, stands in
# the environment: DRIVE="2:die 3:nan" and so on, or "all:die".
DRIVE = """\
import os
import signal
import sys
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

if "exit" in os.environ.get("DRIVE", ""):
    sys.exit("error: no such bus")
orders = dict(order.split(":") for order in os.environ.get("DRIVE", "").split())
counter = Path(os.environ["CUTS"])


class Drive(Node):
    def __init__(self):
        super().__init__("axis")
        for name, value in (("gain", 0.5), ("load", 1.0), ("seed", 0), ("limit", 1.0)):
            self.declare_parameter(name, value)
        self.add_on_set_parameters_callback(self.judge)
        if "CLAMP" in os.environ:
            self.add_pre_set_parameters_callback(self.clamp)
        self.result = self.create_publisher(DiagnosticArray, "~/cut_result", 50)
        self.create_service(Trigger, "~/run", self.run)
        self.timer = self.create_timer(0.01, self.end)
        self.cut = None

    def clamp(self, changes):
        most = float(os.environ["CLAMP"])
        return [
            rclpy.parameter.Parameter(p.name, value=min(p.value, most)) if p.name == "gain" else p
            for p in changes
        ]

    def judge(self, changes):
        for p in changes:
            if p.name == "gain" and p.value > self.get_parameter("limit").value:
                return SetParametersResult(successful=False, reason=f"gain: {p.value} is too much")
            if p.name == "limit" and p.value < 0:
                return SetParametersResult(successful=False, reason="limit: -1.0 is negative")
        return SetParametersResult(successful=True)

    def run(self, request, response):
        self.number = int(counter.read_text()) + 1 if counter.exists() else 1
        # In one piece, for a test that looks on.
        new = counter.with_suffix(".new")
        new.write_text(str(self.number))
        new.replace(counter)
        self.order = orders.get(str(self.number), orders.get("all", ""))
        self.cut = f"cut-{self.number}"
        response.success = True
        response.message = self.cut
        return response

    def say(self, values, level=DiagnosticStatus.OK, message=""):
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        status = DiagnosticStatus(level=level, name="axis: cut", message=message, values=pairs)
        self.result.publish(DiagnosticArray(status=[status]))

    def end(self):
        if self.cut is None:
            return
        cut, self.cut = self.cut, None
        gain, load = (self.get_parameter(name).value for name in ("gain", "load"))
        good = {"cut": cut, "error": (gain - 0.3) ** 2 + load, "peak": 0.2}
        if self.order == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.order == "stop":
            os.kill(os.getpid(), signal.SIGSTOP)
        if self.order == "foreign":
            self.result.publish(DiagnosticArray())
            self.result.publish(DiagnosticArray(status=[DiagnosticStatus()]))
            self.say({"error": 1e9, "peak": 1e9})
            self.say(good | {"cut": "cut-0", "error": "garbage"}, DiagnosticStatus.ERROR, "old")
            self.say(good | {"cut": cut + "0", "peak": "nan"})
        if self.order in ("nan", "inf", "garbage"):
            good["peak"] = self.order
        if self.order == "missing":
            del good["peak"]
        if self.order == "failed":
            self.say({"cut": cut}, DiagnosticStatus.ERROR, "stalled at 3 mm")
        elif self.order != "mute":
            self.say(good)


stopped = []
for signum in (signal.SIGINT, signal.SIGTERM):
    signal.signal(signum, lambda *_: stopped.append(1))
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = Drive()
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(node)
while not stopped:
    executor.spin_once(timeout_sec=0.05)
node.destroy_node()
rclpy.try_shutdown()
"""


def drive_study(**changes):
    """Study of the small node; changes are by section, merged with what is there."""
    axis = NODE | {"package": "drive", "executable": "axis_drive", "result": "~/cut_result"}
    study = study_mapping(
        name="drive",
        nodes={"axis": axis},
        trigger=NODE | {"service": "~/run", "timeout": 10.0},
        budget={
            "trials": 4,
            "initial_trials": 4,
            "drawn_contexts": 2,
            "search_evaluations": 0,
            "validation_draws": 2,
        },
        start=None,
    )
    return {
        key: value | changes.get(key, {}) if isinstance(value, dict) else value
        for key, value in study.items()
    }


def environment_of_nodes():
    """Variables by which a tuner finds the nodes that a test has started, to attach to them."""
    return {key: value for key, value in os.environ.items() if key.startswith(("ROS_", "FAST"))}


class Tune:
    """The command ``tune``, running."""

    def __init__(self, folder, study, arguments, changes, begin=Fork):
        self.folder = folder
        self._begin = begin
        self.mark = uuid.uuid4().hex
        file = folder / "study.yaml"
        file.write_text(json.dumps(study))  # YAML reads it, too
        self._changes = {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "HOME": str(folder),
            "CUTS": str(folder / "cuts"),
            MARK: self.mark,
        } | changes
        self.start("--study", file, *arguments)

    def start(self, *arguments):
        """Start the command, or start it again in the same folder."""
        with (self.folder / "out").open("w") as out, (self.folder / "err").open("w") as err:
            self.popen = self._begin(
                "tune",
                *arguments,
                folder=self.folder,
                env=self._changes,
                # The tuner finds a free domain and sets what isolates it by itself; that
                # LOCALHOST stands in the environment must not disturb it.
                without=(
                    "ROS_DOMAIN_ID",
                    "FASTDDS_BUILTIN_TRANSPORTS",
                    *PROFILE_VARIABLES,
                    "ROS_LOG_DIR",
                ),
                stdout=out,
                stderr=err,
                # A process group of its own, as a shell gives to a command.
                start_new_session=True,
            )

    @property
    def err(self):
        return (self.folder / "err").read_text()

    @property
    def out(self):
        return (self.folder / "out").read_text()

    @property
    def run_folder(self):
        return self.folder / "runs" / "latest"

    def nodes(self, name=""):
        """Pids of the nodes whose command line has the name."""
        found = []
        for pid in marked(self.mark, MARK):
            with contextlib.suppress(OSError):
                if name.encode() in Path(f"/proc/{pid}/cmdline").read_bytes():
                    found.append(pid)
        return found

    def wait_for(self, condition, what):
        wait_until(condition, what, self.popen, lambda: self.err)

    def wait_for_trial(self, number):
        self.wait_for(lambda: re.search(rf"^ *{number} ", self.err, re.M), f"trial {number}")

    def wait_for_nodes_to_end(self):
        wait_until(lambda: self.nodes() == [], "the nodes to end", said=lambda: self.err)

    def shared_memory(self):
        """Shared memory of the middleware in use, which stays behind when its process is killed.

        What lies in /dev/shm does not tell: other programs of this machine have theirs there.
        """
        pids = [self.popen.pid, *marked(self.mark, MARK)]
        maps = "".join(Path(f"/proc/{pid}/maps").read_text() for pid in pids)
        return re.findall(r"/dev/shm/.*fast.*", maps)

    def finish(self):
        """Wait for the end; returns the exit code. No node may be left."""
        code = self.popen.wait(DEADLINE)
        assert "Traceback" not in self.err, self.err
        assert marked(self.mark, MARK) == []
        for log in (self.folder / "runs").glob("*/log/*.log"):
            assert "Traceback" not in log.read_text(), log.read_text()
        return code

    def refusal(self):
        """Wait for the end after a mistake; returns the one line of complaint."""
        assert self.finish() == 2, self.err
        assert self.out == ""
        (line,) = self.err.splitlines()
        assert line.startswith("error: ")
        return line.removeprefix("error: ")

    def trials(self):
        return list(read_journal(self.run_folder / "journal.sqlite").trials)

    def lost(self):
        """Return the evaluations that were lost with their nodes."""
        evaluations = read_journal(self.run_folder / "journal.sqlite").evaluations
        return [e for e in evaluations if e.outcome.state is EvaluationState.LOST]

    def close(self):
        if self.popen.poll() is None:
            self.popen.kill()
            self.popen.wait()
        for pid in self.nodes():
            os.kill(pid, signal.SIGKILL)


def starter(folder, begin=Fork):
    """Yield a function that starts the command: arguments, and the environment by keywords."""
    started = []
    executable = folder / "prefix" / "lib" / "drive" / "axis_drive"
    executable.parent.mkdir(parents=True)
    executable.write_text(f"#!{sys.executable}\n{DRIVE}")
    executable.chmod(0o755)

    def start(*arguments, study=None, folder=folder, **environment):
        folder.mkdir(exist_ok=True)
        environment = {"AMENT_PREFIX_PATH": str(executable.parents[2])} | environment
        started.append(Tune(folder, study or drive_study(), arguments, environment, begin))
        return started[-1]

    yield start
    for command in started:
        command.close()
