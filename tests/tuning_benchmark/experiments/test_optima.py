"""What answers are measured against."""

import dataclasses
import json

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.package_files import config_directory
from bo_tuner.study.study_file import load_study
from tuning_benchmark.experiments.experiment_file import load_experiment
from tuning_benchmark.experiments.optima import Optimum, optimum_of, read_optima, study_digest
from tuning_benchmark.problems.closed_form import ClosedForm

OPTIMA = config_directory("tuning_benchmark") / "experiments" / "grid_search.json"


@pytest.mark.parametrize("name", ["benchmark", "full"])
def test_the_shipped_optima_are_of_the_shipped_studies(name):
    study = load_study(name)
    entries = read_optima(OPTIMA)
    assert optimum_of(entries, study).objective == entries[name]["optimum"]["E"]


def test_an_optimum_is_of_a_study_not_of_a_name():
    study = load_study("benchmark")
    overshoot = dataclasses.replace(study.constraints["overshoot"], upper=0.1)
    other = dataclasses.replace(study, constraints=study.constraints | {"overshoot": overshoot})
    assert optimum_of(read_optima(OPTIMA), other) is None
    assert optimum_of({}, study) is None
    renamed = dataclasses.replace(study, name="another")
    assert optimum_of(read_optima(OPTIMA), renamed) == optimum_of(read_optima(OPTIMA), study)


def test_what_does_not_change_the_truth_does_not_change_the_digest():
    study = load_study("benchmark")
    overshoot = dataclasses.replace(study.constraints["overshoot"], probability=None)
    on_mean = dataclasses.replace(study, constraints=study.constraints | {"overshoot": overshoot})
    for same in (study.replace(seed=9, trials=99), on_mean):
        assert study_digest(same) == study_digest(study)


def test_the_frontier_is_interpolated_and_ends_where_it_is_known():
    optimum = Optimum(1.0, (0.5, 1.0), (2.0, 1.0))
    assert [optimum.at(w) for w in (0.4, 0.5, 0.75, 1.0, 1.1)] == [None, 2.0, 1.5, 1.0, None]
    assert Optimum(1.0).at(1.0) is None


@pytest.mark.parametrize("probability", [None, 0.85])
def test_a_closed_form_knows_its_own_optimum(probability):
    problem = ClosedForm(parameters=4, contexts=2, noise="constant", probability=probability)
    optimum = optimum_of({}, problem.study())
    assert optimum.objective == problem.best
    for worst in (0.8, 0.957, 1.0):
        assert optimum.at(worst) == pytest.approx(float(problem.frontier(worst)), rel=1e-5)


def test_an_experiment_makes_a_closed_form_from_its_numbers(experiment_file):
    text = experiment_file.read_text()
    made = text.replace("study: valley.yaml", "study: {parameters: 3, contexts: 2, crash: true}")
    experiment_file.write_text(made)
    study = load_experiment(str(experiment_file)).cases["valley"].study
    assert study == ClosedForm(parameters=3, contexts=2, crash=True).study()
    experiment_file.write_text(made.replace("contexts: 2", "contexts: 0"))
    with pytest.raises(StudyError, match="contexts") as caught:
        load_experiment(str(experiment_file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["[1]", "{", json.dumps({"benchmark": {"optimum": {"E": 1.0}}})])
def test_a_file_of_optima_that_is_none_is_refused(tmp_path, text):
    path = tmp_path / "optima.json"
    path.write_text(text)
    with pytest.raises(StudyError):
        read_optima(path)
