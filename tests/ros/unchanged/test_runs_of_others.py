"""Runs on a system that knows nothing of the tuner, and what may go wrong in them."""

import re
import threading
import time
from functools import partial

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from servo import Sensor, failure, run, study
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from waiting import DEADLINE, wait_until

from bo_tuner import maxima
from bo_tuner.backends.layers import suspension
from bo_tuner.backends.ros import procedure, signals, tuner_node
from bo_tuner.errors import StudyError
from bo_tuner.processor_load import Load, LoadMeter
from bo_tuner.run_notes import Messages
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros


def test_a_run_and_its_metrics(backend, system):
    made = backend(
        signals={
            "plain": {"topic": "plain", "field": "data[1]", "largest_gap": 3.0},
            "limit": {"topic": "limit", "field": "data", "minimum_messages": 0},
        },
        run={
            "end": {"after": 1.0},
            "after": [{"publish": {"topic": "wanted", "message": {"name": ["a"]}}}],
        },
        metrics={
            "last": {"of": "angle", "measure": "maximum"},
            "same": {"of": "plain", "measure": "maximum"},
            "margin": {"of": "limit - setpoint", "measure": "minimum"},
            "time": {"of": "angle", "measure": "duration"},
        },
    )
    slow, fast = (run(made, gain) for gain in (0.0, 0.5))
    assert [slow.state, fast.state] == [EvaluationState.COMPLETE] * 2, (slow.reason, fast.reason)
    assert slow.metrics["error"] > fast.metrics["error"] > 0.0
    assert fast.metrics["last"] == pytest.approx(1.0, abs=0.01)
    assert fast.metrics["same"] == pytest.approx(1.0, abs=0.01)
    assert fast.metrics["margin"] == 1.5
    assert fast.metrics["time"] == pytest.approx(1.0)
    assert fast.notes.signals["setpoint"] == Messages(1, 0, 0)
    # The steps after the run; the message has a stamp.
    wait_until(lambda: len(system.received) == 2, "the messages after the runs")
    assert [m.name for m in system.received] == [["a"]] * 2
    assert all(m.header.stamp.sec > 0 for m in system.received)
    made.close()
    assert system.get_parameter("gain").value == 0.5


def test_a_signal_that_is_not_a_number(backend, system):
    made = backend(run={"before": [{"wait": 0.05}]})
    system.angle = float("nan")
    assert failure(run(made)).startswith("signal angle (/joint_states) is nan at ")


def test_a_run_that_does_not_come_about_has_no_signals(backend, system):
    """Those of the run before it are not its own."""
    made = backend()
    assert run(made).state is EvaluationState.COMPLETE
    assert made.recording.signals
    with system.refusing("not now"):
        refused = run(made, 0.3)
    assert "not now" in failure(refused)
    assert not made.recording.signals
    assert not refused.notes.signals


def test_a_run_without_a_message(backend, system):
    moving = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    made = backend(
        run={"before": [moving], "start": [], "end": {"after": 0.3}},
        signals={"setpoint": {"topic": "setpoint", "field": "data", "minimum_messages": 0}},
    )
    system.silent = True
    reason = failure(run(made))
    assert reason.startswith(
        "signal angle (/joint_states) has 0 messages in a run of 0.3 s, expected at least 1"
    )
    system.silent = False
    assert run(made).state is EvaluationState.COMPLETE


def test_a_joint_that_is_not_in_the_messages(backend, system):
    made = backend()
    system.names = ["other", "engine"]
    expected = (
        "a message on /joint_states has no 'motor' among its names; expected one of other, engine"
    )
    assert failure(run(made)) == expected


def test_messages_that_name_nothing_before_the_run(backend, system):
    """A machine may tell its joints once it is enabled."""
    system.names = []
    made = backend()
    system.names = ["motor", "other"]
    assert run(made).state is EvaluationState.COMPLETE


