"""Runs by the clock of a simulation, and clocks that are not to be trusted."""

import re
import time
import types

import pytest
from servo import Simulation, failure, run
from std_srvs.srv import Trigger

from bo_tuner.backends.ros import clock
from bo_tuner.backends.ros.clock import SimClock, Stopwatch, WallClock
from bo_tuner.backends.ros.errors import DisturbedError, LostError
from bo_tuner.run_notes import Unusable
from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros

# The servo stamps by the machine's clock.
ANGLE = {"topic": "/joint_states", "field": "position[motor]", "time": "reception"}
SIM = {"clock": "sim", "end": {"after": 1.0}}


@pytest.fixture
def simulation(join):
    return join(Simulation)


def test_times_of_a_run_are_those_of_the_simulation(backend, simulation):
    simulation.speed = 20
    reset = {"call": {"service": "simulation/reset"}}
    made = backend(
        signals={"angle": ANGLE},
        run={
            **SIM,
            "before": [{"call": {"service": "servo/reset"}}, reset, {"wait": 0.1}],
            "end": {"after": 4.0},
        },
        metrics={"time": {"of": "angle", "measure": "duration"}},
    )
    for _ in range(2):
        outcome = run(made)
        assert outcome.state is EvaluationState.COMPLETE, outcome.reason
        assert outcome.metrics["time"] == pytest.approx(4.0)
        # The servo publishes 100 times in a second of the machine, which may be a busy one.
        messages = outcome.notes.signals["angle"].messages
        assert 5 < messages < 280


def test_waiting_counts_from_the_step_not_from_the_last_look(backend, simulation):
    """What is heard of a simulation before its reset must not be where a run begins."""
    reset = {"call": {"service": "simulation/reset"}}
    made = backend(
        signals={"angle": ANGLE},
        run={**SIM, "before": [reset, {"wait": 1.0}]},
        metrics={"time": {"of": "angle", "measure": "duration"}},
    )
    time.sleep(0.5)  # 2.5 s of simulated time in which nobody looks
    outcome = run(made)
    assert outcome.state is EvaluationState.COMPLETE, outcome.reason
    assert simulation.now >= 2_000_000_000  # one second to wait, one of the run


def test_a_simulation_that_stands_still(backend, simulation, monkeypatch):
    monkeypatch.setattr(clock, "LONGEST_STANDSTILL", 0.5)
    made = backend(signals={"angle": ANGLE}, run=SIM)
    simulation.stops_at = simulation.now + 2_000_000_000
    found = [run(made) for _ in range(3)]
    lost = [o for o in found if o.state is EvaluationState.LOST]
    assert lost
    assert re.match(r"/clock has not advanced for 0\.5 s; it is at \d+\.\d+", lost[0].reason)


class Silence:
    """A node on which nothing is published."""

    def create_subscription(self, *_):
        return types.SimpleNamespace(handle=self)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def take_message(self, *_):
        return None


def test_a_pause_in_which_nobody_looked_is_no_standstill(monkeypatch):
    now = 1000.0
    monkeypatch.setattr(clock.time, "monotonic", lambda: now)
    simulated = SimClock(Silence())
    simulated._add(7_000_000_000, 0)
    simulated.look()
    now += 3600.0
    simulated.look()
    for _ in range(10):
        now += 0.5
        simulated.look()
    now += 0.5
    with pytest.raises(LostError, match=r"/clock has not advanced for 5 s; it is at 7\.000 s"):
        simulated.look()


def test_a_simulation_that_jumps_back_in_a_run(backend, simulation, in_run):
    made = backend(signals={"angle": ANGLE}, run={**SIM, "end": {"after": 200.0}, "timeout": 300.0})
    in_run(made, lambda: simulation._reset(None, Trigger.Response()))
    outcome = run(made)
    assert failure(outcome).startswith("/clock jumped back from 1")
    assert outcome.notes.unusable is Unusable.DISTURBED


def test_no_simulation(refusal):
    reason = refusal(signals={"angle": ANGLE}, run=SIM)
    assert reason.startswith("run.clock: nothing publishes /clock; expected a sim")


def test_a_clock_of_the_machine_that_is_set_in_a_run(monkeypatch):
    wall = WallClock()
    wall.begin()
    wall.look()
    began = wall.now
    monkeypatch.setattr(clock.time, "time_ns", lambda: began - 3_600_000_000_000)
    with pytest.raises(DisturbedError, match=r"jumped by -3\.6e\+03 s in the run"):
        wall.look()


def test_a_clock_that_is_set_does_not_end_a_wait(monkeypatch):
    watch = Stopwatch(WallClock())
    now = time.time_ns()
    monkeypatch.setattr(clock.time, "time_ns", lambda: now + 3_600_000_000_000)
    assert watch.seconds < 3600.0


def test_a_condition_has_not_held_for_as_long_as_a_clock_is_set_forward(
    backend, system, monkeypatch
):
    now, ahead = time.time_ns, [0]
    monkeypatch.setattr(clock.time, "time_ns", lambda: now() + ahead[0])
    move = {"publish": {"topic": "setpoint", "message": {"data": 0.25}}}
    near = {"wait_until": {"condition": "angle < 0.1", "hold": 3.0, "timeout": 3.1}}
    made = backend(run={"before": [move, near]})

    def set_clock():
        if system.setpoint == 0.25:
            ahead[0] = 3_600_000_000_000

    with made._tuner.also_watched_by(set_clock):
        # Its angle is small for 0.1 s, and for less than the 3 s if its node is late.
        reason = failure(run(made, 0.05))
    assert reason.startswith("run.before[1]: 'angle < 0.1' does not hold for 3 s within 3.1 s")
