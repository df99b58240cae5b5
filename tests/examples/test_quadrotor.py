"""The quadrotor in wind: what the nodes fly is what RotorPy flies, by a code path of its own."""

import functools
from pathlib import Path

import numpy as np
import pytest

from bo_tuner.study.study_file import parse_study
from bo_tuner.trials import Evaluation, EvaluationState, Stage

STUDY = Path(__file__).parents[2] / "examples" / "quadrotor" / "study.yaml"
DURATION = 1.0  # instead of 4 s of flight


@pytest.fixture
def module(module_of):
    """Function that imports a module of the example."""
    return functools.partial(module_of, "quadrotor")


@pytest.fixture
def backend(backend_of):
    """The study, over ROS, with flights of `DURATION`."""
    return backend_of("quadrotor", ("end: {after: 4.0}", f"end: {{after: {DURATION}}}"))


@pytest.mark.slow
@pytest.mark.ros
def test_the_nodes_fly_what_the_judge_flies(backend, module, monkeypatch):
    """Overshoot and effort to the last digit, in wind and with a payload; a crash is a crash."""
    judge, flight = module("judge"), module("flight")
    calm = {
        "wind_speed": 0.0, "wind_direction": 0.0, "payload": 0.0, "motor_time_constant": 0.072
    }  # fmt: skip
    windy = {
        "wind_speed": 3.0, "wind_direction": -0.5, "payload": 0.006, "motor_time_constant": 0.09
    }  # fmt: skip
    nervous = dict(judge.DEFAULT) | {"kp_att": 600.0, "kd_att": 20.0, "kp_xy": 14.0}
    flights = [(judge.DEFAULT, calm, 1), (judge.DEFAULT, windy, 2), (nervous, windy, 3)]
    for number, (gains, context, seed) in enumerate(flights):
        evaluation = Evaluation(0, number, Stage.DRAWN, dict(gains), context, seed)
        found = backend.outcome(evaluation)
        conditions = flight.Conditions(**context, seed=seed)
        # The run ends as soon as the clock says so: the answer to the last state may not be in.
        monkeypatch.setattr(judge, "DURATION", DURATION)
        before_last = judge.judge(gains, conditions)
        monkeypatch.setattr(judge, "DURATION", DURATION + flight.PERIOD)
        expected = judge.judge(gains, conditions)
        assert expected.crashed == (found.state is EvaluationState.FAILED), found.reason
        if expected.crashed:
            assert found.reason.startswith("aborted at "), found.reason
            continue
        assert found.metrics["overshoot"] == pytest.approx(expected.overshoot, rel=1e-12)
        effort = pytest.approx(found.metrics["effort"], rel=1e-12)
        assert effort in (before_last.effort, expected.effort)
        # One integrates held values over time, the other averages the messages.
        assert found.metrics["error"] == pytest.approx(expected.error, rel=0.02)
    assert expected.crashed


def test_the_defaults_are_those_of_rotorpy(module):
    """In the judge, in the study; the node asks RotorPy itself."""
    judge = module("judge")
    control = judge.SE3Control(judge.crazyflie_params.quad_params)
    gains = {
        "kp_xy": control.kp_pos[0], "kd_xy": control.kd_pos[0], "kp_z": control.kp_pos[2],
        "kd_z": control.kd_pos[2], "kp_att": control.kp_att, "kd_att": control.kd_att,
    }  # fmt: skip
    assert gains == judge.DEFAULT
    study = parse_study(STUDY.read_text(encoding="utf-8"))
    assert {p.name: p.default for p in study.parameters.values()} == judge.DEFAULT


def test_ultimate_gain_of_two_lags_and_an_integrator(module):
    """K / (s (T1 s + 1) (T2 s + 1)) oscillates at K = 1/T1 + 1/T2 (Routh)."""
    classical = module("classical")
    s = classical.control.tf("s")
    for first, second in ((0.072, 0.01), (0.5, 0.5)):
        loop = 1 / (s * (first * s + 1) * (second * s + 1))
        assert classical.ultimate_gain(loop) == pytest.approx(1 / first + 1 / second)


def test_gusts_are_those_of_the_filter(module, monkeypatch):
    """Standard deviation and correlation over one step, exp(-V dt / L)."""
    flight = module("flight")
    flown = flight.Flight(flight.Conditions(gust=0.5, wind_speed=2.0, wind_direction=np.pi / 2))
    monkeypatch.setattr(flown._vehicle, "step", lambda state, *_: dict(state))  # the wind alone
    winds = []
    for _ in range(60_000):
        winds.append(flown.state["wind"])
        flown.step(flown.state["rotor_speeds"])
    gusts = np.array(winds) - [0.0, 2.0, 0.0]
    # 600 s are 360 times the lag of 1.67 s, in each of three directions.
    assert gusts.std() == pytest.approx(0.5, rel=0.1)
    correlation = (gusts[1:] * gusts[:-1]).mean() / (gusts**2).mean()
    expected = np.exp(-flight.PERIOD * flight.AIRSPEED / flight.GUST_LENGTH)
    assert correlation == pytest.approx(expected, abs=0.002)
