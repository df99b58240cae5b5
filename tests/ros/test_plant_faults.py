"""The plant against controllers that lose, repeat and invent messages, or die."""

import math

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from milling_nodes import Loop, values_of

from feed_axis_common.ros.messages import from_stamp, to_stamp

pytestmark = pytest.mark.ros

SAMPLES = 12
SHORT = {
    "reference_levels": [0.5, 0.6],
    "samples_per_level": SAMPLES // 2,
    "resend_period": 0.05,
    "command_timeout": 20.0,
}
# For those who count what comes: a repetition because the machine is busy would count as well.
ONCE = SHORT | {"resend_period": 10.0}


def distinct(messages):
    """Measurements by stamp; those that came twice must be equal."""
    by_time = {}
    for message in messages:
        by_time.setdefault(from_stamp(message.header.stamp), set()).add(message.velocity[0])
    assert all(len(values) == 1 for values in by_time.values())
    return by_time


def test_a_plain_controller_is_served(stand_in_controller):
    controller = stand_in_controller(**SHORT)
    result, level = controller.run_cut()
    assert level == DiagnosticStatus.OK
    assert result["status"] == "ok"
    controller.peer.spin_until(lambda: controller.references, "the reference")
    times = sorted(distinct(controller.measurements))
    assert [t - times[0] for t in times] == [k * 20_000_000 for k in range(SAMPLES)]
    (reference,) = {from_stamp(m.header.stamp) for m in controller.references}
    assert reference == times[0]
    points = controller.references[0].points
    assert [p.velocities[0] for p in points] == [0.5] * 6 + [0.6] * 6


