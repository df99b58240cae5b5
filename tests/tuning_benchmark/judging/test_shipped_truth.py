"""The shipped truth, and the study that comes with the benchmarks."""

import dataclasses
import json

import clipped_law
import numpy as np
import pytest
from scenario_table import NAMES
from scipy.stats import truncnorm

from bo_tuner.package_files import config_directory
from bo_tuner.study.study_file import load_study
from tuning_benchmark.judging.truth import Effort, Truth

JUDGE = "tuning_benchmark.milling.judge:Judge"
SMALL = Effort(drawn=6, grid=3, real_evaluations=2)
SECOND_AXIS = config_directory("tuning_benchmark") / "studies" / "second_axis.yaml"
OPTIMA = config_directory("tuning_benchmark") / "experiments" / "grid_search.json"


@pytest.mark.parametrize("name", ["benchmark", "full"])
@pytest.mark.parametrize("kind", ["optimum", "default"])
def test_the_judge_reproduces_the_shipped_optima(name, kind):
    entry = json.loads(OPTIMA.read_text())[name][kind]
    study = load_study(name)
    limit = study.constraints["overshoot"]
    # The grid search asked for the mean over noise.
    on_mean = {"overshoot": dataclasses.replace(limit, probability=None)}
    study = dataclasses.replace(study, constraints=study.constraints | on_mean)
    verdict = Truth(study, JUDGE, Effort(real_evaluations=2)).verdict(entry["parameters"])
    assert verdict.objective == pytest.approx(entry["E"], rel=1e-6)
    assert verdict.worst == pytest.approx(entry["worst"], rel=1e-6)
    assert verdict.feasible == entry["feasible"] == (kind == "optimum")


@pytest.mark.parametrize("name", ["benchmark", "full"])
def test_an_independent_loop_finds_the_shipped_optima_as_good_as_they_say(name):
    """Its input is clipped, which makes no difference where the limits are hardly active."""
    entry = json.loads(OPTIMA.read_text())[name]["optimum"]
    row = tuple(entry["parameters"][parameter] for parameter in NAMES)
    rng = np.random.default_rng(2)
    # The study's contexts, and the one that is the worst in all rows of the scenario's table.
    drawn = truncnorm.rvs(-1.5, 1.5, loc=1.0, scale=0.2, size=(2, 1500), random_state=rng)
    error = clipped_law.simulate(row, *drawn, clipped_law.draw_noise(rng, 1500)).tracking_error
    corner = np.outer((1.3, 0.7), np.ones(400))
    overshoot = clipped_law.simulate(row, *corner, clipped_law.draw_noise(rng, 400)).overshoot
    assert tuple(entry["worst_context"].values()) == (1.3, 0.7)
    # Some three standard errors of both means together: E, and that of 20 draws for the worst.
    assert entry["E"] == pytest.approx(error.mean(), abs=4 * entry["standard_error"])
    assert entry["worst"] == pytest.approx(overshoot.mean(), abs=3 * overshoot.std() / 20**0.5)


def test_at_the_optimum_for_the_mean_half_of_the_runs_exceed_the_limit():
    """The worst mean is at the limit, so there a study that promises 0.85 has no solution."""
    entry = json.loads(OPTIMA.read_text())["benchmark"]["optimum"]
    effort = Effort(drawn=6, grid=3, real_evaluations=2)
    verdict = Truth(load_study("benchmark"), JUDGE, effort).verdict(entry["parameters"])
    assert verdict.worst == pytest.approx(0.09, abs=1e-3)
    assert verdict.worst_kept == pytest.approx(0.5, abs=0.1)
    assert not verdict.feasible


def test_second_axis_is_infeasible_by_default():
    study = load_study(SECOND_AXIS)
    assert study.search_space().dimension == 3
    truth = Truth(study, JUDGE, SMALL)
    assert truth.verdict(study.search_space().defaults).worst > truth.limit


def test_second_axis_has_a_feasible_region():
    parameters = {
        "control_horizon": 4,
        "prediction_horizon": 8,
        "lambda_mpc": -0.5,
        "lambda_kf": -1.0,
    }
    assert Truth(load_study(SECOND_AXIS), JUDGE, SMALL).verdict(parameters).feasible