def test_a_message_that_is_too_large(backend, monkeypatch):
    made = backend()
    with monkeypatch.context() as patch:
        patch.setattr(maxima, "MESSAGE_BYTES", 10)
        assert re.fullmatch(
            "a message on /[a-z_]+ has [0-9]+ bytes, expected at most 10", failure(run(made))
        )
    assert run(made).state is EvaluationState.COMPLETE


def test_a_condition_ends_a_run(backend):
    made = backend(
        run={"end": {"when": "angle > 0.9 and t > 0.05"}, "timeout": 60.0},
        metrics={"time": {"of": "angle", "measure": "duration"}},
    )
    slow, fast = (run(made, gain).metrics["time"] for gain in (0.02, 0.5))
    # 0.9 is passed after 114 and after 4 periods of 10 ms.
    assert slow > fast > 0.05


def test_a_condition_that_never_holds(backend):
    made = backend(run={"end": {"when": "angle > 5"}, "timeout": 0.3})
    assert failure(run(made)) == "the run does not end: 'angle > 5' does not hold within 0.3 s"


def test_a_run_is_aborted_and_the_steps_after_it_are_done(backend, system):
    made = backend(
        run={
            "end": {"after": DEADLINE},
            "timeout": DEADLINE,
            "abort_when": "abs(angle) > 0.8",
            "after": [{"publish": {"topic": "setpoint", "message": {"data": -0.25}}}],
        }
    )
    assert failure(run(made)).startswith("aborted at ")
    wait_until(lambda: system.setpoint == -0.25, "the steps after the run")


SILENT = {"fault": {"topic": "fault", "field": "data", "minimum_messages": 0}}
"""Of what is published on a fault alone."""
FOR_LONG = {"end": {"when": "angle > 99"}, "timeout": DEADLINE}


def test_a_signal_without_a_message_does_not_keep_a_run_from_being_aborted(backend):
    limits = {"abort_when": "abs(angle) > 0.8 or fault > 0"}
    made = backend(signals=SILENT, run=FOR_LONG | limits)
    assert failure(run(made)).startswith("aborted at ")


@pytest.mark.parametrize("condition", ["fault > 0", "not fault < 1", "fault != 0"])
def test_a_signal_without_a_message_aborts_nothing(backend, condition):
    made = backend(signals=SILENT, run={"abort_when": condition})
    assert run(made).state is EvaluationState.COMPLETE


def test_a_run_is_aborted_while_a_service_is_called(backend):
    call = {"call": {"service": "hang", "timeout": DEADLINE}}
    move = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    made = backend(run={"start": [move, call], "abort_when": "abs(angle) > 0.8"})
    assert failure(run(made)).startswith("aborted at ")


def test_a_run_is_aborted_also_by_a_message_with_a_stamp_ahead(backend, system):
    """As from a machine whose clock is."""
    system.ahead = 2 * DEADLINE
    made = backend(run=FOR_LONG | {"abort_when": "abs(angle) > 0.8"})
    assert failure(run(made)).startswith("aborted at 600.")


def set_back(system):
    """As by a clock that is set; the machine moves on."""
    system.ahead, system.setpoint = -3600.0, 9.0


def test_a_run_is_aborted_also_by_late_messages(backend, system, in_run, monkeypatch):
    monkeypatch.setattr(signals, "LARGEST_JUMP", 2 * 3600.0)
    made = backend(run={"end": {"after": 5.0}, "abort_when": "angle > 3"})
    in_run(made, lambda: set_back(system))
    assert failure(run(made)).startswith("aborted at ")


def test_a_run_whose_messages_are_all_late_is_unusable(backend, system, in_run):
    """It would count by what came before."""
    made = backend(run={"end": {"after": 5.0}})
    in_run(made, lambda: set_back(system))
    outcome = run(made)
    assert outcome.unusable
    assert outcome.reason.startswith("the stamps of signal angle (/joint_states) stand still or go")


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda system: setattr(system, "angle", float("nan")), "is nan at "),
        (lambda system: setattr(system, "silent", True), "has no message for "),
    ],
    ids=["not a number", "silent"],
)
def test_a_run_that_can_no_longer_count_ends_at_once(backend, system, in_run, spoil, complaint):
    """With a dead sensor nothing would abort it."""
    angle = {"topic": "joint_states", "field": "position[motor]", "largest_gap": 3.0}
    made = backend(run=FOR_LONG, signals={"angle": angle})
    in_run(made, lambda: spoil(system))
    assert failure(run(made)).startswith(f"signal angle (joint_states) {complaint}")


