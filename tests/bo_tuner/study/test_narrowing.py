"""Narrower distributions of contexts, from samples."""

import numpy as np
import pytest
from functions import NODE, make_study

from bo_tuner.study.narrowing import beyond, narrowed
from bo_tuner.study.study_file import parse_study, study_to_yaml

UNIFORM = NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]}


def samples(*columns):
    return np.stack(columns, axis=1)


def test_the_bounds_of_two_contexts_together_hold_the_probability():
    study = make_study(contexts={"load": UNIFORM, "drag": UNIFORM})
    rng = np.random.default_rng(1)
    contexts = samples(rng.normal(1.4, 0.05, 10_000), rng.normal(1.7, 0.01, 10_000))
    load, drag = (v.distribution for v in narrowed(study, contexts, 0.98).contexts.values())
    # 99 % of each: 2.576 standard deviations to either side.
    assert load.bounds == pytest.approx((1.4 - 0.1288, 1.4 + 0.1288), abs=0.01)
    assert drag.bounds == pytest.approx((1.7 - 0.02576, 1.7 + 0.02576), abs=0.002)
    assert (load.mean, load.standard_deviation) == pytest.approx((1.4, 0.05), abs=0.002)
    assert load.nominal == load.mean


def test_what_is_written_can_be_read():
    study = make_study(contexts={"load": UNIFORM})
    narrower = narrowed(study, samples(np.linspace(1.2, 1.3, 50)), 0.9)
    assert parse_study(study_to_yaml(narrower)) == narrower


def test_samples_of_one_value_leave_some_room_within_the_box():
    study = make_study(contexts={"load": UNIFORM})
    (load,) = (v.distribution for v in narrowed(study, np.full((9, 1), 2.0), 0.9).contexts.values())
    assert load.bounds == pytest.approx((1.999, 2.0))


@pytest.mark.parametrize(
    ("values", "bounds"), [([3, 3, 3], (3, 4)), ([5, 5, 5], (4, 5)), ([1, 2, 3], (1, 3))]
)
def test_integers_have_integer_bounds(values, bounds):
    teeth = NODE | {"distribution": "uniform", "bounds": [1, 5], "type": "integer"}
    narrower = narrowed(
        make_study(contexts={"teeth": teeth}), np.array(values, float)[:, None], 0.99
    )
    assert narrower.contexts["teeth"].distribution.bounds == bounds


def test_of_a_discrete_context_the_probable_values_are_left():
    tools = NODE | {"distribution": "discrete", "values": ["drill", "mill", "saw", "disc"]}
    study = make_study(contexts={"tool": tools})
    contexts = np.array([2.0] * 70 + [0.0] * 29 + [1.0])[:, None]
    left = narrowed(study, contexts, 0.9).contexts["tool"].distribution
    assert left.values == ("drill", "saw")
    assert left.probabilities == pytest.approx((29 / 99, 70 / 99))
    # Of a single value there is no distribution.
    left = narrowed(study, np.full((10, 1), 3.0), 0.9).contexts["tool"].distribution
    assert len(left.values) == 2
    assert "disc" in left.values
    assert left.nominal == "disc"


def test_what_lies_beyond_the_contexts_of_a_study():
    study = make_study(contexts={"load": UNIFORM})
    box = make_study(
        contexts={"load": UNIFORM | {"bounds": [0.0, 4.0]}, "drag": UNIFORM},
    )
    contexts = samples(np.array([0.5, 1.5, 1.6, 2.5]), np.array([1.5] * 4))
    assert beyond(study, box, contexts) == {"load": 0.5}
    assert beyond(study, box, contexts[1:3]) == {}
