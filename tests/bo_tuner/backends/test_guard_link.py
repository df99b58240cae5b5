"""What a tuner does about a guard that it does not hear; the time is made up, and nothing runs."""

from types import SimpleNamespace

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from bo_tuner.backends.ros.guard import link as link_module
from bo_tuner.backends.ros.guard.link import (
    DEAD,
    DOUBT,
    FORGOTTEN,
    LEASE,
    GuardActedError,
    GuardLink,
    GuardSilentError,
)
from bo_tuner.backends.ros.guard.messages import PERIOD, State
from bo_tuner.errors import BackendError

NODE = "/servo"
STEP = 0.05


class World:
    """A clock, a guard near the machine, and what the tuner's node takes of it."""

    def __init__(self):
        self.now = self.said = 1000.0
        self.speaks = True
        self.acts = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def take_message(self, *_):
        if not self.speaks or self.now - self.said < PERIOD:
            return None
        self.said = self.now
        state = State(
            "guard",
            digest="",
            study="",
            nodes=[NODE],
            topics=[],
            acts=self.acts,
            outcome="safe values set",
            takes_over=True,
            stands=True,
            settled=True,
            watches=True,
        )
        return serialize_message(String(data=str(state))), {"received_timestamp": self.now * 1e9}

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def world(monkeypatch):
    made = World()
    clock = SimpleNamespace(monotonic=lambda: made.now, time=lambda: made.now, sleep=made.sleep)
    monkeypatch.setattr(link_module, "time", clock)
    return made


@pytest.fixture
def link(world, tmp_path):
    """The link of a tuner that is at work and hears its guard."""
    node = SimpleNamespace(
        create_subscription=lambda *_, **__: SimpleNamespace(handle=world),
        create_publisher=lambda *_: SimpleNamespace(publish=lambda _: None),
        count_publishers=lambda _: 1,
        get_namespace=lambda: "/",
    )
    tuner = SimpleNamespace(node=node, served=0.0, wait_until=lambda condition, _: condition())
    plan = SimpleNamespace(full_names=lambda _: [NODE], digest="")
    made = GuardLink(tuner, plan, tmp_path)
    world.now += PERIOD
    made.begin(None, [])
    look(made, world, 1.0)
    yield made
    made.end()


def look(link, world, seconds, *, at_rest=False):
    """Look around for some time, as a process that is on the processor."""
    end = world.now + seconds
    while world.now < end:
        world.now += STEP
        link.look(at_rest=at_rest)


@pytest.mark.parametrize("gap", [0.5, 1.05, LEASE + 0.1, 30.0])
def test_both_were_off_the_processor_and_the_machine_is_left_safe_first(link, world, gap):
    world.speaks = False
    world.now += gap
    lives = world.now
    with pytest.raises(GuardSilentError):
        link.look(at_rest=False)
    assert world.now - lives <= DOUBT + STEP
    assert link.is_silent
    # Nothing keeps the tuner from that, nor from hearing Ctrl-C.
    begun = world.now
    link.look(at_rest=False)
    assert world.now == begun
    # Longer only where ROS may have to discover the guard anew.
    with pytest.raises(BackendError):
        look(link, world, 100.0)
    patience = FORGOTTEN if gap > LEASE else DEAD
    assert world.now - lives == pytest.approx(patience, abs=3 * STEP)


@pytest.mark.parametrize("acts", [0, 1])
def test_a_guard_that_is_heard_again_in_time(link, world, acts):
    world.speaks = False
    world.now += 5.0
    with pytest.raises(GuardSilentError):
        link.look(at_rest=False)
    world.speaks, world.acts = True, acts
    if acts:
        with pytest.raises(GuardActedError, match="safe values set"):
            look(link, world, 1.0)
    look(link, world, 5.0)
    assert not link.is_silent


def test_a_guard_that_lives_is_not_taken_for_silent(link, world):
    for gap in (0.3, 1.05, 30.0):
        world.now += gap
        look(link, world, 1.0)


def test_ahead_of_values_of_a_trial_it_is_waited_for(link, world):
    world.speaks = False
    world.now += 1.05
    lives = world.now
    with pytest.raises(BackendError, match="nothing is heard of it"):
        link.look(at_rest=True)
    assert world.now - lives == pytest.approx(DEAD, abs=3 * STEP)


def test_who_was_on_the_processor_all_the_time_watches_the_machine_meanwhile(link, world):
    world.speaks = False
    lives = world.now
    with pytest.raises(BackendError, match="nothing is heard of it"):
        look(link, world, 100.0)
    assert world.now - lives == pytest.approx(DEAD, abs=0.5)
