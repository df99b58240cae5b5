"""`check` tries each parameter: what moves a metric, and what a node never looks at."""

import json
import os
import re
import signal
import sys

import pytest
from commands import Fork, finish
from node_threads import at_work
from rclpy.node import Node
from std_msgs.msg import Float64
from waiting import wait_until

pytestmark = pytest.mark.ros

ODD_JOBS = """\
import sys, time
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Float64

rclpy.init()
node = Node("odd")
gain = node.declare_parameter("gain", 1.0).value
node.declare_parameter("offset", 1.0)
out = node.create_publisher(Float64, "out", 10)

def answer(message):
    value = message.data + gain + node.get_parameter("offset").value
    out.publish(Float64(data=value + 0.001 * (time.monotonic_ns() % 7)))

node.create_subscription(Float64, "ask", answer, 10)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    sys.exit(0)
"""
"""Reads its gain while it starts, and its offset for each answer."""


class Odd(Node):
    """The same in a thread of the test, with what it was told on record."""

    def __init__(self, context):
        super().__init__("odd", context=context)
        self.gain = self.declare_parameter("gain", 1.0).value
        self.declare_parameter("offset", 1.0)
        self.declare_parameter("fast", True)
        self.answers = 0
        self.offsets = []
        self.out = self.create_publisher(Float64, "out", 10)
        self.create_subscription(Float64, "ask", self.answer, 10)
        self.add_post_set_parameters_callback(self.told)

    def told(self, parameters):
        self.offsets += [p.value for p in parameters if p.name == "offset"]

    def answer(self, message):
        self.answers += 1
        noise = 0.001 * (self.answers % 7)
        offset = self.get_parameter("offset").value
        self.out.publish(Float64(data=message.data + self.gain + offset + noise))


@pytest.fixture
def odd(empty_domain):
    with at_work(Odd) as node:
        yield node


def write_study(folder, *names, **changes):
    """A study of the answer to one question."""
    number = {"node": "odd", "type": "double", "bounds": [0.0, 4.0], "default": 1.0}
    kinds = {"gain": number, "offset": number, "fast": {"node": "odd"}}
    mapping = {
        "name": "odd",
        "nodes": {"odd": {"node": "odd"}},
        "parameters": {name: kinds[name] for name in names},
        "signals": {
            "out": {"topic": "/out", "field": "data"},
            "ask": {"topic": "/ask", "field": "data"},
        },
        "run": {
            # What is said last before the start is part of the run.
            "before": [
                {"publish": {"topic": "/ask", "message": {"data": 0.0}}},
                {"wait": 0.1},
            ],
            "start": [
                {"publish": {"topic": "/ask", "message": {"data": 0.0}}},
                {"wait": 0.05},
                {"publish": {"topic": "/ask", "message": {"data": 2.0}}},
            ],
            # Judged once the steps of start are done, however late they are.
            "end": {"when": "t > 0.3"},
        },
        "metrics": {"level": {"of": "out", "measure": "maximum", "unit": "m"}},
        "objective": {"metric": "level"},
        "budget": {"trials": 3, "initial_trials": 2, "drawn_contexts": 1, "validation_draws": 2},
    }
    (folder / "odd.yaml").write_text(json.dumps(mapping | changes))


def check(folder, *options):
    return finish(Fork("check", "odd.yaml", *options, folder=folder))


def one_line(text):
    return " ".join(text.split())


def test_a_parameter_that_does_nothing_is_named(odd, tmp_path):
    """Attached: small steps of numbers, and the node has its values again."""
    write_study(tmp_path, "gain", "offset", "fast")
    code, out, err = check(tmp_path)
    assert code == 0, err
    assert "trying 2 parameters in small steps from the default: 14 runs, about " in out
    assert len(err.splitlines()) == 1, err
    (line,) = err.splitlines()
    assert re.match(
        r"warning: gain was not seen to move any metric \(an effect above 0\.0\d+ m on level would "
        r"have been seen\); tried: 0\.8 and 1\.2, beside the default 1$",
        line,
    ), line
    # An effect may be too small to see in a step: nothing is said against the node.
    assert "only while it starts" not in out
    assert "--sensitivity tries the whole range" in out
    assert "note: not tried: fast cannot be moved alone" in out
    table = out.partition("what the parameters move")[2].partition("note: ")[0]
    (row,) = [line for line in table.splitlines() if "level" in line]
    assert "offset" in row
    assert min(odd.offsets) == pytest.approx(0.8)
    assert max(odd.offsets) == pytest.approx(1.2)
    assert odd.get_parameter("offset").value == odd.get_parameter("gain").value == 1.0


def test_the_whole_range_where_it_is_asked_for(odd, tmp_path):
    """Nothing to tune is an answer of its own."""
    write_study(tmp_path, "gain", "fast")
    code, out, err = check(tmp_path, "--sensitivity")
    assert code == 3
    assert "trying 2 parameters over the whole range: 12 runs, about " in out
    assert [line.split(" was not")[0] for line in err.splitlines()] == [
        "error: gain",
        "error: fast",
    ]
    assert "tried: 0 and 4, beside the default 1" in err
    assert "small steps" not in out
    assert "odd may read gain and fast only while it starts: with at_start: true under" in out


def test_not_at_all(odd, tmp_path):
    write_study(tmp_path, "gain", "offset")
    code, out, err = check(tmp_path, "--no-sensitivity")
    assert (code, err) == (0, "")
    assert "trying" not in out
    assert odd.answers == 2 * 3


def test_nodes_that_the_check_starts_have_the_whole_range(empty_domain, tmp_path):
    (tmp_path / "odd.py").write_text(ODD_JOBS)
    nodes = {"odd": {"node": "odd", "command": f"'{sys.executable}' odd.py"}}
    write_study(tmp_path, "gain", "offset", nodes=nodes)
    code, out, err = check(tmp_path)
    assert code == 0, err
    assert "over the whole range" in out
    (line,) = err.splitlines()
    assert line.startswith("warning: gain was not seen to move any metric")
    assert line.endswith("tried: 0 and 4, beside the default 1")


def test_a_check_that_is_interrupted_leaves_the_node_as_it_was(odd, tmp_path):
    """In the middle of a run with another value: parked first, and then set back."""
    park = {"parameters": {"offset": 0.5}}
    # A value of its own that is neither the default nor the safe one.
    write_study(tmp_path, "offset", park=park)
    command = Fork("check", "odd.yaml", "--sensitivity", folder=tmp_path)
    wait_until(lambda: odd.get_parameter("offset").value == 4.0, "a run at the end of the range")
    os.kill(command.pid, signal.SIGINT)
    code, _, err = finish(command)
    assert code == 130
    assert "interrupted by" in one_line(err)
    assert odd.offsets[-2:] == [0.5, 1.0]


def test_runs_that_fail_at_one_end(odd, tmp_path):
    """They are no failure of the check, and the parameter is not one that does nothing."""
    write_study(tmp_path, "offset")
    mapping = json.loads((tmp_path / "odd.yaml").read_text())
    mapping["run"]["abort_when"] = "out > 6"
    (tmp_path / "odd.yaml").write_text(json.dumps(mapping))
    code, out, err = check(tmp_path, "--sensitivity")
    assert (code, err) == (0, "")
    assert "note: offset 4: 2 of 2 runs failed: aborted at " in one_line(out)
