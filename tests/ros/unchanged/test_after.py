"""The steps after a run, which bring the machine to rest whatever happens meanwhile."""

import re
from functools import partial

import pytest
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from servo import LATCHED, Sensor, failure, run
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from waiting import DEADLINE, wait_until

from bo_tuner.backends.ros.errors import LostError
from bo_tuner.errors import BackendError
from bo_tuner.interruption import Interrupted
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

STOP = {"publish": {"topic": "setpoint", "message": {"data": -0.5}}}
AT_REST = {"wait_until": {"condition": "angle < -0.2", "timeout": DEADLINE}}
OPEN = {"publish": {"topic": "clamp", "message": {"data": 1.0}}}
LIMIT = {"topic": "limit", "field": "data", "minimum_messages": 0}
SLOW = {"parameters": {"gain": 0.1}}
ABORTED = {"end": {"after": DEADLINE}, "timeout": DEADLINE, "abort_when": "angle > 0.9"}


class Clamp(Node):
    """Notes where the machine is when it is opened."""

    def __init__(self, system, context):
        super().__init__("clamp", context=context)
        self.opened_at = []
        self.create_subscription(
            Float64, "clamp", lambda message: self.opened_at.append(system.angle), 10
        )


@pytest.fixture
def clamp(join, system):
    return join(Clamp, system)


def check_at_rest(clamp):
    wait_until(lambda: clamp.opened_at, "the clamp is open")
    assert all(angle < -0.15 for angle in clamp.opened_at)


def test_an_interruption_does_not_cut_a_wait_short(interruptible, system, clamp):
    """The machine is still moving when it comes."""
    made = interruptible(
        lambda: system.setpoint == -0.5,
        run={"before": [], "after": [STOP, AT_REST, OPEN]},
        park=SLOW,
    )
    with pytest.raises(Interrupted):
        run(made)
    check_at_rest(clamp)


def test_a_node_that_dies_on_the_way_home_does_not_cut_a_wait_short(
    backend, system, clamp, monkeypatch
):
    home = {"publish": {"topic": "setpoint", "message": {"data": 0.25}}}
    made = backend(
        run=ABORTED
        | {"before": [], "after": [STOP, AT_REST, OPEN], "recover": [home, {"wait": DEADLINE}]},
        park=SLOW,
    )

    dead = []

    def check():
        if dead or (clamp.opened_at and system.setpoint == 0.25 and system.angle > 0.0):
            dead.append(True)
            raise LostError("pid has ended")

    monkeypatch.setattr(made._started, "check", check)
    assert "; not recovered: pid has ended" in failure(run(made))
    wait_until(lambda: len(clamp.opened_at) == 2, "the clamp is open again")
    check_at_rest(clamp)


def test_a_message_that_cannot_be_read_does_not_cut_a_wait_short(backend, system, join):
    made = backend(run=ABORTED | {"after": [STOP, {"wait": 0.3}]})
    watch = system.create_subscription(
        Float64,
        "setpoint",
        lambda message: setattr(system, "names", ["other"] if message.data < 0 else system.names),
        10,
    )
    try:
        assert re.fullmatch(r"aborted at [0-9.]+ s: 'angle > 0.9'", failure(run(made)))
    finally:
        system.destroy_subscription(watch)


def test_somebody_who_cannot_hear_the_tuner_does_not_keep_it_from_stopping_the_machine(
    backend, system, join
):
    made = backend(run={"before": [], "after": [STOP]}, signals={"setpoint": LIMIT})
    onlooker = join(partial(Node, "onlooker"))
    count = made._tuner.node.count_subscribers
    known = count("/setpoint")
    onlooker.create_subscription(Float64, "setpoint", lambda message: None, LATCHED)
    wait_until(lambda: count("/setpoint") > known, "the tuner knows of the onlooker")
    assert run(made).state is EvaluationState.COMPLETE
    wait_until(lambda: system.setpoint == -0.5, "the steps after the run")


class Retiring(Node):
    """Publishes while it is wanted, as a lifecycle node while it is configured."""

    def __init__(self, context):
        super().__init__("retiring", context=context)
        self.publisher = None
        self.refuses = False
        self.begin()
        self.create_timer(0.01, self.publish)
        self.create_service(Trigger, "~/begin", self.on_begin)
        self.create_service(Trigger, "~/end", self.on_end)

    def begin(self):
        self.publisher = self.publisher or self.create_publisher(Float64, "sensed", 10)

    def publish(self):
        if self.publisher is not None:
            self.publisher.publish(Float64(data=1.0))

    def on_begin(self, request, response):
        response.success = not self.refuses
        if response.success:
            self.begin()
        return response

    def on_end(self, request, response):
        self.destroy_publisher(self.publisher)
        self.publisher = None
        response.success = True
        return response


