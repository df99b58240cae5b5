"""The Cessna: the package's own aircraft, and a node that flies it at its own pace."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from bo_tuner.trials import Evaluation, EvaluationState, Stage

STUDY = Path(__file__).parents[2] / "examples" / "cessna" / "study.yaml"
DEFAULTS = {
    "heading_lag": 0.5, "bank_p": 6.0, "bank_i": 0.13, "bank_d": 6.0, "climb_lag": 1.0,
    "climb_p": 0.01, "climb_i": 0.00015, "climb_d": 0.0003,
}  # fmt: skip
"""As they stand in JSBSim's c172ap.xml."""


def test_the_defaults_are_those_of_jsbsim(module_of):
    """In the aircraft, read by another way; in the judge and in the study."""
    aircraft, judge = module_of("cessna", "aircraft"), module_of("cessna", "judge")
    path = f"{aircraft.jsbsim.get_default_root_dir()}/aircraft/c172x/c172ap.xml"
    root = ElementTree.parse(path).getroot()
    named = {element.get("name"): element for element in root.iter() if element.get("name")}
    for name, gain in aircraft.GAINS.items():
        if gain.component:
            value = named[gain.component].findtext(gain.tag)
        else:
            (value,) = (
                e.get("value") for e in root.iter("property") if e.text.strip() == gain.property
            )
        assert float(value) == DEFAULTS[name] == aircraft.default_gains()[name]
    study = yaml.safe_load(STUDY.read_text(encoding="utf-8"))
    assert {name: p["default"] for name, p in study["parameters"].items()} == judge.DEFAULT
    bounds = {name: tuple(c["bounds"]) for name, c in study["contexts"].items()}
    assert bounds == judge.RANGES


def test_settable_gains_leave_the_aircraft_of_the_package_as_it_was(module_of, monkeypatch):
    """Bit for bit, over a climbing turn in turbulence."""
    aircraft = module_of("cessna", "aircraft")
    conditions = aircraft.Conditions(wind=10.0, seed=3)

    def fly():
        flown = aircraft.Aircraft(conditions)
        flown.hold(290.0, 2.0)
        for _ in range(1200):
            flown.step()
        return flown.measure()

    changed = fly()
    root = aircraft.jsbsim.get_default_root_dir()
    monkeypatch.setattr(aircraft, "_copy", lambda: (f"{root}/aircraft", DEFAULTS))
    assert fly() == changed


def test_gains_conditions_and_seed_change_the_flight(module_of):
    judge = module_of("cessna", "judge")
    still, windy = judge.Conditions(), judge.Conditions(wind=10.0, seed=1)
    base = judge.judge(judge.DEFAULT, windy)
    assert judge.judge(judge.DEFAULT, windy) == base
    assert judge.judge(judge.DEFAULT, judge.Conditions(wind=10.0, seed=2)) != base
    assert judge.judge(judge.DEFAULT, still).aileron_effort < base.aileron_effort
    for name, value in judge.DEFAULT.items():
        assert judge.judge(judge.DEFAULT | {name: 2.0 * value}, windy) != base, name


def test_an_aircraft_that_cannot_fly_level_is_refused_in_a_line(module_of):
    aircraft = module_of("cessna", "aircraft")
    with pytest.raises(ValueError, match=r"^the aircraft cannot be trimmed in .*airspeed=5.0"):
        aircraft.Aircraft(aircraft.Conditions(airspeed=5.0))


