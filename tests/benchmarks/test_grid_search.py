"""The search of a grid for the optimum: which limit it is for."""

from grid_search import on_the_mean

from bo_tuner.study.study_file import load_study
from tuning_benchmark.experiments.optima import study_digest


def test_the_limit_is_on_the_mean():
    study = load_study("benchmark")
    assert study.constraints["overshoot"].probability == 0.85
    searched = on_the_mean(study)
    assert not searched.constraints["overshoot"].rule.on_runs
    assert searched.constraints["real_time"] == study.constraints["real_time"]
    assert study_digest(searched) == study_digest(study)