def test_steps_that_end_a_publisher_do_not_hide_why_a_run_failed(backend, join, monkeypatch):
    monkeypatch.setattr("bo_tuner.backends.ros.procedure.DISCOVERED", DEADLINE)
    node = join(Retiring)
    gone = {"wait": 0.5}
    made = backend(
        signals={"sensed": {"topic": "sensed", "field": "data", "minimum_messages": 0}},
        run=ABORTED
        | {
            "before": [{"call": {"service": "retiring/begin"}}, {"wait": 0.1}],
            "after": [{"call": {"service": "retiring/end"}}, gone],
            "abort_when": "sensed > 0.5",
        },
    )
    for _ in range(2):
        assert failure(run(made)).startswith("aborted at ")
    # Nor why the next one could not be prepared.
    node.refuses = True
    assert failure(run(made)).startswith("/retiring/begin refused: ")


def test_a_sensor_that_is_lost_between_two_runs_is_not_held_against_the_parameters(
    backend, join, leave
):
    """Although steps after a run might have ended it."""
    sensor = join(Sensor)
    at_zero = {"wait_until": {"condition": "sensed < 0.5", "timeout": 1.0}}
    made = backend(
        signals={"sensed": {"topic": "sensed", "field": "data", "minimum_messages": 0}},
        run={"before": [at_zero], "after": [{"call": {"service": "servo/reset"}}]},
    )
    assert run(made).state is EvaluationState.COMPLETE
    sensor.value = 1.0
    heard = made._procedure._recorder

    def has_risen():
        heard.poll()
        return heard.recording(heard.seconds).signals["sensed"].value[-1] == 1.0

    wait_until(has_risen, "its new value")
    leave(sensor)
    wait_until(lambda: heard.unpublished, "the tuner knows that it is lost")
    found = run(made)
    assert found.state is EvaluationState.LOST
    assert found.reason.startswith("/sensed has no publisher any more")


def test_a_machine_is_told_to_stop_also_where_it_seems_not_to_listen(
    backend, patience, join, leave
):
    """The graph may be behind."""
    clamp = join(Clamp, None)
    made = backend(run={"after": [OPEN]})
    published = []
    publisher = made._procedure._topics["/clamp"].publisher
    leave(clamp)
    wait_until(lambda: publisher.get_subscription_count() == 0, "the clamp is gone")
    publisher.publish = published.append
    patience(0.1)
    unheard = "nothing subscribes to /clamp"
    assert failure(run(made)) == f"{unheard}; run.after[0]: {unheard}"
    assert published
    with pytest.raises(BackendError, match=f"^run.after.0.: {unheard}$"):
        made.close()


def test_a_machine_that_listens_again_is_told_to_stop_in_the_end(
    backend, system, patience, join, leave
):
    """As when its driver is started anew."""
    clamp = join(Clamp, system)
    made = backend(run={"before": [], "after": [OPEN]})
    publisher = made._procedure._topics["/clamp"].publisher
    leave(clamp)
    wait_until(lambda: publisher.get_subscription_count() == 0, "the clamp is gone")
    patience(0.1)
    assert failure(run(made)).startswith("nothing subscribes to /clamp")
    back = join(Clamp, system)
    wait_until(lambda: publisher.get_subscription_count() == 1, "the clamp is back")
    made.close()
    wait_until(lambda: back.opened_at, "the clamp is open")


class Gate(Node):
    """Is told its state by messages that are kept for those who join later."""

    def __init__(self, context):
        super().__init__("gate", context=context)
        self.states = []
        qos = QoSProfile(depth=10, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(
            Float64, "gate", lambda message: self.states.append(message.data), qos
        )


def test_a_node_that_is_started_anew_hears_the_last_message_alone(backend, join, leave):
    """The commands of earlier runs would move it once more."""

    def state(value):
        return {"publish": {"topic": "gate", "message": {"data": value}}}

    gate = join(Gate)
    steps = {"before": [state(1.0)], "start": [state(2.0), {"wait": 0.1}], "after": [state(3.0)]}
    made = backend(run=steps, signals={"setpoint": LIMIT})
    assert run(made).state is EvaluationState.COMPLETE
    wait_until(lambda: gate.states[-1:] == [3.0], "the messages of the run")
    leave(gate)
    anew = join(Gate)
    wait_until(lambda: anew.states[-1:] == [3.0], "the last message")
    assert anew.states == [3.0]


def test_what_a_node_that_hangs_has_not_done_is_asked_of_it_again(backend, system):
    """The message that stops it lets it hang; the brake comes when it is back."""
    brake = {"call": {"service": "servo/reset", "timeout": 1.0}}
    made = backend(run=ABORTED | {"before": [], "start": [], "after": [STOP, brake]})
    system.setpoint, system.hang = 9.0, 4.0
    reason = failure(run(made))
    assert "; run.after[1]: the node that run.after[1] calls does not answer /servo/reset" in reason
    wait_until(lambda: len(system.gains_at_reset) == 2, "the repetition")


def test_a_step_that_is_never_done_is_an_error_in_the_end(backend):
    """The machine may not be at rest."""
    brake = {"call": {"service": "hang", "timeout": 0.2}}
    made = backend(run={"before": [], "after": [brake]})
    assert run(made).state is EvaluationState.LOST
    with pytest.raises(BackendError) as caught:
        made.close()
    silent = "the node that run.after[0] calls does not answer /hang within 0.2 s"
    assert str(caught.value) == f"run.after[0]: {silent}"
