"""Runs that are the goal of an action."""

import time

import pytest
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from rclpy.task import Future
from servo import failure, run, study
from test_msgs.action import Fibonacci
from waiting import wait_until

from bo_tuner.backends.ros import goals
from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.errors import BackendError
from bo_tuner.interruption import Interrupted
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

GOAL = {"send_goal": {"action": "fibonacci", "goal": {"order": 5}}}
TO_ITS_RESULT = {"before": [], "start": [GOAL], "end": "result", "timeout": 20.0}
SOON = {"when": "t > 0.2 and angle > -1"}
FEW = {"setpoint": {"topic": "limit", "field": "data", "minimum_messages": 0}}


class Counter(Node):
    """Counts 20 ms by 20 ms up to the order of the goal, and ends as it is told to."""

    def __init__(self, context):
        super().__init__("counter", context=context)
        self.orders, self.ends = [], []
        self.accepts = self.succeeds = True
        self.obeys = lambda: True
        self.asked = False
        self.delay = 0.0
        self._ticks = []
        self.create_timer(0.02, self._tick)
        self._server = ActionServer(
            self,
            Fibonacci,
            "fibonacci",
            self._execute,
            goal_callback=self._answer,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )

    def stop(self):
        """Answer no more."""
        server, self._server = self._server, None
        if server is not None:
            server.destroy()

    def _answer(self, goal):
        self.asked, accepts = True, self.accepts
        time.sleep(self.delay)
        return GoalResponse.ACCEPT if accepts else GoalResponse.REJECT

    def _tick(self):
        ticks, self._ticks = self._ticks, []
        for tick in ticks:
            tick.set_result(None)

    async def _execute(self, goal):
        self.orders.append(goal.request.order)
        for _ in range(goal.request.order):
            tick = Future()
            self._ticks.append(tick)
            await tick
            if goal.is_cancel_requested and self.obeys():
                self.ends.append("cancelled")
                goal.canceled()
                return Fibonacci.Result()
        self.ends.append("succeeded" if self.succeeds else "aborted")
        (goal.succeed if self.succeeds else goal.abort)()
        return Fibonacci.Result()


@pytest.fixture
def counter(join):
    made = join(Counter)
    yield made
    made.stop()


def test_a_goal_that_is_accepted_only_after_the_end_of_the_run(backend, counter):
    """What is recorded until then is a machine at rest."""
    counter.delay = 1.0
    made = backend(signals=FEW, run=TO_ITS_RESULT | {"end": {"after": 0.3}})
    late = "run.start[0] comes after the end of the run at 0.3 s"
    assert failure(run(made)).startswith(late)


def test_a_run_ends_at_the_result(backend, counter):
    made = backend(
        run=TO_ITS_RESULT,
        signals=FEW,
        metrics={"time": {"of": "angle", "measure": "duration"}},
    )
    outcomes = [run(made) for _ in range(2)]
    assert [o.state for o in outcomes] == [EvaluationState.COMPLETE] * 2, outcomes
    assert (counter.orders, counter.ends) == ([5, 5], ["succeeded"] * 2)
    # Five periods of 20 ms.
    assert all(o.metrics["time"] > 0.06 for o in outcomes)


def test_a_goal_has_the_values_of_a_context(backend, counter):
    """By the name of the context in braces."""
    goal = {"send_goal": {"action": "fibonacci", "goal": {"order": "{count}"}}}
    count = {"type": "integer", "distribution": "discrete", "values": [1, 2, 4]}
    made = backend(signals=FEW, run=TO_ITS_RESULT | {"start": [goal]}, contexts={"count": count})
    for order in (4, 1, 2):
        planned = Evaluation(0, 0, Stage.DRAWN, {"gain": 0.5}, {"count": order}, 1)
        assert made.outcome(planned).state is EvaluationState.COMPLETE
    assert counter.orders == [4, 1, 2]


def test_a_goal_that_is_refused(backend, counter):
    made = backend(run=TO_ITS_RESULT, signals=FEW)
    counter.accepts = False
    assert failure(run(made)) == "/fibonacci refused the goal"


@pytest.mark.parametrize("end", ["result", {"after": 5.0}])
def test_a_goal_that_is_aborted(backend, counter, end):
    made = backend(run={**TO_ITS_RESULT, "end": end}, signals=FEW)
    counter.succeeds = False
    assert failure(run(made)) == "/fibonacci aborted the goal"


def test_a_goal_without_result_is_cancelled(backend, counter):
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    made = backend(run={**TO_ITS_RESULT, "start": [long], "timeout": 0.5}, signals=FEW)
    assert failure(run(made)) == ("the run does not end: /fibonacci has no result within 0.5 s")
    assert counter.ends == ["cancelled"]


def test_a_goal_is_cancelled_when_a_run_is_aborted(backend, counter, system):
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    move = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    made = backend(run={**TO_ITS_RESULT, "start": [long, move], "abort_when": "angle > 0.5"})
    assert failure(run(made)).startswith("aborted at ")
    assert counter.ends == ["cancelled"]


def test_a_goal_is_cancelled_when_a_run_ends_before_it(backend, counter):
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    made = backend(
        run={**TO_ITS_RESULT, "start": [long], "end": SOON},
        signals=FEW,
    )
    assert run(made).state is EvaluationState.COMPLETE
    assert counter.ends == ["cancelled"]


def test_a_server_that_is_lost(backend, counter, monkeypatch):
    monkeypatch.setattr(goals, "CALL_TIMEOUT", 1.0)
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    made = backend(run={**TO_ITS_RESULT, "start": [long, {"wait": 0.1}]}, signals=FEW)
    counter.create_timer(0.05, lambda: counter.orders and counter.stop())
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert found.reason.startswith("the server of /fibonacci is lost")
    # It may go on behind a network that is cut.
    with pytest.raises(BackendError, match=r"^/fibonacci does not end its goal within 1 s of the"):
        made.close()