@pytest.mark.parametrize(("share", "unusable"), [(1.0, True), (0.1, False)])
def test_a_gap_that_may_be_the_computers(backend, system, in_run, monkeypatch, share, unusable):
    """All processes together have waited for it as long as no message came, or not."""
    monkeypatch.setattr(LoadMeter, "load", lambda meter, processes: Load(share, 0.5))
    angle = {"topic": "joint_states", "field": "position[motor]", "largest_gap": 1.0}
    made = backend(run=FOR_LONG, signals={"angle": angle})
    in_run(made, lambda: setattr(system, "silent", True))
    (done,) = made.run([Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, {}, 1)])
    assert "has no message for " in failure(done.outcome)
    assert done.outcome.unusable == unusable
    assert ("waited for it 50 % of the time" in done.outcome.reason) == unusable


def test_a_node_that_freezes_in_a_run_fails_it_by_the_first_runs(backend, system, in_run):
    """In one of the first runs there is a note, and the limits are those of a resumed run."""
    made = backend(run={"end": {"after": 2.0}})

    def stall(made):
        in_run(made, lambda: setattr(system, "silent", True))
        outcome = run(made)
        system.silent = False
        return outcome

    first = [stall(made), *(run(made) for _ in range(2))]
    assert [outcome.state for outcome in first] == [EvaluationState.COMPLETE] * 3
    assert re.match(
        r"signal angle \(/joint_states\) has no message for 1\.\d+ s from 0\.\d+ s on, usually one",
        first[0].notes.remark,
    )
    frozen = stall(made)
    assert re.search(
        r"has no message for .* expected one at least every .* s, as in the first runs",
        failure(frozen),
    )
    made.close()
    again = backend(run={"end": {"after": 2.0}})
    again.recall([Evaluation(0, 0, Stage.DRAWN, {}, {}, 1, outcome) for outcome in first])
    assert again._rates.largest_gaps == made._rates.largest_gaps != {}
    assert failure(stall(again)).startswith("signal angle (/joint_states) has no message for ")


def test_a_signal_with_stamps_of_another_clock_is_not_called_silent(backend, system):
    """Of a simulation, while the run goes by the clock of the machine."""
    angle = {"topic": "joint_states", "field": "position[motor]", "largest_gap": 1.0}
    system.ahead = -1e9
    made = backend(run={"end": {"after": 3.0}}, signals={"angle": angle})
    assert re.search(
        r"; its stamps are 1e\+09 s behind the clock of the run: set run.clock to that of the stam",
        failure(run(made)),
    )


def test_a_run_that_somebody_else_made_fail_is_not_put_down_to_its_parameters(
    backend, system, in_run
):
    made = backend(run=FOR_LONG | {"abort_when": "abs(angle) > 3"})

    def disturb():
        system.set_gain(2.5)
        # By now it may stand exactly where it is to stand, which is no stable place any more.
        system.setpoint = 0.5

    in_run(made, disturb)
    outcome = run(made)
    assert outcome.unusable, outcome
    assert "parameter gain is 2.5, expected 0.5 (changed by someone else)" in outcome.reason


def test_what_a_dead_sensor_said_last_is_not_waited_for_with_success(backend, system):
    angle = {"topic": "joint_states", "field": "position[motor]", "largest_gap": 0.1}
    near = {"wait_until": {"condition": "abs(angle) < 9", "hold": 0.05, "timeout": 0.2}}
    made = backend(signals={"angle": angle}, run={"before": [{"wait": 0.5}, near]})
    run(made)
    system.silent = True
    reason = failure(run(made))
    assert reason.startswith("run.before[1]: 'abs(angle) < 9' does not hold for 0.05 s ")
    assert re.search(r"\(angle [0-9.]+, silent for [0-9.]+ s\)$", reason)


