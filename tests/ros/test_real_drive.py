"""The controller with a drive in the plant's place: topics only, stamps as they come."""

import itertools
import math
from functools import partial

import cuts
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from feed_axis_common.ros.messages import cut_identifier
from mpc_controller.node import LONGEST_GAP

pytestmark = pytest.mark.ros

PERIOD = 20_000_000
REFERENCE = [0.5] * 4 + [0.7] * 4
VELOCITIES = [0.5, 0.49, 0.52, 0.5, 0.51, 0.6, 0.66, 0.71]

expected_commands = partial(cuts.expected_commands, velocities=VELOCITIES, reference=REFERENCE)
starts = itertools.count(1_700_000_000_123_456_789, 10**12)


@pytest.fixture
def t0():
    """Time [ns] of a cut that no other test has used; the tests share their controller."""
    return next(starts)


def samples_from(start):
    """Times [ns] of a cut's samples."""
    return [start + k * PERIOD for k in range(len(REFERENCE))]


def run(drive, times, velocities=VELOCITIES):
    """Publish each measurement after the command for the one before."""
    commands = []
    for time, v in zip(times, velocities, strict=False):
        drive.state(time, [v])
        commands.append(drive.command_for(time))
    return commands


def test_a_drive_is_commanded_as_the_controller_object_says(drive, t0):
    drive.reference(REFERENCE, start=t0)
    assert run(drive, samples_from(t0)) == expected_commands()
    values, level, message = drive.result()
    assert level == DiagnosticStatus.OK
    assert message == ""
    assert values["cut"] == cut_identifier(t0)
    assert values["samples"] == "8"
    assert values["return_time_source"] == "measured"
    assert all(m.name == ["x_axis"] for m in drive.commands)


def test_one_joint_among_several_and_a_reference_without_a_stamp(drive, t0):
    """A drive's own message: all axes, in its order; the cut starts with the next measurement."""
    joints = ("y_axis", "x_axis", "spindle")
    rows = [[9.0, v, 300.0] for v in REFERENCE]
    drive.reference(None, start=0, joints=joints, rows=rows)
    drive.deliver()
    commands = []
    for k, v in enumerate(VELOCITIES):
        # Stamps that jitter by a tenth of a sample, after the first.
        time = t0 + k * PERIOD + (k > 0) * (k % 3 - 1) * PERIOD // 10
        drive.state(time, [7.0, v, 1200.0], joints)
        commands.append(drive.command_for(time))
    assert commands == expected_commands()
    assert drive.result()[0]["cut"] == cut_identifier(t0)