def test_lost_measurements_are_sent_again(stand_in_controller):
    seen = []

    def deaf_to_first_copies(message):
        stamp = from_stamp(message.header.stamp)
        seen.append(stamp)
        lost = (stamp // 20_000_000) % 3 == 0 and seen.count(stamp) == 1
        return [] if lost else [(message.header.stamp, 0.5)]

    controller = stand_in_controller(deaf_to_first_copies, **SHORT)
    result, _ = controller.run_cut()
    assert result["status"] == "ok"
    assert result["samples"] == str(SAMPLES)
    assert int(result["resent_measurements"]) >= SAMPLES // 3
    assert len(distinct(controller.measurements)) == SAMPLES


def test_a_lost_first_measurement_comes_again_with_its_reference(stand_in_controller):
    seen = []

    def deaf_at_first(message):
        seen.append(message)
        return [(message.header.stamp, 0.5)] if len(seen) > 2 else []

    controller = stand_in_controller(deaf_at_first, **SHORT)
    result, _ = controller.run_cut()
    assert result["status"] == "ok"
    controller.peer.spin_until(lambda: len(controller.references) >= 2, "the reference again")
    assert len({from_stamp(m.header.stamp) for m in controller.references}) == 1


def test_answers_given_twice_are_taken_once_and_counted(stand_in_controller):
    controller = stand_in_controller(
        lambda message: [(message.header.stamp, 0.5), (message.header.stamp, 0.5)], **SHORT
    )
    result, _ = controller.run_cut()
    assert result["status"] == "ok"
    # The second answer of the last sample comes after the end.
    assert int(result["ignored_messages"]) >= SAMPLES - 1
    assert float(result["overshoot"]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("late", [1, SAMPLES - 1], ids=["in the cut", "after its end"])
def test_another_answer_to_a_sample_is_that_of_a_second_controller(stand_in_controller, late):
    """Also after the end, when the result is out already."""
    stamps = []

    def twice(message):
        stamps.append(message.header.stamp)
        other = [(stamps[0], 0.9)] if len(stamps) == late + 1 else []
        return [(message.header.stamp, 0.5), *other]

    controller = stand_in_controller(twice, **ONCE)
    first, _ = controller.run_cut()
    controller.peer.spin_until(lambda: says_disturbed(controller), "that it is disturbed")
    last = values_of(controller.results[-1])
    assert last["reason"].startswith("sample 0 has two commands, 0.5 and 0.9 m/s")
    assert last["cut"] == first["cut"]
    assert first["status"] == ("ok" if late == SAMPLES - 1 else "disturbed")
    stamps.clear()
    controller.answer = lambda message: [(message.header.stamp, 0.5)]
    assert controller.run_cut()[0]["status"] == "ok"


def says_disturbed(controller):
    (status,) = controller.results[-1].status
    return (
        status.level == DiagnosticStatus.ERROR
        and values_of(controller.results[-1])["status"] == "disturbed"
    )


def test_answers_with_other_stamps_are_ignored_and_counted(stand_in_controller):
    def beside(message):
        now = from_stamp(message.header.stamp)
        wrong = [to_stamp(now - 1), to_stamp(now + 20_000_000), to_stamp(now + 1), Time()]
        return [*((stamp, math.nan) for stamp in wrong), (message.header.stamp, 0.5)]

    controller = stand_in_controller(beside, **ONCE)
    result, _ = controller.run_cut()
    assert result["status"] == "ok"
    assert int(result["ignored_messages"]) == 4 * SAMPLES


def test_commands_for_other_joints_are_ignored_and_counted(stand_in_controller):
    controller = stand_in_controller(**ONCE)

    def other_joint_first(message):
        controller.publish(message.header.stamp, 5.0, joint="spindle")
        return [(message.header.stamp, 0.5)]

    controller.answer = other_joint_first
    result, _ = controller.run_cut()
    assert result["status"] == "ok"
    assert int(result["ignored_messages"]) == SAMPLES


@pytest.mark.parametrize("command", [math.nan, math.inf])
def test_a_command_that_is_not_finite_fails_the_cut(stand_in_controller, command):
    controller = stand_in_controller(lambda m: [(m.header.stamp, command)], **SHORT)
    result, level = controller.run_cut()
    assert level == DiagnosticStatus.ERROR
    assert result["status"] == "failed"
    assert result["reason"] == f"command of sample 0 is {command}"
    assert "tracking_error" not in result


def test_a_controller_that_falls_silent_fails_the_cut_in_time(stand_in_controller):
    seen = set()

    def five_answers(message):
        seen.add(from_stamp(message.header.stamp))
        return [(message.header.stamp, 0.5)] if len(seen) <= 5 else []

    controller = stand_in_controller(five_answers, **SHORT | {"command_timeout": 5.0})
    result, level = controller.run_cut()
    assert level == DiagnosticStatus.ERROR
    assert result["reason"] == "no command for sample 5 within 5.0 s"
    assert result["samples"] == "5"

    # The next cut starts afresh.
    controller.answer = lambda m: [(m.header.stamp, 0.5)]
    assert controller.run_cut()[0]["status"] == "ok"


def test_a_resend_period_beyond_the_timeout_does_not_hide_it(stand_in_controller):
    controller = stand_in_controller(
        lambda message: [], **SHORT | {"resend_period": 60.0, "command_timeout": 0.2}
    )
    result, _ = controller.run_cut()
    assert result["reason"] == "no command for sample 0 within 0.2 s"


def test_a_controller_killed_in_a_cut_fails_it_with_the_reason(start_node, make_peer):
    remap = ("-r", "__ns:=/killed")
    start_node("milling_plant", *remap, "-p", "command_timeout:=2.0")
    controller = start_node("mpc_controller", *remap)
    loop = Loop(make_peer("/killed"))
    loop.connect()
    loop.set("milling_plant", reference_levels=[0.5], samples_per_level=5_000)
    cut = None
    while cut is None or loop.has_result("milling_plant", cut):
        # On a loaded machine a command may take its two seconds with both nodes alive.
        cut = loop.start_cut()
        loop.peer.spin_until(
            lambda cut=cut: len(loop.commands) > 50 or loop.has_result("milling_plant", cut),
            "the cut to run",
        )
    controller.kill()
    message = loop.result("milling_plant", cut)
    (status,) = message.status
    assert status.level == DiagnosticStatus.ERROR
    assert status.message.startswith("no command for sample ")
    assert status.message.endswith(" within 2.0 s")

    # With a new controller the plant goes on.
    start_node("mpc_controller", *remap)
    loop.set("milling_plant", samples_per_level=5, command_timeout=10.0)
    loop.connect()
    plant, controller = loop.run_cut()
    assert (plant["status"], controller["status"]) == ("ok", "ok")
