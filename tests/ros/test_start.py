"""What a node makes of its command line and parameter files."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import DEADLINE

pytestmark = pytest.mark.ros

BAD = [
    ("mpc_controller", ["-p", "gain:=-1"], "gain: -1 is below the lower limit 1e-06"),
    ("mpc_controller", ["-p", "gain:=.nan"], "gain: nan is not finite"),
    ("mpc_controller", ["-p", "gain:=fast"], "gain: 'fast' is not a number"),
    ("mpc_controller", ["-p", "control_horizon:=3.0"], "control_horizon: 3.0 is not an integer"),
    (
        "mpc_controller",
        ["-p", "prediction_horizon:=3"],
        "prediction_horizon: 3 is below control_horizon 15; it must be at least as long",
    ),
    ("mpc_controller", ["-p", "lambda:=1.0"], "lambda: unknown parameter; expected one of"),
    ("mpc_controller", ["--params-file", "missing.yaml"], "missing.yaml"),
    ("mpc_controller", ["-r", "__ns:=w1"], "__ns:=w1"),
    ("milling_plant", ["-p", "seed:=true"], "seed: True is not an integer"),
    ("milling_plant", ["-p", "reference_levels:=[0.5, a]"], "reference_levels"),
    ("milling_plant", ["-p", "reference_levels:=[]"], "NOT_SET"),
    ("milling_plant", ["-p", "group.seed:=1"], "group.seed: unknown parameter"),
    ("milling_plant", ["--no-such-flag"], "--no-such-flag"),
]


@pytest.fixture(scope="module")
def bad_starts(start_shared_node):
    """All of them at once."""
    nodes = [start_shared_node(package, *arguments) for package, arguments, _ in BAD]
    for node in nodes:
        node.expected_code = 2
    yield nodes
    # Another worker may have taken the tests of some, which are about to end by themselves.
    for node in nodes:
        node.wait()


@pytest.mark.parametrize("index", range(len(BAD)), ids=[" ".join(case[1]) for case in BAD])
def test_a_bad_start_ends_with_one_line_and_code_2(bad_starts, index):
    node, (_, _, reason) = bad_starts[index], BAD[index]
    assert node.wait() == 2
    lines = [line for line in node.output.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert reason in lines[0]
    # What else is there comes from rcl's own log.
    others = [line for line in node.output.splitlines() if line not in lines]
    assert all("[rcl]" in line for line in others), node.output


def run_node(package, *arguments):
    """Run a node's executable that ends by itself."""
    command = [Path(sys.prefix) / "lib" / package / package, *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=DEADLINE)


@pytest.mark.parametrize("argument", ["--params-file", "gain:=2.0"])
def test_ros_arguments_without_their_mark_are_refused(ros_environment, argument):
    """Ignored, they would leave the node with its defaults."""
    done = run_node("mpc_controller", argument, "best.yaml")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        f"error: unexpected argument '{argument}'; expected ROS arguments only, "
        "such as: mpc_controller --ros-args --params-file FILE\n"
    )


@pytest.mark.parametrize("package", ["mpc_controller", "milling_plant"])
def test_help_names_the_parameters(ros_environment, start_node, peer, package):
    done = run_node(package, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"usage: {package} [--ros-args")
    assert "[rad/s]" in done.stdout
    start_node(package)
    listed = [line.split()[0] for line in done.stdout.partition("parameters:\n")[2].splitlines()]
    # Of names among which one is unknown, a node returns no value at all.
    assert len(peer.get_parameters(package, listed)) == len(listed) > 10


def test_whole_numbers_are_taken_for_doubles(start_node, peer):
    start_node("milling_plant", "-p", "gain:=2", "-p", "reference_levels:=[1, 2]")
    assert peer.get_parameters("milling_plant", ["gain"]) == [2.0]
    assert list(peer.get_parameters("milling_plant", ["reference_levels"])[0]) == [1.0, 2.0]


@pytest.mark.parametrize("key", ["/**", "mpc_controller", "/mpc_controller"])
def test_a_parameter_file_is_taken(start_node, peer, tmp_path, key):
    path = tmp_path / "best.yaml"
    path.write_text(
        f"{key}:\n  ros__parameters:\n    control_horizon: 1\n    prediction_horizon: 4\n"
        "    lambda_mpc: -3.9\n    lambda_kf: 2\n"
    )
    start_node("mpc_controller", "--params-file", str(path))
    names = ("control_horizon", "prediction_horizon", "lambda_mpc", "lambda_kf", "gain")
    assert peer.get_parameters("mpc_controller", names) == [1, 4, -3.9, 2.0, 1.0]


def test_the_command_line_comes_after_the_file(start_node, peer, tmp_path):
    path = tmp_path / "seed.yaml"
    path.write_text("/**:\n  ros__parameters:\n    seed: 3\n    noise_variance: 0\n")
    start_node("milling_plant", "--params-file", str(path), "-p", "seed:=4")
    assert peer.get_parameters("milling_plant", ["seed", "noise_variance"]) == [4, 0.0]


def test_a_node_that_idles_ends_on_the_first_signal(start_node, peer):
    node = start_node("mpc_controller")
    peer.get_parameters("mpc_controller", ["gain"])
    node.send(signal.SIGINT)
    assert node.wait() == 0
    assert node.output == ""
