"""A run as other programs of the ROS graph see it, and what they may ask of it."""

import importlib
import json
import os
import re
from xml.etree import ElementTree

import pytest
import yaml
from waiting import count_in

from bo_tuner.package_files import config_directory

pytestmark = pytest.mark.ros

CONFIG = config_directory()
HEADLINES = ("objective", "best_objective", "probability_feasible", "worst_case")
STATUSES = {"tuner: progress", "tuner: surrogate", "tuner: safety"}


def values_of(status):
    return {item.key: item.value for item in status.values}


class Watcher:
    """A node of the test that hears what the tuner tells from now on, and what it has latched."""

    def __init__(self, peer):
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import Float64

        latched = QoSProfile(depth=10_000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.peer = peer
        self.received = {}
        for name, message in [
            ("tuner/trial_result", DiagnosticArray),
            *((f"tuner/{name}", Float64) for name in HEADLINES),
        ]:
            messages = self.received[name.removeprefix("tuner/")] = []
            peer.node.create_subscription(message, name, messages.append, latched)
        self.diagnostics = peer.record(DiagnosticArray, "/diagnostics")

    def results(self):
        """Statuses of the trials so far, by number."""
        found = [message.status[0] for message in self.received["trial_result"]]
        return {int(values_of(status)["trial"]): status for status in found}

    def progress(self):
        """Details of the latest diagnostics of the progress."""
        statuses = {status.name: status for status in self.diagnostics[-1].status}
        return values_of(statuses["tuner: progress"])

    def wait_for_progress(self, what, **expected):
        self.diagnostics.clear()
        self.peer.spin_until(
            lambda: self.diagnostics and self.progress().items() >= expected.items(), what
        )

    def wait_for_trial(self, number):
        self.peer.spin_until(lambda: number in self.results(), f"trial {number}")


@pytest.fixture
def watch(make_peer):
    return lambda: Watcher(make_peer())


@pytest.fixture
def run(tune):
    """Function that starts the tuner, or lets it go on, in the domain of the test."""

    def start(*arguments):
        return tune(*arguments, ROS_DOMAIN_ID=os.environ["ROS_DOMAIN_ID"])

    return start


def test_a_late_joiner_gets_all_trials_also_of_a_resumed_run(run, watch):
    command = run("--trials", "1000")
    command.wait_for_trial(5)
    first = watch()
    first.wait_for_trial(5)
    assert sorted(first.results()) == list(range(max(first.results()) + 1))
    first.peer.spin_until(lambda: first.diagnostics, "diagnostics")
    assert {status.name for status in first.diagnostics[-1].status} == STATUSES
    assert first.progress()["budget"] == "1000"

    answer = first.peer.trigger("tuner/abort")
    assert answer.success
    assert command.finish() == 143, command.err
    last = command.err.splitlines()[-1]
    assert last.startswith("interrupted by the service ~/abort; resume it with: tune --resume ")
    assert answer.message.partition("tune --resume ")[2] == last.partition("tune --resume ")[2]
    done = command.trials()
    assert [trial.reason for trial in done if trial.reason] == []

    command.start("--resume", command.run_folder)
    command.wait_for_trial(len(done))
    second = watch()
    second.wait_for_trial(len(done))
    results = second.results()
    assert sorted(results) == list(range(len(results)))
    for trial in done:
        status = results[trial.number]
        values = values_of(status)
        assert status.name == "tuner: trial_result"
        assert float(values["parameters.gain"]) == trial.parameters["gain"]
        errors = trial.observations("error")
        assert float(values["metrics.error"]) == sum(errors) / len(errors)
    # Of the numbers without a stamp only the latest is latched.
    second.peer.spin_until(lambda: all(second.received.values()), "the headline numbers")
    assert second.peer.trigger("tuner/abort").success
    assert command.finish() == 143


def test_a_run_finishes_with_the_best_so_far(run, watch):
    command = run("--trials", "1000")
    command.wait_for_trial(3)
    answer = watch().peer.trigger("tuner/finish")
    assert answer.success
    assert answer.message.startswith("the run begins no further trial; the best so far is then ")
    assert command.finish() in (0, 3), command.err
    assert 4 <= len(command.trials()) < 1000
    assert (command.run_folder / "best.yaml").exists()


def test_pause_and_what_is_published(run, watch, shared_pair):
    from std_srvs.srv import SetBool

    command = run("--trials", "1000")
    command.wait_for_trial(0)
    watcher = watch()
    answer = watcher.peer.call(SetBool, "tuner/pause", SetBool.Request(data=True))
    assert answer.success
    watcher.wait_for_progress("the pause", paused="True")
    # It says so where it waits; the service has answered before that.
    going_on = (
        "paused; continue it by the service /tuner/pause (std_srvs/srv/SetBool, data: false), or "
        "end the run with Ctrl-C and resume it with: tune --resume runs/"
    )
    command.wait_for(lambda: going_on in command.err, "the pause")
    cuts = count_in(command.folder / "cuts")
    watcher.diagnostics.clear()
    watcher.peer.spin_until(lambda: len(watcher.diagnostics) >= 2, "signs of life in the pause")
    # It tells of itself, and not faster than once a second; and no cut is run.
    assert count_in(command.folder / "cuts") == cuts
    times = [message.header.stamp.sec for message in watcher.diagnostics]
    assert len(times) <= times[-1] - times[0] + 2

    shown = {"/joint_states", "/mpc_controller/command"}
    node = watcher.peer.node
    watcher.peer.spin_until(
        lambda: shown <= dict(node.get_topic_names_and_types()).keys(), "what the layouts show"
    )
    layouts_name_what_is_there(node)

    watcher.peer.call(SetBool, "tuner/pause", SetBool.Request(data=False))
    watcher.wait_for_progress("the end of the pause", paused="False")
    command.wait_for(lambda: count_in(command.folder / "cuts") > cuts, "a cut")
    # A pause does not keep a run from being ended.
    watcher.peer.call(SetBool, "tuner/pause", SetBool.Request(data=True))
    watcher.wait_for_progress("the pause", paused="True")
    assert watcher.peer.trigger("tuner/abort").success
    assert command.finish() == 143, command.err


def layouts_name_what_is_there(node):
    """Hold each name in the layouts against the graph and the message types."""
    topics = dict(node.get_topic_names_and_types())
    services = dict(node.get_service_names_and_types())

    def kind(name):
        package, _, message = topics[name][0].split("/")
        return getattr(importlib.import_module(f"{package}.msg"), message)

    layout = json.loads((CONFIG / "foxglove_layout.json").read_text())
    panels = layout["configById"]
    placed = re.findall(r"'(\w+!\w+)'", str(layout["layout"]))
    assert sorted(placed) == sorted(panels)
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    paths += [panel["topicPath"] for panel in panels.values() if "topicPath" in panel]
    assert len(paths) >= 5
    for path in paths:
        topic, _, field = path.partition(".")
        assert re.match(r"\w+", field)[0] in kind(topic).get_fields_and_field_types()
    for panel in panels.values():
        if "serviceName" in panel:
            assert panel["serviceName"] in services
            json.loads(panel["requestPayload"])
        assert panel.get("topicToRender", "/diagnostics") in topics

    root = ElementTree.parse(CONFIG / "plotjuggler_layout.xml").getroot()
    subscribed = root.find(".//selected_topics").get("list").split(";")
    assert set(subscribed) <= topics.keys()
    curves = [curve.get("name") for curve in root.iter("curve")]
    assert len(curves) >= 5
    for curve in curves:
        (topic,) = [name for name in subscribed if curve.startswith(f"{name}/")]
        # In between stands the joint.
        field = curve.rpartition("/")[2]
        assert field in kind(topic).get_fields_and_field_types()

    aggregator = yaml.safe_load((CONFIG / "diagnostics_aggregator.yaml").read_text())
    tuner = aggregator["analyzers"]["ros__parameters"]["tuner"]
    assert set(tuner["expected"]) == STATUSES
    assert all(name.startswith(tuple(tuner["startswith"])) for name in STATUSES)
