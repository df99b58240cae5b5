"""Studies of functions, from Python and from files."""

import numpy as np
import pytest
from example_nodes import UNCHANGED

import bo_tuner as bt
from bo_tuner.study.study_file import parse_study

TEXT = """\
name: axis
parameters:
  gain: {type: double, bounds: [0.1, 10.0], default: 1.0, scale: log, unit: W/K}
  order: {type: integer, bounds: [1, 4], default: 2}
  filter: {type: boolean, default: true}
  law: {type: string, choices: [pi, pid], default: pi}
contexts:
  load: {distribution: uniform, bounds: [1.0, 2.0]}
  tool: {distribution: discrete, values: [1.0, 3.0], probabilities: [0.75, 0.25]}
metrics:
  error: {unit: rad}
  peak: {}
objective: error + 0.01 * peak
constraints:
  peak: {kind: worst_case, metric: peak, upper: 2.0}
  calm: {kind: chance, metric: error, upper: 1.0, probability: 0.9}
budget: {trials: 12, initial_trials: 6}
seed: 3
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_python_and_file_describe_the_same_study(file):
    made = bt.Study(
        name="axis",
        parameters={
            "gain": bt.Double(0.1, 10.0, default=1.0, scale="log", unit="W/K"),
            "order": bt.Integer(1, 4, default=2),
            "filter": bt.Boolean(True),
            "law": bt.Choice(("pi", "pid"), default="pi"),
        },
        contexts={
            "load": bt.Uniform(bounds=(1.0, 2.0)),
            "tool": bt.Discrete(values=(1.0, 3.0), probabilities=(0.75, 0.25)),
        },
        metrics={"error": {"unit": "rad"}, "peak": {}},
        objective="error + 0.01 * peak",
        constraints={
            "peak": bt.WorstCase("peak", upper=2.0),
            "calm": bt.Chance("error", upper=1.0, probability=0.9),
        },
        budget=bt.Budget(trials=12, initial_trials=6),
        seed=3,
    )
    read = bt.Study.from_yaml(file)
    assert made == read
    assert made.defaults == {"gain": 1.0, "order": 2, "filter": True, "law": "pi"}
    # What it is written as is a whole study file, which the commands read, too.
    assert parse_study(made.to_yaml()) == read.checked


def test_an_error_names_file_line_and_key(file):
    file.write_text(TEXT.replace("bounds: [1, 4]", "bounds: [4, 1]"), encoding="utf-8")
    with pytest.raises(bt.StudyError, match=r"axis\.yaml:4: parameters\.order\.bounds"):
        bt.Study.from_yaml(file)


def test_an_error_in_python_names_the_key(make_function_study):
    with pytest.raises(bt.StudyError, match=r"^constraints\.peak\.metric: .*'peek'"):
        make_function_study(constraints={"peak": bt.WorstCase("peek", upper=1.0)})
    with pytest.raises(bt.StudyError, match=r"^parameters\.gain\.default: 5"):
        make_function_study(parameters={"gain": bt.Double(0.0, 1.0, default=5.0)})
    with pytest.raises(bt.StudyError, match=r"^budgets: unknown key; did you mean 'budget'"):
        make_function_study(budgets=3)


@pytest.mark.parametrize("metrics", ["error", 3, [{"error": {}}], []])
def test_metrics_that_are_none(make_function_study, metrics):
    with pytest.raises(bt.StudyError, match=r"^metrics: expected"):
        make_function_study(metrics=metrics)


def test_numbers_of_numpy_are_numbers(make_function_study):
    bounds = np.array([0.0, 1.0])
    parameters = {
        "gain": bt.Double(*bounds, default=np.float32(0.5)),
        "n": bt.Integer(1, np.int64(4), default=2),
    }
    study = make_function_study(parameters=parameters)
    assert study.defaults == {"gain": 0.5, "n": 2}


def test_all_that_is_wrong_is_told(make_function_study):
    with pytest.raises(bt.StudyError) as error:
        make_function_study(
            parameters={"gain": bt.Double(1.0, 0.0, default=0.5)},
            budget={"trials": 0, "initial_trials": 1},
        )
    assert {"parameters.gain", "budget.trials"} <= {
        ".".join(map(str, each.path[:2])) for each in (error.value, *error.value.others)
    }
    assert error.value.__notes__ == [str(other) for other in error.value.others]


@pytest.mark.parametrize("holder", [dict, list])
def test_a_part_of_itself(make_function_study, holder):
    part = holder()
    part.update(gain=part) if isinstance(part, dict) else part.append(part)
    for given in ({"parameters": {"gain": part}}, {"contexts": part}, {"start": part}):
        with pytest.raises(bt.StudyError, match="a part of it has itself as a part"):
            make_function_study(**given)


def test_commands_do_not_take_a_file_without_nodes_for_whole():
    with pytest.raises(bt.StudyError, match=r"parameters\.gain: is used nowhere; expected node"):
        parse_study(TEXT)


def test_a_study_of_signals_is_refused():
    """A function records no topics."""
    with pytest.raises(bt.StudyError, match=r"metrics\.\w+: is computed from signals"):
        bt.Study.from_yaml(UNCHANGED / "study.yaml")
