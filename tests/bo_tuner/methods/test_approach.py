"""Where `boundary` searches as long as no parameter set is believed to be feasible."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bo_tuner.methods.boundary.approach import Approach
from bo_tuner.methods.registry import METHODS
from bo_tuner.optimizers.base import ACQUISITION
from bo_tuner.optimizers.box import Box
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning

NODE = {"node": "axis"}
GAIN = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
BOUNDARY = METHODS["boundary"]


@pytest.fixture
def study(make_study):
    """Two gains and a choice; four of the trials are the initial design."""
    mode = NODE | {"type": "string", "choices": ["a", "b", "c"], "default": "a"}
    study = make_study(parameters={"p": GAIN, "q": GAIN, "mode": mode})
    return study.replace(trials=20, initial_trials=4)


@pytest.fixture
def trials(make_trial):
    """Function that makes trials at values of p and q."""

    def make(*points):
        return [
            make_trial(number, {"p": p, "q": q, "mode": "a"}, errors=[1.0])
            for number, (p, q) in enumerate(points)
        ]

    return make


class Distance:
    """A limit of 1 that is exceeded by the distance of p from 0.2 and by 1 more."""

    limit = 1.0

    def excess(self, x):
        return 1.0 + np.abs(x[:, 0] - 0.2)


@pytest.fixture
def surrogates():
    return SimpleNamespace(constraints={"peak": Distance()})


def box_of(study, surrogates, trials):
    return Approach(half_width=0.3, doubled=1.0).box(surrogates, study, trials)


def test_is_around_the_least_violating_parameter_set(study, surrogates, trials):
    known = trials((0.9, 0.9), (0.6, 0.4), (0.1, 0.5), (0.8, 0.1))
    box = box_of(study, surrogates, known)
    # The box ends at the faces of the cube, and has all choices.
    assert box.lower == pytest.approx([0.0, 0.2, 0.0])
    assert box.upper == pytest.approx([0.4, 0.8, 1.0])


def test_grows_with_proposals_that_violate_no_less(study, surrogates, trials):
    known = trials(*[(0.9, 0.9)] * 3, (0.5, 0.5), *[(0.9, 0.1)] * 3)
    for count, half_width in ((4, 0.3), (5, 0.3 * 2 ** (1 / 3)), (7, 0.6)):
        box = box_of(study, surrogates, known[:count])
        assert box.upper[:2] == pytest.approx(np.minimum(0.5 + half_width, 1.0))


def test_does_not_grow_with_the_initial_design(study, surrogates, trials):
    known = trials((0.5, 0.5), *[(0.9, 0.1)] * 3)
    assert box_of(study, surrogates, known).upper[:2] == pytest.approx([0.8, 0.8])


def test_is_the_cube_where_nothing_is_known(study, surrogates, trials):
    assert box_of(study, surrogates, []) is None
    assert box_of(study, SimpleNamespace(constraints={}), trials((0.5, 0.5))) is None


def test_points_drawn_in_a_box_are_in_it_and_others_move_to_its_nearest():
    box = Box(np.array([0.2, 0.0]), np.array([0.4, 1.0]))
    drawn = box.latin_hypercube(10, np.random.default_rng(0))
    assert (drawn >= box.lower).all()
    assert (drawn <= box.upper).all()
    # One in each tenth of each edge.
    strata = np.floor((drawn - box.lower) / (box.upper - box.lower) * 10)
    assert (np.sort(strata, axis=0) == np.arange(10)[:, None]).all()
    assert box.nearest(np.array([[0.1, 0.5], [0.3, 0.7]])).tolist() == [[0.2, 0.5], [0.3, 0.7]]


@pytest.fixture
def proposals(make_study, function_backend):
    """Function that runs `boundary` on a function of two gains; its proposals in the cube."""

    def run(function, method=BOUNDARY, trials=12):
        study = make_study(parameters={"p": GAIN, "q": GAIN}).replace(
            trials=trials, initial_trials=4
        )
        made = list(Tuning(study, Driver(function_backend(study, function)), method))
        space = study.search_space()
        return [space.to_cube(t.parameters) for t in made], [t.origin for t in made]

    return run


def infeasible(p, q, load, seed):
    """Everything exceeds the limit of 1, least in the middle."""
    noise = np.random.default_rng(seed).normal(0.0, 0.01)
    return {"error": p, "peak": 1.6 + (p - 0.5) ** 2 + (q - 0.5) ** 2 + noise}


def test_nothing_feasible_is_searched_far_from_the_least_violating(proposals):
    near = replace(BOUNDARY, approach=Approach(half_width=0.2, doubled=1e3))
    whole = replace(BOUNDARY, approach=Approach(half_width=1.0))
    farthest = {}
    for name, method in (("near", near), ("whole", whole)):
        points, origins = proposals(infeasible, method)
        assert origins[4:].count(ACQUISITION) >= 6
        excess = [float(((point - 0.5) ** 2).sum()) for point in points]
        apart = [
            np.abs(points[k] - points[int(np.argmin(excess[:k]))]).max()
            for k in range(4, len(points))
            if origins[k] == ACQUISITION
        ]
        farthest[name] = max(apart)
    # The models' least violating one may be another one than the truth's, but not by far.
    assert farthest["near"] < 0.3
    assert farthest["whole"] > 0.4