@pytest.mark.parametrize("condition", ["limit > 2 and t > 0.3", "t > 0.3"])
def test_a_condition_on_time_comes_to_hold_though_no_message_comes(backend, condition):
    """What is latched is older than the step, and has its value all the same."""
    limit = {"limit": {"topic": "limit", "field": "data", "minimum_messages": 0}}
    late = {"wait_until": {"condition": condition, "hold": 0.1, "timeout": 2.0}}
    made = backend(signals=limit, run={"before": [late]})
    outcome = run(made)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason


SENSED = {"sensed": {"topic": "sensed", "field": "data"}}


def test_a_run_is_lost_if_nobody_publishes_a_signal_any_more(
    backend, system, join, leave, monkeypatch
):
    """It tells nothing of the parameters; without what would abort it, it does not even begin."""
    monkeypatch.setattr(procedure, "DISCOVERED", 0.1)
    sensor = join(Sensor)
    may_be_silent = {"sensed": SENSED["sensed"] | {"minimum_messages": 0}}
    made = backend(signals=may_be_silent)
    assert run(made).state is EvaluationState.COMPLETE
    leave(sensor)
    wait_until(lambda: made._procedure._recorder.unpublished, "the sensor is gone")
    said = []
    monkeypatch.setattr(made._tuner, "warn", said.append)
    for _ in range(2):
        found = run(made)
        assert found.state is EvaluationState.LOST
        assert found.reason.startswith("/sensed has no publisher any more")
    assert system.setpoint == 0.0
    # The node of the study is there.
    assert said == []
    join(Sensor)
    wait_until(lambda: not made._procedure._recorder.unpublished, "the sensor is back")
    assert any(run(made).state is EvaluationState.COMPLETE for _ in range(3))


def test_a_second_publisher_of_a_signal_spoils_a_run(backend, system, join, leave, monkeypatch):
    """The one that was there at first, and another one that joins in a run or before it."""
    monkeypatch.setattr(procedure, "LONGEST_LEASE", 0.5)
    sensor = join(Sensor)
    made = backend(signals=SENSED, run={"end": {"after": 1.0}})
    joining = [{"name": "second"}]

    def joins():
        if joining and made._procedure._is_recording:
            join(partial(Sensor, **joining.pop()))

    with made._tuner.also_watched_by(joins):
        outcomes = [run(made), run(made)]
    for outcome in outcomes:
        assert outcome.state is EvaluationState.FAILED
        assert outcome.unusable
        assert outcome.reason == "/sensed has 2 publishers, whose messages mix"
    leave(sensor)
    wait_until(lambda: not made._procedure._recorder.mixed, "the first sensor is gone")
    assert any(run(made).state is EvaluationState.COMPLETE for _ in range(3))


def test_a_parameter_that_a_node_does_not_take_back_is_no_fault_of_the_trial(backend, system):
    """Somebody has changed it, and it is not the study's to set."""
    made = backend(run={"before": []})
    system.set_parameters([Parameter("count", value=5)])
    with system.refusing("it is at work"):
        for _ in range(3):
            outcome = run(made, 0.75)
            assert outcome.unusable
            assert outcome.reason.startswith("servo: parameter count is 5, expected 3 (changed by")
    assert run(made, 0.75).state is EvaluationState.COMPLETE


def test_a_metric_that_takes_its_time_is_no_suspension(backend, monkeypatch):
    made = backend()
    passed = [0.0]
    now, outcome = made._suspension._clock, made._collector.outcome
    monkeypatch.setattr(made._suspension, "_clock", lambda: now() + passed[0])

    def slow(*arguments):
        passed[0] += 2 * suspension.LONGEST
        return outcome(*arguments)

    monkeypatch.setattr(made._collector, "outcome", slow)
    assert run(made).state is EvaluationState.COMPLETE
    assert passed[0] == 2 * suspension.LONGEST


