"""Which metrics are those of the plant by themselves."""

from functions import NODE, make_study

METRICS = {
    "error": NODE,
    "peak": NODE,
    "solve_time": NODE | {"reproducible": False},
    "wind": NODE,
    "cost": {"expression": "error + 2 * peak"},
}


def test_no_measured_time_no_surroundings_and_nothing_computed():
    study = make_study(metrics=METRICS, measured=["wind"])
    assert study.of_plant == ["error", "peak"]


def test_a_study_without_any():
    times = {"error": NODE | {"reproducible": False}}
    assert make_study(metrics=times, constraints={}).of_plant == []