@pytest.mark.slow
@pytest.mark.ros
def test_the_node_flies_what_the_judge_flies(backend_of, module_of):
    """In still air: one delay of the set-points explains all metrics of a flight.

    How long messages take is up to the computer. The error grows with it, and so tells it. On a
    busy one it can change in the midst of a flight, so one of three flights is enough.
    """
    judge = module_of("cessna", "judge")
    backend = backend_of("cessna", ("rate: 15.0", "rate: 5.0"))
    context = {"wind": 0.0, "airspeed": 52.0, "luggage": 20.0, "wing_load": 30.0}
    conditions = judge.Conditions(**context, seed=1)
    for number, change in enumerate(({}, {"climb_p": 0.02, "climb_lag": 2.0})):
        gains = dict(judge.DEFAULT) | change
        flown = []
        for _ in range(3):
            found = backend.outcome(Evaluation(0, number, Stage.DRAWN, gains, context, 1))
            assert found.state is EvaluationState.COMPLETE, found.reason
            low, high = 0.0, 20.0
            while high - low > 0.05:
                delay = (low + high) / 2.0
                later = judge.judge(gains, conditions, delay).error < found.metrics["error"]
                low, high = (delay, high) if later else (low, delay)
            expected = judge.judge(gains, conditions, low)
            flown.append((found.metrics, expected))
            if found.metrics == found.metrics | {
                "error": pytest.approx(expected.error, rel=0.02),
                "overshoot": pytest.approx(expected.overshoot, abs=1.0),
                "elevator_effort": pytest.approx(expected.elevator_effort, rel=0.1),
            }:
                break
        else:
            pytest.fail(f"no flight of three is the judge's: {flown}")
    # Reset refuses what cannot fly.
    slow = context | {"airspeed": 5.0}
    refused = backend.outcome(Evaluation(1, 0, Stage.DRAWN, dict(judge.DEFAULT), slow, 1))
    assert refused.state is EvaluationState.FAILED
    assert "cannot be trimmed" in refused.reason


def test_ultimate_gain_and_period_of_two_lags_and_an_integrator(module_of):
    """K / (s (T1 s + 1) (T2 s + 1)): K = 1/T1 + 1/T2, period 2 pi sqrt(T1 T2) (Routh)."""
    classical = module_of("cessna", "classical")
    s = classical.control.tf("s")
    for first, second in ((0.072, 0.01), (0.5, 0.5)):
        gain, period = classical.ultimate(1 / (s * (first * s + 1) * (second * s + 1)))
        assert gain == pytest.approx(1 / first + 1 / second)
        assert period == pytest.approx(2 * math.pi * math.sqrt(first * second))


@pytest.mark.slow
def test_the_linear_aircraft_rolls_and_climbs_as_the_flown_one(module_of):
    """A step of a command, seen a second later, in still air.

    By the position that the surface really took: the linear aircraft knows nothing of the
    hysteresis of the actuators.
    """
    classical, aircraft = module_of("cessna", "classical"), module_of("cessna", "aircraft")
    elevator = "fcs/elevator-cmd-norm", "fcs/elevator-pos-rad", "velocities/h-dot-fps"
    aileron = "fcs/aileron-cmd-norm", "fcs/effective-aileron-pos", "attitude/phi-rad"
    # Command, output, names in JSBSim, size of the step, what a full one would be [rad].
    cases = (
        ("DaCmd", "Phi", aileron, 0.2, 17.5 * 0.01745),
        ("DeCmd", "Alt", elevator, -0.2, 28.0 * 0.01745),
    )
    for command, output, (lever, surface, seen), size, full in cases:
        model = classical.airframe(aircraft.Conditions(), command, output)
        time = np.linspace(0.0, 1.0, 201)
        _, response = classical.control.forced_response(model, time, np.full(201, abs(size)))
        flown = []
        for position in (0.0, size):
            fdm = aircraft.Aircraft(aircraft.Conditions())._fdm
            fdm["ap/altitude_hold"] = fdm["ap/heading_hold"] = 0
            fdm[lever] = position
            for _ in range(round(time[-1] / aircraft.PERIOD)):
                fdm.run()
            flown.append((fdm[seen], fdm[surface]))
        (level, rest), (changed, moved) = flown
        expected = response[-1] * (moved - rest) / (size * full)
        assert expected > 0.0
        assert changed - level == pytest.approx(expected, rel=0.25)
