"""A study of a function, and the function."""

import pytest

import bo_tuner as bt


def response(parameters, context, seed):
    """Error and peak of the axis of report_runs."""
    gain, load = parameters["gain"], context["load"]
    return {"error": 1.0 + load * (gain - 0.3) ** 2, "peak": 2.0 * gain * load}


@pytest.fixture
def function():
    return response


@pytest.fixture
def make_function_study():
    """Makes a study of the function; sections as of `bt.Study`."""

    def make(trials=4, **sections):
        given = {
            "name": "axis",
            "parameters": {"gain": bt.Double(0.0, 1.0, default=0.5)},
            "contexts": {"load": bt.Uniform(bounds=(1.0, 2.0))},
            "metrics": ["error", "peak"],
            "objective": "error",
            "constraints": {"peak": bt.WorstCase("peak", upper=1.0)},
            "budget": bt.Budget(
                trials=trials,
                initial_trials=3,
                drawn_contexts=2,
                search_evaluations=2,
                validation_draws=4,
            ),
        }
        return bt.Study(**given | sections)

    return make
