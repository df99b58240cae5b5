"""Limits relative to the default: what they stand for, and what they cannot be."""

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.study.metrics import RelativeMetric
from bo_tuner.study.study_file import parse_study, study_to_yaml

NODE = {"node": "axis"}
METRICS = {"error": NODE, "peak": NODE | {"unit": "A"}}
CHANCE = {"kind": "chance", "metric": "peak", "probability": 0.9}


@pytest.fixture
def limited(make_study):
    """Function that makes a study with a limit on the peak."""

    def make(metrics=None, **limit):
        constraints = {"calm": CHANCE | limit}
        return make_study(metrics=METRICS | (metrics or {}), constraints=constraints)

    return make


@pytest.mark.parametrize(
    ("text", "factor", "limit"),
    [
        ("1.1 * default", 1.1, 0.0),
        ("default", 1.0, 0.0),
        ("default + 0.05", 1.0, 0.05),
        ("1.1 * default - 0.3", 1.1, -0.3),
        ("default / 4 + 2 * (1 + default) - 1", 2.25, 1.0),
    ],
)
def test_is_one_on_the_difference(limited, text, factor, limit):
    made = limited(upper=text)
    (constraint,) = made.constraints.values()
    metric = made.metrics[constraint.metric]
    assert (constraint.name, constraint.upper, constraint.probability) == ("calm", limit, 0.9)
    assert isinstance(metric, RelativeMetric)
    assert (metric.relative, metric.factor, metric.unit) == ("peak", factor, "A")
    assert metric.value({"peak": 7.0}, {"peak": 2.0}) == 7.0 - factor * 2.0
    assert parse_study(study_to_yaml(made)) == made


def test_names_read_well(limited):
    assert "peak_minus_1.1_default" in limited(upper="1.1 * default").metrics
    assert "peak_minus_default" in limited(upper="default + 1").metrics
    assert "peak_minus_0.00001_default" in limited(upper="1e-5 * default").metrics


@pytest.mark.parametrize("lower", ["0.9 * default", 0.2])
def test_both_sides_have_a_metric_of_their_own(limited, lower):
    """Either is violated half as often as both may be."""
    found = limited(lower=lower, upper="1.1 * default").constraints
    assert {k: (c.metric, c.lower, c.upper) for k, c in found.items()} == {
        "calm_lower": ("peak", 0.2, None)
        if lower == 0.2
        else ("peak_minus_0.9_default", 0.0, None),
        "calm_upper": ("peak_minus_1.1_default", None, 0.0),
    }
    assert [c.probability for c in found.values()] == [0.95, 0.95]


def test_both_sides_of_one_multiple_are_two_limits_on_one_metric(limited):
    made = limited(lower="default - 0.1", upper="default + 0.3")
    assert [(c.metric, c.limit) for c in made.constraints.values()] == [
        ("peak_minus_default", -0.1), ("peak_minus_default", 0.3),
    ]  # fmt: skip
    assert list(made.metrics) == ["error", "peak", "peak_minus_default"]


def test_a_second_limit_of_the_same_multiple_shares_its_metric(limited, make_study):
    metrics = METRICS | {"peak_minus_default": {"relative": "peak"}}
    both = {"calm": CHANCE | {"upper": "default"}, "calmer": CHANCE | {"upper": "default - 1"}}
    made = make_study(metrics=metrics, constraints=both)
    assert {c.metric for c in made.constraints.values()} == {"peak_minus_default"}
    with pytest.raises(StudyError, match="metric 'peak_minus_default', but there is another"):
        limited({"peak_minus_default": NODE}, upper="default")


def test_of_a_combined_metric(limited):
    metrics = {"cost": {"expression": "error + 2 * peak"}, "less": {"relative": "cost"}}
    made = limited(metrics, metric="cost", upper="1.1 * default")
    assert made.metrics["cost_minus_1.1_default"].relative == "cost"
    assert made.relative_metrics.keys() == {"less", "cost_minus_1.1_default"}


@pytest.mark.parametrize(
    ("limits", "problem"),
    [
        ({"upper": "1.1 * defualt"}, "calm.upper: expected .* no name .*did you mean 'default'"),
        ({"upper": "default ** 2"}, r"calm.upper: expected a number, or a multiple .*\*\* 2'"),
        ({"upper": "abs(default)"}, "calm.upper: expected a number, or a multiple"),
        ({"upper": "1 / default"}, "calm.upper: expected a number, or a multiple"),
        ({"upper": "max(default, 1)"}, "calm.upper: expected a number, or a multiple"),
        ({"upper": "default > 1"}, "calm.upper: expected a number, or a multiple"),
        ({"upper": "-1 * default"}, "calm.upper: expected a number, or a multiple"),
        ({"upper": "2 + 3"}, "calm.upper: expected a number, or a multiple"),
        ({"upper": "110 %"}, "calm.upper: expected a number, or .*default; not an expression"),
        ({"upper": "1.1"}, "calm.upper: expected a number, found text '1.1'"),
        ({"upper": "1e200 * default"}, "calm.upper: expected 0, or a number between"),
        ({"upper": "default", "lower": "default + 1"}, "calm.lower: expected less than upper"),
        ({"upper": "default", "metric": "pek"}, "calm.metric: there is no metric 'pek'"),
        ({"upper": "default", "probability": 2}, "calm.probability: expected a number between"),
        ({"upper": "default", "metric": "less"}, "calm.upper: metric 'less' is relative"),
    ],
)
def test_refusals(limited, limits, problem):
    with pytest.raises(StudyError, match=problem) as refused:
        limited({"less": {"relative": "peak"}}, **limits)
    assert refused.value.others == ()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("metric", "problem"),
    [
        ({"relative": "peek"}, "metrics.less.relative: there is no metric 'peek'"),
        ({"relative": "less"}, "metrics.less.relative: metric 'less' is relative itself"),
        ({"relative": "peak", "factor": -1}, "metrics.less.factor: expected a number above 0"),
    ],
)
def test_metrics_that_are_none(limited, metric, problem):
    with pytest.raises(StudyError, match=problem):
        limited({"less": metric}, upper=1.0)


def test_a_split_that_takes_the_name_of_another(make_study):
    both = {
        "calm": CHANCE | {"lower": 0.1, "upper": "default"},
        "calm_lower": CHANCE | {"upper": 1},
    }
    with pytest.raises(StudyError, match="is split into 'calm_lower' and another"):
        make_study(constraints=both)


def test_a_difference_has_no_logarithm(make_study):
    metrics = METRICS | {"less": {"relative": "peak"}}
    with pytest.raises(StudyError, match=r"objective\.scale: expected linear; metric 'less'"):
        make_study(metrics=metrics, objective={"metric": "less", "scale": "log"})
