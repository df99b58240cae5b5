import dataclasses

import numpy as np
import pytest
from valley import true_objective, true_worst

from bo_tuner.errors import StudyError
from bo_tuner.study.search_space import STEP
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from tuning_benchmark.judging.neighbours import judge_neighbours
from tuning_benchmark.judging.truth import Effort, Truth, truth_of, verdict_record
from tuning_benchmark.pages.summary import is_narrow

JUDGE = "valley:Judge"


@pytest.fixture(scope="module")
def truth(study):
    return Truth(study, JUDGE)


@pytest.mark.parametrize("gains", [(0.1, 0.2), (0.6, 0.6), (0.7, 0.7)])
def test_a_verdict_is_the_closed_form(truth, gains):
    verdict = truth.verdict({"g0": gains[0], "g1": gains[1]})
    assert verdict.objective == pytest.approx(true_objective(gains), rel=2e-3)
    assert verdict.worst == pytest.approx(true_worst(gains))
    assert verdict.worst_context == {"load": pytest.approx(1.2)}
    assert verdict.feasible == (true_worst(gains) <= 0.75)


@pytest.mark.parametrize(("gain", "kept"), [(0.5625, 0.875), (0.575, 0.8)])
def test_a_limit_on_single_runs_is_judged_by_the_share_that_keeps_it(study, gain, kept):
    """The worst mean is 1.2 times the gain: (0.75 - mean + 0.1) / 0.2 of the runs are within."""
    constraint = dataclasses.replace(study.constraints["peak"], probability=0.85)
    single = dataclasses.replace(study, constraints=study.constraints | {"peak": constraint})
    verdict = Truth(single, "valley:NoisyJudge").verdict({"g0": gain, "g1": gain})
    assert verdict.worst_kept == pytest.approx(kept, abs=2e-3)
    assert verdict.feasible == (kept >= 0.85)
    on_mean = Truth(study, "valley:NoisyJudge").verdict({"g0": gain, "g1": gain})
    assert on_mean.feasible
    assert on_mean.worst_kept == verdict.worst_kept
    few = Truth(study, "valley:NoisyJudge").verdict({"g0": gain, "g1": gain}, 2)
    assert few.feasible
    assert np.isnan(few.worst_kept)


def test_single_violations_are_a_share_of_the_drawn_contexts(truth):
    # 0.65 times a load from 0.8 to 1.2 exceeds 0.75 above a load of 1.154.
    verdict = truth.verdict({"g0": 0.65, "g1": 0.65})
    assert verdict.single_violation == pytest.approx((1.2 - 0.75 / 0.65) / 0.4, abs=0.01)


def test_drawn_constraints_are_counted_over_evaluations(study):
    mapping = study_to_mapping(study)
    often = {"kind": "chance", "metric": "peak", "upper": 0.5, "probability": 0.9}
    limited = study_from_mapping(mapping | {"constraints": mapping["constraints"] | {"o": often}})
    truth = Truth(limited, JUDGE, Effort(real_evaluations=40))
    # The peak is half the load, give or take 0.01: below 0.5 in every other context.
    shares, holds = truth.meets_chances({"g0": 0.5, "g1": 0.5})
    assert shares["o"] == pytest.approx(0.5, abs=0.15)
    assert not holds
    assert not truth.verdict({"g0": 0.5, "g1": 0.5}).feasible
    assert truth.meets_chances({"g0": 0.1, "g1": 0.1}) == ({"o": 1.0}, True)


def test_the_grid_reaches_the_bounds_and_knows_its_corners(study):
    mapping = study_to_mapping(study)
    wear = {"node": "valley", "distribution": "uniform", "bounds": [3.0, 4.0]}
    two = study_from_mapping(mapping | {"contexts": mapping["contexts"] | {"wear": wear}})
    truth = Truth(two, JUDGE, Effort(grid=3))
    assert len(np.unique(truth.grid_contexts, axis=0)) == 9
    corners = truth.grid_contexts[truth.corners].round(9)
    assert {tuple(row) for row in corners} == {(a, b) for a in (0.8, 1.2) for b in (3.0, 4.0)}


def test_a_judge_that_refuses_a_study_is_one_line(make_study):
    with pytest.raises(StudyError, match="valley:Judge cannot judge function: ValueError: no vall"):
        Truth(make_study(), JUDGE)


def test_a_study_without_a_worst_case_cannot_be_judged(study):
    with pytest.raises(StudyError, match="expected one worst_case constraint"):
        Truth(dataclasses.replace(study, constraints={}), JUDGE)


def test_the_truth_is_the_same_for_all_seeds(study):
    assert truth_of(study, JUDGE) is truth_of(study.replace(seed=7), JUDGE)


def test_a_record_has_none_for_what_is_not_a_number(truth):
    verdict = dataclasses.replace(truth.verdict({"g0": 0.5, "g1": 0.5}), objective=np.nan)
    assert verdict_record(verdict)["objective"] is None


def test_neighbours_are_a_step_away_within_the_bounds(truth):
    here = {"g0": 0.6, "g1": 1.0}
    found = judge_neighbours(truth, here, truth.verdict(here))
    points = [(n["parameters"]["g0"], n["parameters"]["g1"]) for n in found]
    expected = [(0.6 - STEP, 1.0), (0.6 + STEP, 1.0), (0.6, 1.0 - STEP)]
    assert np.array(points) == pytest.approx(np.array(expected))
    assert [n["changed"] for n in found] == [["g0"], ["g0"], ["g1"]]


def test_narrow_is_a_step_beyond_a_fifth(truth):
    flat = truth.verdict({"g0": 0.6, "g1": 0.6})
    around = judge_neighbours(truth, {"g0": 0.6, "g1": 0.6}, flat)
    assert not is_narrow(truth.study, around)
    # As if the middle were much lower than it is.
    low = dataclasses.replace(flat, objective=flat.objective / 1.3)
    assert is_narrow(truth.study, judge_neighbours(truth, {"g0": 0.6, "g1": 0.6}, low))
    # The worst case at a step is 0.75 * 1.225 there: beyond the limit by more than a fifth.
    beyond = {"g0": 0.75, "g1": 0.75}
    assert is_narrow(truth.study, judge_neighbours(truth, beyond, truth.verdict(beyond)))


def test_only_steps_of_integers_make_a_milling_optimum_narrow():
    study = load_study("benchmark")
    steps = [{"changed": ["lambda_mpc"], "tolerable": False}]
    assert not is_narrow(study, steps)
    assert is_narrow(study, [*steps, {"changed": ["control_horizon"], "tolerable": False}])
