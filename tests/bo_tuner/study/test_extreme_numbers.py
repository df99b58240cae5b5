"""Numbers of a study that are finite, but as large or as small as there are: a study, or a line."""

import copy

import numpy as np
import pytest
from drive_text import mapping, places
from functions import FunctionBackend, make_study

from bo_tuner import maxima
from bo_tuner.errors import StudyError
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import conclude

MOST = maxima.MAGNITUDE
EXTREME = [
    sign * size
    for sign in (-1.0, 1.0)
    for size in (5e-324, 2.3e-308, 1e-200, 1.0 / MOST, MOST, 1e200, 1e308, 1.7976931348623157e308)
]


def full():
    """A study with all keys that take a number."""
    found = mapping()
    of_drive = {"node": "drive"}
    found["parameters"]["gains.kp"]["step"] = 0.5
    found["parameters"]["scaled"] = of_drive | {
        "type": "double", "bounds": [0.1, 2.0], "default": 0.5, "scale": "log",
    }  # fmt: skip
    box = of_drive | {"bounds": [0.0, 1.0], "nominal": 0.5}
    found["contexts"] |= {
        "normal": box | {
            "distribution": "truncated_normal", "mean": 0.5, "standard_deviation": 0.2,
        },
        "beta": box | {"distribution": "beta", "a": 2.0, "b": 3.0},
        "triangle": box | {"distribution": "triangular", "mode": 0.5},
        "discrete": of_drive | {
            "distribution": "discrete", "values": [0.5, 1.0], "probabilities": [0.5, 0.5],
        },
    }  # fmt: skip
    found["constraints"]["current"]["lower"] = -3.0
    found["certificate"] = {"draws": 20, "confidence": 0.9}
    found["trigger"]["timeout"] = 30.0
    return found


def numbers(value):
    for path in places(value):
        inner = value
        for key in path:
            inner = inner[key]
        if isinstance(inner, int | float):
            yield path


@pytest.mark.parametrize("path", list(numbers(full())), ids=lambda path: ".".join(map(str, path)))
def test_any_finite_number_gives_a_study_or_a_line(path):
    study_from_mapping(full())
    for number in EXTREME:
        changed = copy.deepcopy(full())
        inner = changed
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = number
        study, refused = None, None
        try:
            study = study_from_mapping(changed)
        except StudyError as error:
            refused = error
        if study is None:
            assert str(refused).isprintable()
            assert refused.path[:1] == path[:1], refused
            continue
        # Overflows would be warnings, and these are errors here.
        space, contexts, rng = study.search_space(), study.context_space(), np.random.default_rng(0)
        for point in space.latin_hypercube(5, rng):
            found = space.to_parameters(point)
            assert np.isfinite(space.to_cube(found)).all()
        drawn = contexts.draw(5, rng)
        assert np.all((drawn >= contexts.lower) & (drawn <= contexts.upper))


@pytest.mark.parametrize("side", ["upper", "lower"])
@pytest.mark.parametrize("limit", [-MOST, 1.0 / MOST, MOST])
@pytest.mark.parametrize("kind", [{"kind": "worst_case"}, {"kind": "chance", "probability": 0.9}])
def test_a_run_with_a_limit_that_is_extreme(kind, limit, side):
    """It comes to its end, and finds out whether metrics of usual size keep the limit."""
    study = make_study(constraints={"peak": kind | {"metric": "peak", side: limit}})
    backend = FunctionBackend(
        study, lambda gain, load, seed: {"error": (gain - 0.3) ** 2 + load, "peak": gain + 0.1}
    )
    algorithm = METHODS["boundary"]
    tuning = Tuning(study, Driver(backend), algorithm)
    trials = list(tuning)
    assert len(trials) == study.budget.trials
    found = conclude(study, Driver(backend), algorithm, tuning.trials)
    keeps = limit == MOST if side == "upper" else limit < MOST
    assert found is not None
    assert found.recommendation.feasible == keeps