def test_a_node_that_does_not_answer_after_a_run_is_named(backend, system, monkeypatch):
    """The signals alone would not tell: another node publishes them."""
    made = backend(
        run={"before": []},
        signals={"angle": {"topic": "limit", "field": "data", "minimum_messages": 0}},
    )
    monkeypatch.setattr(tuner_node, "CALL_TIMEOUT", 1.0)
    system.hang = 3.0
    found = run(made)
    assert found.state is EvaluationState.LOST
    # It may be silent for longer than that, which is told as well.
    assert found.reason.startswith("servo does not answer servo/get_parameters within 1 s")


def test_a_service_that_refuses(backend):
    call = {"call": {"service": "servo/enable", "request": {"data": False}}}
    made = backend(run={"before": [call]})
    assert failure(run(made)) == "/servo/enable refused: the brake is on"


def test_a_service_that_hangs(backend):
    made = backend(run={"before": [{"call": {"service": "hang", "timeout": 0.5}}]})
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert found.reason.startswith(
        "the node that run.before[0] calls does not answer /hang within 0.5 s"
    )


def test_a_system_without_the_tuner_s_interfaces_has_no_form_in_process():
    from bo_tuner.backends.inprocess import InProcessBackend

    with pytest.raises(StudyError, match="run: needs ROS nodes; use --backend ros"):
        InProcessBackend(study()).open()


def test_a_step_that_comes_after_the_end_of_the_run(backend, system):
    """What it brings about would not be recorded, and the machine look as if at rest."""
    late = {"wait_until": {"condition": "t > 0.6", "timeout": DEADLINE}}
    moving = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    made = backend(run={"start": [late, moving], "end": {"after": 0.3}})
    assert failure(run(made)) == "run.start[1] comes after the end of the run at 0.3 s"
    assert system.setpoint == 0.0


def test_a_step_that_is_meant_to_come_with_the_end_of_the_run(backend, system):
    moving, resting = (
        {"publish": {"topic": "setpoint", "message": {"data": value}}} for value in (1.0, 0.0)
    )
    made = backend(run={"start": [moving, {"wait": 1.0}, resting], "end": {"after": 1.0}})
    outcome = run(made)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    wait_until(lambda: system.setpoint == 0.0, "the last step")


def test_a_signal_that_was_not_heard_before_must_hold_as_long(backend, system):
    moving = {"publish": {"topic": "setpoint", "message": {"data": 0.125}}}
    calm = {"wait_until": {"condition": "fault < 1", "hold": 1.0, "timeout": DEADLINE}}
    made = backend(
        signals={"fault": {"topic": "fault", "field": "data", "minimum_messages": 0}},
        run={"before": [moving, calm]},
    )
    heard = []

    def publish():
        wait_until(lambda: system.setpoint == 0.125, "the steps before the run")
        # By then the step has waited for longer than the condition is to hold.
        time.sleep(1.2)
        heard.append(time.monotonic())
        system.fault.publish(Float64(data=0.0))

    thread = threading.Thread(target=publish)
    thread.start()
    outcome = run(made)
    ended = time.monotonic()
    thread.join()
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert ended - heard[0] >= 1.0


class Late(Node):
    """Has a service."""

    def __init__(self, context):
        super().__init__("late", context=context)
        self.create_service(Trigger, "late", self.succeed)

    def succeed(self, request, response):
        response.success = True
        return response


def test_a_service_is_waited_for_that_is_started_anew(backend, system, join, leave):
    """A request to nobody would be lost."""
    first = join(Late)
    made = backend(run={"before": [{"call": {"service": "late", "timeout": DEADLINE}}]})
    (step,) = (s for s in made._procedure._steps.values() if hasattr(s, "service"))
    leave(first)
    wait_until(lambda: not step.service.service_is_ready(), "it is gone")
    timer = threading.Timer(0.5, join, [Late])
    timer.start()
    outcome = run(made)
    timer.join()
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