def test_a_goal_may_bring_the_machine_home(backend, counter, system):
    made = backend(run={"before": [GOAL], "abort_when": "angle > 0.5", "recover": [GOAL]})
    assert failure(run(made)).startswith("aborted at ")
    assert counter.ends == ["succeeded"] * 2
    counter.succeeds = False
    assert failure(run(made)).startswith("/fibonacci aborted the goal; not recovered: /fibonacci")


@pytest.mark.parametrize(
    ("goal", "complaint"),
    [
        ({"action": "fibonaci"}, "action: there is no action /fibonaci; did you mean '/fibonacci'"),
        ({"goal": {"odrer": 5}}, "goal.odrer: test_msgs/action/Fibonacci_Goal has no field"),
        ({"goal": {"order": 0.5}}, "goal.order: expected an integer, found 0.5"),
    ],
)
def test_a_goal_that_cannot_be_sent(refusal, counter, goal, complaint):
    step = {"send_goal": GOAL["send_goal"] | goal}
    reason = refusal(run={**TO_ITS_RESULT, "start": [step]})
    assert reason.startswith(f"run.start[0].send_goal.{complaint}")


def test_a_goal_that_is_accepted_too_late_is_cancelled(backend, counter, monkeypatch):
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    made = backend(run=TO_ITS_RESULT | {"start": [long]}, signals=FEW)
    monkeypatch.setattr(goals, "CALL_TIMEOUT", 0.3)
    counter.delay = 1.0
    outcome = run(made)
    assert outcome.state is EvaluationState.LOST
    assert outcome.reason.startswith("the server of /fibonacci does not answer within 0.3 s")
    # The server may come to the goal only now.
    wait_until(lambda: counter.asked, "the server")
    counter.delay, counter.accepts = 0.0, False
    wait_until(lambda: run(made) and counter.ends, "the goal has ended")
    assert (counter.orders, counter.ends) == ([10_000], ["cancelled"])


def test_a_goal_whose_answer_an_interruption_does_not_wait_for_is_cancelled(
    counter, tmp_path, system
):
    """The server may accept it all the same, and would execute it with nobody looking."""
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}

    def interrupted():
        if counter.asked:
            raise Interrupted(2)

    made = RosBackend(
        study(run=TO_ITS_RESULT | {"start": [long]}, signals=FEW),
        tmp_path,
        attach=True,
        interrupted=interrupted,
    )
    counter.delay = 0.5
    try:
        made.open()
        with pytest.raises(Interrupted):
            run(made)
        assert (counter.orders, counter.ends) == ([10_000], ["cancelled"])
    finally:
        made.close()


def test_while_a_goal_does_not_end_nothing_else_begins(backend, counter, monkeypatch):
    """Neither the way home nor another run; it is named in the end."""
    monkeypatch.setattr(goals, "CALL_TIMEOUT", 2.0)
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    steps = {"start": [long], "end": SOON, "recover": [GOAL]}
    made = backend(run=TO_ITS_RESULT | steps, signals=FEW)
    counter.obeys = lambda: False
    late = "/fibonacci does not end its goal within 2 s of the request to cancel it"
    reason = failure(run(made))
    assert reason.startswith(late)
    assert reason.endswith("; not recovered: /fibonacci does not end its goal")
    again = run(made)
    assert again.state is EvaluationState.LOST
    assert again.reason.startswith(late)
    assert counter.orders == [10_000]
    with pytest.raises(BackendError, match=f"^{late}$"):
        made.close()
    counter.obeys = lambda: True
    wait_until(lambda: counter.ends, "the goal has ended")


def test_a_goal_of_a_server_that_was_started_anew_is_over(backend, counter, join, monkeypatch):
    """It does not know the goal, and the next run may begin."""
    monkeypatch.setattr(goals, "CALL_TIMEOUT", 0.3)
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    made = backend(
        run=TO_ITS_RESULT | {"start": [long], "end": SOON},
        signals=FEW,
    )
    counter.create_timer(0.05, lambda: counter.orders and counter.stop())
    run(made)
    anew = join(Counter)
    try:
        wait_until(lambda: run(made).state is EvaluationState.COMPLETE, "the next run")
        assert anew.orders
    finally:
        anew.stop()


def test_a_machine_is_stopped_ahead_of_the_end_of_a_goal(backend, counter, system):
    """Which may take its time."""
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    move = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    stop = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
    steps = {"start": [long, move], "after": [stop], "abort_when": "angle > 0.5"}
    made = backend(run=TO_ITS_RESULT | steps)
    counter.obeys = lambda: system.setpoint == -0.5
    assert failure(run(made)).endswith(" s: 'angle > 0.5'")
    assert counter.ends == ["cancelled"]


def test_a_node_that_takes_no_parameters_while_it_executes_a_goal(backend, counter, system):
    """It is parked once its goal is cancelled, and then the machine drives home."""
    long = {"send_goal": {"action": "fibonacci", "goal": {"order": 10_000}}}
    move = {"publish": {"topic": "setpoint", "message": {"data": 1.0}}}
    home = {"publish": {"topic": "setpoint", "message": {"data": 0.0}}}
    steps = {"start": [long, move], "abort_when": "angle > 0.5", "recover": [home]}
    made = backend(run=TO_ITS_RESULT | steps, park={"parameters": {"gain": 0.25}})
    system.accepts = lambda: len(counter.orders) == len(counter.ends)
    reason = failure(run(made))
    assert reason.startswith("aborted at ")
    assert "not parked" not in reason
    assert system.get_parameter("gain").value == 0.25
    wait_until(lambda: system.setpoint == 0.0, "the way home")
