"""The summary of a variant beside the algorithm as shipped."""

import pytest
from ablations import CASES, EXPERIMENTS, ROW, SHIPPED, VARIANTS, compare

from tuning_benchmark.experiments.experiment_file import load_experiment


def runs(*objectives):
    """Runs with seeds from 1 on; None for an answer that is not feasible."""
    return [
        {
            "seed": seed,
            "evaluations": 100 + seed,
            "failed": seed % 2,
            "feasible": e is not None,
            "objective": e,
        }
        for seed, e in enumerate(objectives, start=1)
    ]


def test_pairs_of_seeds_are_compared():
    found = compare(runs(1.0, 1.5, None, 2.0), runs(0.5, 0.5, 0.5, None))
    assert (found["runs"], found["feasible"], found["only"], found["only_shipped"]) == (4, 3, 1, 1)
    assert found["objective"] == 1.5
    assert (found["evaluations"], found["failed"]) == (102.5, 0.5)
    assert found["mcnemar"] == 1.0
    # Differences 0.5 and 1.0; t with one degree of freedom is 12.706.
    half = 12.706 * 0.25
    assert found["difference"] == pytest.approx([0.75, 0.75 - half, 0.75 + half], rel=1e-4)


def test_without_pairs_there_is_no_difference():
    assert compare(runs(None, 1.0), runs(1.0, None))["difference"] is None


def test_every_case_has_the_algorithm_as_shipped_first():
    for case in CASES:
        assert next(v for v in VARIANTS if case in v.cases).title == SHIPPED
    for case, experiment in EXPERIMENTS.items():
        assert load_experiment(experiment).cases[case].rows[ROW].algorithm == "boundary"


def test_every_variant_is_another_method_or_budget():
    shipped, *others = VARIANTS
    for variant in others:
        assert variant.method != shipped.method or variant.budget
