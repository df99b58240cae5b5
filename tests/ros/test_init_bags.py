"""The command `init` on bags and an estimator: what it hears and answers, and what is written."""

import shutil
import sys
from pathlib import Path

import pytest
from in_process import call
from nav_msgs.msg import Odometry
from node_threads import at_work
from rclpy.node import Node
from sensor_msgs.msg import Imu

from bo_tuner.cli import check, init
from bo_tuner.study.study_file import load_study

pytestmark = pytest.mark.ros

FOLDER = Path(__file__).parents[2] / "examples/estimators"
sys.path.append(str(FOLDER))
make_drives = pytest.importorskip("make_drives")

SECONDS = 4.0
EKF = f"'{sys.executable}' '{FOLDER / 'ekf_node.py'}'"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    for seed in (1, 2):
        make_drives.write(folder / f"drive_{seed}", seed, SECONDS)
    return folder


@pytest.fixture
def run(empty_domain, drives, tmp_path, capsys, monkeypatch):
    """Function that runs a command in this process, in a folder with the drives."""
    commands = {"init": init, "check": check}
    for name in ("graph.LOOK_AROUND", "bringup.LOOK_AROUND", "survey.CHANGES"):
        monkeypatch.setattr(f"bo_tuner.backends.ros.{name}", 0.1)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(drives, tmp_path / "drives")
    return lambda command, *arguments: call(commands[command], capsys, *arguments)


class Follower(Node):
    """Hears one of the topics, and answers each second message."""

    def __init__(self, context, heard="/imu"):
        super().__init__("follower", context=context)
        self.declare_parameter("bias_noise", 0.1)
        self.count = 0
        self.publisher = self.create_publisher(Odometry, "/estimate", 10)
        self.create_subscription(Imu, heard, self.take, 10)

    def take(self, message):
        self.count += 1
        estimate = Odometry(header=message.header)
        estimate.pose.pose.position.x = self.count * self.get_parameter("bias_noise").value
        if self.count % 2 == 0:
            self.publisher.publish(estimate)


def test_a_node_that_is_started(run, tmp_path):
    code, out, err = run("init", "drives/drive_1", "drives/drive_2", "--command", EKF)
    assert (code, err) == (0, "")
    assert "ekf heard /wheel/odom, /fix and /imu\n" in out
    assert "messages on /imu are answered on /estimate\n" in out
    assert "estimate: /estimate; truth: /ground_truth (by its name)\n" in out
    study = load_study(tmp_path / "study.yaml")
    assert [*study.parameters] == ["speed_noise", "bias_walk", "fix_noise"]
    assert study.contexts["drive"].distribution.values == ("drives/drive_1", "drives/drive_2")
    code, out, err = run("check", "study.yaml", "--no-sensitivity")
    assert (code, err) == (0, "")
    assert "the nodes match the study: 3 parameters and 9 signals\n" in out
    assert "write answers: {/imu: /estimate} into play\n" in out


def test_a_node_that_runs_already(run, tmp_path):
    """It is not started anew; parameters that are no estimator's by their names are taken."""
    with at_work(Follower):
        code, out, err = run("init", "mine.yaml", "drives/drive_1")
        assert (code, err) == (0, "")
        assert "messages on /imu, every 2, are answered on /estimate\n" in out
        code, out, err = run("check", "mine.yaml", "--no-sensitivity")
    assert (code, err) == (0, "")
    study = load_study(tmp_path / "mine.yaml")
    assert [*study.parameters] == ["bias_noise"]
    assert not study.nodes["follower"].command


def test_a_node_that_hears_nothing_of_the_bag(run, tmp_path):
    with at_work(lambda context: Follower(context, "/imu/data")):
        code, _, err = run("init", "drives/drive_1")
    assert code == 2
    assert "drive_1': no node hears a topic of it: it has /ground_truth (nav_msgs/msg/Odom" in err
    assert "and heard are /imu/data (sensor_msgs/msg/Imu); start the node with the names of" in err
    assert err.count("\n") == 1
    assert not list(tmp_path.glob("*.yaml"))


def test_a_command_that_ends(run):
    code, _, err = run(
        "init", "drives/drive_1", "--command", f"'{sys.executable}' -c 'raise SystemExit(3)'"
    )
    assert (code, "--command: " in err, "exit code 3" in err) == (2, True, True)


def test_bags_that_cannot_be_used(run, tmp_path):
    shutil.copytree("drives/drive_1", "cut")
    (file,) = Path("cut").glob("*.mcap")
    file.write_bytes(file.read_bytes()[:20_000])
    shutil.copytree("drives/drive_1", "twice")
    for arguments, expected in (
        (["drives/drive_3"], "expected a file name that ends in .yaml, or a bag, found drives/dri"),
        (["none.mcap"], "'none.mcap': there is no such file or folder with metadata.yaml"),
        (["cut"], "'cut': cannot be read: "),
        (["drives/drive_1", "twice"], "twice is of the same drive as drives/drive_1; expected one"),
        (["drives/drive_1", "--command", "no_such_node"], "--command: there is no program no_such"),
        (["drives/drive_1", "--command", "'"], "--command: expected words"),
        (["--command", EKF], "--command: name the bags that the node is to hear"),
        (["a.yaml", "b.yaml"], "one study file is written, found a.yaml and b.yaml"),
    ):
        code, _, err = run("init", *arguments)
        assert (code, expected in err, err.count("\n")) == (2, True, 1), err
    assert not list(tmp_path.glob("*.yaml"))
