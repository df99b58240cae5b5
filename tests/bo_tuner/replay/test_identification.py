"""Where a machine is, by a simulator of one function."""

import numpy as np
import pytest
from functions import NODE, FunctionBackend, failed, make_study

from bo_tuner.errors import RunRecordError
from bo_tuner.replay.context_figure import context_figure
from bo_tuner.replay.identification import identify
from bo_tuner.replay.machine_runs import MachineRuns
from bo_tuner.study.narrowing import narrowed
from bo_tuner.trials import parameter_set
from bo_tuner.tuning.driver import Driver

CONTEXTS = {
    "load": NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]},
    "drag": NODE | {"distribution": "uniform", "bounds": [0.0, 1.0]},
}
STUDY = make_study(contexts=CONTEXTS)
NOISE = 0.05


def metrics(gain, load, drag, seed):
    error, peak = NOISE * np.random.default_rng(seed).standard_normal(2)
    return {"error": load + gain * drag + error, "peak": load * (1.0 + drag) + peak}


def machine(count, gains=(0.5,), **shift):
    """Runs with the load 1.3 and the drag 0.8, some metrics shifted."""
    sets = {}
    for gain in gains:
        runs = [metrics(gain, 1.3, 0.8, 1000 + k) for k in range(count)]
        sets[parameter_set({"gain": gain})] = [
            {name: value + shift.get(name, 0.0) for name, value in run.items()} for run in runs
        ]
    return MachineRuns(sets, ("error", "peak"), 0)


def identified(runs, study=STUDY, function=metrics):
    return identify(study, runs, Driver(FunctionBackend(study, function)), 30)


def test_the_machine_is_where_it_is():
    """Two metrics of two unknowns: their errors follow from the Jacobian of both."""
    result = identified(machine(10))
    assert result.misfits(0.01) == []
    assert result.simulated == 60
    jacobian = np.array([[1.0, 0.5], [1.8, 1.3]])
    deviation = NOISE / np.sqrt(10) * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    contexts = result.posterior.contexts
    assert contexts.mean(axis=0) == pytest.approx([1.3, 0.8], abs=3.5 * deviation.max())
    assert (contexts.std(axis=0) < 2.5 * deviation).all()
    narrower = narrowed(STUDY, contexts, 0.99)
    for name, value in (("load", 1.3), ("drag", 0.8)):
        distribution = narrower.contexts[name].distribution
        assert distribution.lower < value < distribution.upper
        assert distribution.width < 0.6


def test_the_same_runs_give_the_same_answer():
    one, other = identified(machine(4)), identified(machine(4))
    assert np.array_equal(one.posterior.contexts, other.posterior.contexts)


def test_runs_at_two_parameter_sets():
    one, two = identified(machine(5)), identified(machine(5, (0.1, 0.9)))
    assert two.simulated == 120
    assert two.posterior.contexts[:, 1].std() < one.posterior.contexts[:, 1].std()


def test_what_no_context_explains_is_said():
    lines = identified(machine(10, error=-2.0)).misfits(0.01)
    (line,) = (line for line in lines if line.startswith("error: "))
    assert " below that of the simulator" in line


def test_more_scatter_is_said():
    runs = machine(10)
    ((key, values),) = runs.sets.items()
    scattered = [v | {"peak": v["peak"] + (-1.0) ** k} for k, v in enumerate(values)]
    misfits = identified(MachineRuns({key: scattered}, runs.metrics, 0)).misfits(0.01)
    assert any(line.startswith("peak: equal runs of the machine differ ") for line in misfits)


def test_a_simulator_without_noise_takes_that_of_the_machine():
    study = make_study(contexts=CONTEXTS, seed_parameter=None)

    def exact(gain, load, drag):
        return {"error": load + gain * drag, "peak": load * (1.0 + drag)}

    result = identified(machine(10), study, exact)
    assert result.misfits(0.01) == []
    assert result.posterior.contexts.mean(axis=0) == pytest.approx([1.3, 0.8], abs=0.15)
    with pytest.raises(RunRecordError, match=r"has no noise .* expected at least 2 repeated runs"):
        identified(machine(1), study, exact)


def test_a_simulator_that_fails():
    with pytest.raises(
        RunRecordError, match=r"the simulator fails in 30 of 30 contexts .*: jammed"
    ):
        identified(machine(3), function=lambda **_: failed("jammed"))


def test_failures_in_some_contexts_are_left_out():
    def some(gain, load, drag, seed):
        return failed("jammed") if load > 1.9 else metrics(gain, load, drag, seed)

    assert identified(machine(10), function=some).misfits(0.01) == []


def test_the_figure_has_a_panel_for_each_context():
    result = identified(machine(5))
    figure = context_figure(result, narrowed(STUDY, result.posterior.contexts, 0.99))
    assert [panel.x.label for panel in figure.panels] == ["load", "drag"]
    before, after, *_ = figure.panels[0].elements
    # Shares of all samples, the last one twice for the last step.
    assert sum(before.y[:-1]) == pytest.approx(1.0)
    assert sum(after.y[:-1]) == pytest.approx(1.0)
    assert max(after.y) > 2.0 * max(before.y)
