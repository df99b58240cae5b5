"""Constraints: an upper limit, a lower one, or both."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from bo_tuner.errors import StudyError
from bo_tuner.study.constraint import Constraint
from bo_tuner.study.metrics import SignalMetric
from bo_tuner.study.references import check_constraint
from bo_tuner.study.study_file import parse_study, study_to_yaml

BOTH = {"kind": "worst_case", "metric": "peak", "lower": 0.2, "upper": 1.0}


def refusal(make_study, **constraints):
    with pytest.raises(StudyError) as caught:
        make_study(constraints=constraints)
    return str(caught.value)


class TestOneLimit:
    def test_what_violates_a_lower_limit_is_below_it(self):
        constraint = Constraint(name="grip", kind="worst_case", metric="force", lower=2.0)
        assert constraint.violations([1.9, 2.0, 2.1]).tolist() == [True, False, False]
        assert (constraint.limit, constraint.side, constraint.beyond) == (2.0, "lower", "below")
        assert constraint.farthest([3.0, 1.5, 2.0]) == 1.5
        assert math.isnan(constraint.farthest([]))

    @pytest.mark.parametrize(
        ("limits", "value", "excess"),
        [
            ({"upper": 2.0}, 3.0, 0.5),
            ({"upper": -2.0}, -1.0, 0.5),
            ({"lower": 2.0}, 1.0, 0.5),
            ({"lower": 2.0}, 3.0, -0.5),
            ({"upper": 0.0}, 3.0, 3.0),
        ],
    )
    def test_excess_is_relative_to_the_size_of_the_limit(self, limits, value, excess):
        constraint = Constraint(name="c", kind="worst_case", metric="m", **limits)
        assert constraint.excess(value) == excess


class TestBothLimits:
    def test_they_are_two_constraints(self, make_study):
        study = make_study(constraints={"peak": BOTH})
        lower, upper = study.constraints.values()
        assert (lower.name, lower.lower, lower.upper) == ("peak_lower", 0.2, None)
        assert (upper.name, upper.lower, upper.upper) == ("peak_upper", None, 1.0)
        assert lower.probability is upper.probability is None

    def test_together_they_are_kept_as_often_as_asked(self, make_study):
        """By Boole's inequality: a metric at the edge of both is within them with 90 %."""
        kind = {"kind": "chance", "probability": 0.9}
        study = make_study(constraints={"peak": BOTH | kind})
        lower, upper = study.constraints.values()
        assert lower.level == upper.level == pytest.approx(0.95)
        deviations = norm.ppf(0.95)
        mean, sigma = 0.6, 0.4 / deviations
        within = norm.cdf(1.0, mean, sigma) - norm.cdf(0.2, mean, sigma)
        assert within == pytest.approx(0.9)

    def test_the_study_is_the_same_when_it_is_written_and_read(self, make_study):
        study = make_study(constraints={"peak": BOTH, "error": {**BOTH, "metric": "error"}})
        assert list(study.constraints) == ["peak_lower", "peak_upper", "error_lower", "error_upper"]
        assert parse_study(study_to_yaml(study)) == study
        assert study.replace(seed=study.seed) == study

    def test_without_a_split_there_is_no_single_limit(self):
        constraint = Constraint(name="c", kind="worst_case", metric="m", lower=0.0, upper=1.0)
        with pytest.raises(ValueError, match="two limits"):
            _ = constraint.limit


def test_a_limit_is_named_where_another_one_is_on_the_same_side(make_study):
    study = make_study(
        constraints={
            "peak": BOTH,
            "mean": {"kind": "chance", "metric": "peak", "upper": 0.9, "probability": 0.96},
        }
    )
    titles = {name: study.titled(c, study.limited(c)) for name, c in study.constraints.items()}
    assert titles == {
        "peak_lower": "lowest peak",
        "peak_upper": "peak (peak_upper)",
        "mean": "peak (mean)",
    }


def test_several_worst_cases(make_study):
    study = make_study(
        constraints={
            "peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0},
            "error": {"kind": "worst_case", "metric": "error", "lower": 0.0},
            "often": {"kind": "chance", "metric": "error", "upper": 9.0, "probability": 0.9},
        }
    )
    assert [c.name for c in study.worst_case_constraints] == ["peak", "error"]
    assert [c.name for c in study.drawn_constraints] == ["often"]


class TestRefusals:
    def test_no_limit(self, make_study):
        found = refusal(make_study, peak={"kind": "worst_case", "metric": "peak"})
        assert found == "constraints.peak.upper: missing; expected upper, lower or both"

    @pytest.mark.parametrize("lower", [1.0, 2.0])
    def test_limits_in_the_wrong_order(self, make_study, lower):
        found = refusal(make_study, peak=BOTH | {"lower": lower})
        expected = f"constraints.peak.lower: expected less than upper, 1, found {lower:g}"
        assert found == expected

    @pytest.mark.parametrize("lower", [np.nan, np.inf, "0.2 m", True])
    def test_a_lower_limit_that_is_no_number(self, make_study, lower):
        found = refusal(make_study, peak=BOTH | {"lower": lower})
        assert found.startswith("constraints.peak.lower: expected a ")

    def test_a_name_that_the_split_takes(self, make_study):
        one = {"kind": "worst_case", "metric": "peak", "upper": 1.0}
        found = refusal(make_study, peak=BOTH, peak_upper=one)
        assert found == (
            "constraints.peak: is split into 'peak_upper' and another, but there is such a "
            "constraint"
        )


def test_a_limit_below_the_least_value_of_a_measure():
    metric = SignalMetric(name="over", of="x", measure="overshoot", target=1.0)
    limit = Constraint(name="over", kind="worst_case", metric="over", upper=-1.0)
    with pytest.raises(StudyError, match="no run keeps it: overshoot is at least 0, found -1"):
        check_constraint(limit, {"over": metric})
    check_constraint(replace(limit, upper=0.0), {"over": metric})


@pytest.mark.parametrize("model", ["outliers", "objective"])
def test_the_models_of_further_objectives_have_taken_their_names(make_study, model):
    name = f"{model}_peak"
    limit = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.9}
    make_study(constraints={name: limit})
    with pytest.raises(StudyError, match=f"the models call another one '{name}'"):
        make_study(constraints={name: limit}, further_objectives=[{"metric": "peak"}])
