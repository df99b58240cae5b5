"""The examples from Python run, and their results hold by the functions themselves."""

import re
import runpy
from pathlib import Path

import cloudpickle
import numpy as np
import pytest

import bo_tuner as bt

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "python"


@pytest.fixture
def module(monkeypatch):
    """Names of an example, without its main part."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return lambda name: runpy.run_path(str(EXAMPLES / f"{name}.py"))


def test_the_position_loop_keeps_its_limit_in_the_corners(module):
    example = module("position_loop")
    study, turn = example["study"], example["turn"]
    best = study.optimize(turn).best
    corners = [
        {"inertia": inertia, "friction": friction}
        for inertia in (0.5, 2.0)
        for friction in (0.5, 1.5)
    ]
    overshoots = [
        [np.mean([turn(values, c, seed)["overshoot"] for seed in range(5)]) for c in corners]
        for values in (study.defaults, best)
    ]
    assert max(overshoots[1]) <= 0.05 < max(overshoots[0])


def test_the_pole_stays_upright(module):
    example = module("reset_and_step")
    best = example["study"].optimize(example["balance"]).best
    largest = [
        example["balance"](best, {"length": length}, seed)["largest"]
        for length in np.linspace(0.3, 1.5, 10)
        for seed in range(10)
    ]
    assert np.mean(np.array(largest) <= 0.3) >= 0.9


@pytest.mark.slow
def test_the_closed_loop_is_robust_in_the_corners(module):
    example = module("closed_loop")
    study, step = example["study"], example["step"]
    best = study.optimize(step).best
    corners = [{"gain": g, "delay": d} for g in (0.7, 1.4) for d in (0.05, 0.25)]
    peaks = [
        max(step(values, corner, 0)["peak_sensitivity"] for corner in corners)
        for values in (study.defaults, best)
    ]
    assert peaks[1] <= 1.8 < peaks[0]


def test_the_closed_loop_is_that_of_the_textbook(module):
    """Without delay and integral action, a lag of second order settles at K / (1 + K).

    With G = K / (0.5 s^2 + 1.5 s + 1), its error is 1 / (1 + K) and a transient whose integral is
    1.5 K / (1 + K)^2; with K = 2 it never overshoots 1.
    """
    step = module("closed_loop")["step"]
    values, context = {"kp": 2.0, "ki": 1e-9}, {"gain": 1.0, "delay": 1e-3}
    expected = 10.0 / 3.0 + 1.5 * 2.0 / 9.0
    assert step(values, context, 0)["error"] == pytest.approx(expected, rel=1e-3)
    with pytest.raises(bt.Failed, match="unstable"):
        step({"kp": 20.0, "ki": 10.0}, {"gain": 1.4, "delay": 0.25}, 0)


@pytest.fixture(scope="session")
def tank(tmp_path_factory):
    """An FMU, made as the example says."""
    builder = pytest.importorskip("pythonfmu.builder")
    folder = tmp_path_factory.mktemp("fmu")
    return str(builder.FmuBuilder.build_FMU(EXAMPLES / "tank_slave.py", dest=folder))


def test_the_tank_of_another_tool_settles_at_its_level(module, tank):
    """The mean error of a level that rises at 0.3 m^3/s, less the outflow, in 60 s."""
    simulation = module("fmu")["Simulation"](tank)
    slow, fast = (
        simulation({"kp": kp, "ki": 0.05}, {"area": 1.0, "outflow": 0.1}, 0) for kp in (0.1, 2.0)
    )
    assert 0.0 < fast["error"] < slow["error"] < 1.0


@pytest.mark.slow
def test_the_tank_does_not_spill(module, tank):
    example = module("fmu")
    study, simulation = example["study"], example["Simulation"](tank)
    best = study.optimize(simulation).best
    corners = [{"area": a, "outflow": o} for a in (0.5, 1.5) for o in (0.05, 0.15)]
    spilled = [
        max(simulation(values, corner, 0)["overshoot"] for corner in corners)
        for values in (study.defaults, best)
    ]
    assert spilled[1] <= 0.05 < spilled[0]


def test_an_environment_is_that_of_its_context(module):
    balance = module("mujoco_pendulum")["Balance"]()
    values = module("mujoco_pendulum")["study"].defaults
    nominal = {"pole_mass": 1.0, "motor": 1.0}
    first = balance(values, nominal, 3)
    heavier = balance(values, {"pole_mass": 2.0, "motor": 0.7}, 3)
    assert heavier["largest"] > first["largest"]
    # Nothing of the run before is left; another process makes its own.
    assert balance(values, nominal, 3) == first
    assert cloudpickle.loads(cloudpickle.dumps(balance)).environment is None
    with pytest.raises(bt.Failed, match="the pole fell"):
        balance(dict.fromkeys(values, 0.0), nominal, 3)


@pytest.mark.slow
def test_the_pendulum_stays_upright(module):
    example = module("mujoco_pendulum")
    balance = example["Balance"]()
    best = example["study"].optimize(balance).best
    rng = np.random.default_rng(1)
    largest = [
        balance(best, {"pole_mass": mass, "motor": motor}, seed)["largest"]
        for seed, (mass, motor) in enumerate(rng.uniform((0.5, 0.7), (2.0, 1.3), (60, 2)))
    ]
    assert np.mean(np.array(largest) <= 0.03) >= 0.9


def test_the_document_describes_one_study_in_two_ways(tmp_path):
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    (file,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (code,) = (c for c in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "bt.Study(" in c)
    (tmp_path / "study.yaml").write_text(file, encoding="utf-8")
    names = {"bt": bt}
    exec(code, names)
    assert names["study"] == bt.Study.from_yaml(tmp_path / "study.yaml")
