"""What nodes tell of their parameters, as it comes from a middleware that is not there."""

import contextlib
from types import SimpleNamespace

import pytest
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rclpy.serialization import serialize_message

from bo_tuner.backends.ros.parameters.events import ParameterWatch
from bo_tuner.backends.ros.parameters.messages import to_messages


class Events(contextlib.nullcontext):
    """The subscription to the events, in the order in which they were published."""

    def __init__(self):
        super().__init__()
        self.waiting = []

    def tell(self, kind, **values):
        event = ParameterEvent(node="/axis", **{f"{kind}_parameters": to_messages(values)})
        self.waiting.append(serialize_message(event))

    def take_message(self, _type, _raw):
        return (self.waiting.pop(0), {}) if self.waiting else None


@pytest.fixture
def events():
    return Events()


@pytest.fixture
def watch(events):
    node = SimpleNamespace(
        get_name=lambda: "tuner",
        get_namespace=lambda: "/",
        create_subscription=lambda *_args, **_options: SimpleNamespace(handle=events),
    )
    watch = ParameterWatch(node, {"axis": "axis"})
    watch.expect({"axis": {"gain": 2.0}})
    return watch


def seen(watch):
    return [str(difference) for difference in watch.take_seen()]


def test_other_values_are_seen_and_the_own_are_not(watch, events):
    events.tell("changed", gain=2.0, limit=7.0)
    assert seen(watch) == []
    events.tell("changed", gain=3.0)
    events.tell("changed", gain=2.0)
    assert seen(watch) == ["axis: parameter gain is 3.0, expected 2.0"]
    events.tell("deleted", gain=2.0)
    assert seen(watch) == ["axis: parameter gain is not set, expected 2.0"]


@pytest.mark.parametrize("late", [False, True])
def test_what_a_node_declares_when_it_is_started_anew_is_no_change(watch, events, late):
    """It may become known after the tuner has asked the node for it."""
    if not late:
        events.tell("new", gain=0.5)
    watch.forget("axis")
    if late:
        events.tell("new", gain=0.5)
    events.tell("changed", gain=2.0)
    assert seen(watch) == []
    # A node that declares its parameters after that is another one.
    events.tell("new", gain=0.5)
    assert seen(watch) == ["axis: parameter gain is 0.5, expected 2.0"]


def test_a_change_by_others_counts_right_after_a_start(watch, events):
    watch.forget("axis")
    events.tell("new", gain=0.5)
    events.tell("changed", gain=3.0)
    assert seen(watch) == ["axis: parameter gain is 3.0, expected 2.0"]


def test_a_late_event_of_the_own_change_is_no_change_by_others(watch, events):
    """It comes when the next values are expected, once; the same value again is somebody else's."""
    watch.expect_event("axis", {"gain": 1.0, "load": 3.0})
    watch.expect_event("axis", {"gain": 2.0})
    events.tell("changed", gain=1.0, load=3.0)
    events.tell("changed", gain=2.0)
    assert seen(watch) == []
    events.tell("changed", gain=1.0, load=3.0)
    assert seen(watch) == ["axis: parameter gain is 1.0, expected 2.0"]


def test_what_was_refused_is_not_awaited(watch, events):
    watch.expect_event("axis", {"gain": 1.0})
    watch.take_back("axis", {"gain": 1.0})
    events.tell("changed", gain=1.0)
    assert seen(watch) == ["axis: parameter gain is 1.0, expected 2.0"]


def test_an_event_that_was_lost_keeps_none_of_the_later_ones(watch, events):
    watch.expect_event("axis", {"gain": 0.5})
    watch.expect_event("axis", {"gain": 1.0})
    events.tell("changed", gain=1.0)
    assert seen(watch) == []
    events.tell("changed", gain=0.5)
    assert seen(watch) == ["axis: parameter gain is 0.5, expected 2.0"]


def test_only_an_empty_array_has_the_type_of_what_it_replaces():
    """An integer for a double is for the node to refuse, with its reason."""
    types = {
        "gains": ParameterType.PARAMETER_DOUBLE_ARRAY,
        "gain": ParameterType.PARAMETER_DOUBLE,
        "name": ParameterType.PARAMETER_STRING,
        "unset": ParameterType.PARAMETER_NOT_SET,
        "odd": 77,
    }
    values = {"gains": [], "gain": 0, "name": "", "unset": [], "odd": [], "taps": [], "other": 2.0}
    found = {m.name: m.value.type for m in to_messages(values, types)}
    expected = {
        "gains": ParameterType.PARAMETER_DOUBLE_ARRAY,
        "gain": ParameterType.PARAMETER_INTEGER,
        "name": ParameterType.PARAMETER_STRING,
        # Nobody can tell.
        "unset": ParameterType.PARAMETER_BYTE_ARRAY,
        "odd": ParameterType.PARAMETER_BYTE_ARRAY,
        "taps": ParameterType.PARAMETER_BYTE_ARRAY,
        "other": ParameterType.PARAMETER_DOUBLE,
    }
    assert found == expected