def test_messages_of_other_joints_neither_start_nor_count(drive, t0):
    """Also not for the time of the first sample, though another drive publishes more often."""
    drive.reference(REFERENCE, start=0)
    drive.deliver()
    drive.state(t0 - 10 * PERIOD, [3.0], ["spindle"])
    commands = []
    for k, v in enumerate(VELOCITIES):
        drive.state(t0 + k * PERIOD, [v])
        commands.append(drive.command_for(t0 + k * PERIOD))
        drive.state(t0 + k * PERIOD + PERIOD // 2, [3.0], ["spindle"])
    assert commands == expected_commands()
    values, _, _ = drive.result()
    assert values["cut"] == cut_identifier(t0)
    assert values["status"] == "ok"
    assert int(values["ignored_messages"]) >= 1


def test_a_measurement_ahead_of_its_reference_is_kept(drive, t0):
    drive.state(t0, [VELOCITIES[0]])
    drive.peer.spin_for(0.1)
    drive.state(t0 + PERIOD // 3, [3.0], ["spindle"])
    drive.peer.spin_for(0.1)
    drive.reference(REFERENCE, start=t0)
    assert drive.command_for(t0) == expected_commands()[0]
    assert run(drive, samples_from(t0)) == expected_commands()


def test_a_measurement_ahead_of_its_reference_is_kept_after_an_earlier_cut(drive, t0):
    """Cuts are faster than real time: the stamps of the next may lie within those of the last."""
    drive.reference(REFERENCE, start=t0)
    run(drive, samples_from(t0))
    start = t0 + 3 * PERIOD
    drive.state(start, [VELOCITIES[0]])
    drive.peer.spin_for(0.1)
    drive.commands.clear()
    drive.reference(REFERENCE, start=start)
    assert drive.command_for(start) == expected_commands()[0]


def test_a_repeated_measurement_gets_the_same_answer(drive, t0):
    drive.reference(REFERENCE, start=t0)
    for k, v in enumerate(VELOCITIES):
        drive.state(t0 + k * PERIOD, [v])
        drive.command_for(t0 + k * PERIOD)
        drive.commands.clear()
        drive.state(t0 + k * PERIOD, [v + 1.0])
        assert drive.command_for(t0 + k * PERIOD) == expected_commands()[k]
    assert drive.result()[0]["status"] == "ok"


def test_old_measurements_are_not_answered(drive, t0):
    drive.reference(REFERENCE, start=t0)
    run(drive, samples_from(t0)[:4])
    drive.commands.clear()
    drive.state(t0 + PERIOD, [9.0])
    drive.state(t0 - 50 * PERIOD, [9.0])
    drive.state(t0 + 50 * PERIOD, [9.0])
    drive.state(t0 + 4 * PERIOD, [VELOCITIES[4]])
    assert drive.command_for(t0 + 4 * PERIOD) == expected_commands()[4]
    assert len(drive.commands) == 1


def test_lost_measurements_are_bridged_by_the_model_and_counted(drive, t0):
    drive.reference(REFERENCE, start=t0)
    times = [t0 + k * PERIOD for k in (0, 1, 2, 5, 6, 7)]
    velocities = [VELOCITIES[k] for k in (0, 1, 2, 5, 6, 7)]
    gap = [*VELOCITIES[:3], None, None, *VELOCITIES[5:]]
    expected = expected_commands(velocities=gap)
    assert run(drive, times, velocities) == [expected[k] for k in (0, 1, 2, 5, 6, 7)]
    values, level, message = drive.result()
    assert level == DiagnosticStatus.ERROR
    assert message == "sample 3: the measurement was lost"
    assert values["fallbacks"] == "2"
    assert values["samples"] == "8"


def test_as_many_measurements_as_allowed_can_be_lost_and_no_more(drive, t0):
    drive.reference([0.5] * (LONGEST_GAP + 3), start=t0)
    run(drive, [t0])
    drive.state(t0 + (LONGEST_GAP + 2) * PERIOD, [0.5])
    drive.peer.spin_for(0.1)
    time = t0 + (LONGEST_GAP + 1) * PERIOD
    drive.state(time, [0.5])
    drive.command_for(time)
    last = time + PERIOD
    drive.state(last, [0.5])
    drive.command_for(last)
    values, _, _ = drive.result()
    assert values["fallbacks"] == str(LONGEST_GAP)
    assert values["ignored_messages"] == "1"


def test_samples_need_not_lie_on_the_times_of_the_reference(drive, t0):
    """Half a sample beside them, with jitter, and by a clock that is slower by two percent."""
    jitter = [0.0, 0.1, -0.1, 0.1, -0.1, 0.0, 0.1, -0.1]
    times = [t0 + round((0.5 + 1.02 * k + jitter[k]) * PERIOD) for k in range(len(REFERENCE))]
    drive.reference(REFERENCE, start=t0)
    assert run(drive, times) == expected_commands()
    assert drive.result()[0]["fallbacks"] == "0"


@pytest.mark.parametrize("value", [math.inf, 1.7e308, -1e9])
def test_a_measurement_that_is_none_is_left_out_and_counted(drive, t0, value):
    velocities = [*VELOCITIES[:5], value, *VELOCITIES[6:]]
    drive.reference(REFERENCE, start=t0)
    left_out = [*VELOCITIES[:5], math.nan, *VELOCITIES[6:]]
    assert run(drive, samples_from(t0), velocities) == expected_commands(velocities=left_out)
    values, _, message = drive.result()
    assert message == f"sample 5: measurement is {value}"
    assert values["fallbacks"] == "1"


def test_a_state_without_velocities_is_ignored(drive, t0):
    drive.reference(REFERENCE, start=t0)
    drive.deliver()
    drive.state(t0, [], ["x_axis"])
    assert run(drive, samples_from(t0)) == expected_commands()
    assert drive.result()[0]["ignored_messages"] == "1"


@pytest.mark.parametrize(
    ("velocities", "options", "reason"),
    [
        ([0.5, math.nan], {}, "reference: velocity of point 1 is nan"),
        ([0.5, -math.inf], {}, "reference: velocity of point 1 is -inf"),
        (
            [0.5, 0.6, 0.7],
            {"spacing": 0.01},
            "reference: point 1 is 0.01 s from the start; "
            "expected 0.02 s, one sample time per point",
        ),
        ([0.5], {"joints": ["z_axis"]}, "reference: no joint x_axis, found z_axis"),
        (
            [0.5],
            {"joints": ["x_axis", "z_axis"]},
            "reference: point 0 has no velocity for joint x_axis",
        ),
        (
            [],
            {},
            "reference: expected at least one finite velocity [m/s], found shape (0,)",
        ),
    ],
)
def test_a_reference_that_cannot_be_used_is_a_failed_cut(drive, t0, velocities, options, reason):
    drive.reference(velocities, start=t0, **options)
    values, level, message = drive.result()
    assert level == DiagnosticStatus.ERROR
    assert message == reason
    assert values["status"] == "failed"
    assert values["cut"] == cut_identifier(t0)

    # Sent again it is no news; nothing is commanded; a good one starts a cut.
    drive.reference(velocities, start=t0, **options)
    drive.state(t0, [0.5])
    drive.peer.spin_for(0.1)
    assert not drive.results
    assert not drive.commands
    drive.reference(REFERENCE, start=t0 + PERIOD)
    drive.state(t0 + PERIOD, [VELOCITIES[0]])
    assert drive.command_for(t0 + PERIOD) == expected_commands()[0]


def test_a_new_reference_takes_over_from_an_unfinished_one(drive, t0):
    drive.reference(REFERENCE, start=t0)
    run(drive, samples_from(t0)[:3])
    later = t0 + 1000 * PERIOD
    drive.reference(REFERENCE, start=later)
    commands = run(drive, samples_from(later))
    np.testing.assert_array_equal(commands, expected_commands())
    assert drive.result()[0]["cut"] == cut_identifier(later)


def test_the_same_reference_again_does_not_start_the_cut_anew(drive, t0):
    drive.reference(REFERENCE, start=t0)
    commands = run(drive, samples_from(t0)[:4])
    drive.reference(REFERENCE, start=t0)
    drive.peer.spin_for(0.1)
    for k in range(4, 8):
        drive.state(t0 + k * PERIOD, [VELOCITIES[k]])
        commands.append(drive.command_for(t0 + k * PERIOD))
    assert commands == expected_commands()
