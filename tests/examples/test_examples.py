"""What all examples promise, and how a campaign judges."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
BRIDGES = {
    "quadrotor": ("flight.py", "simulator_node.py", "controller_node.py"),
    "cessna": ("aircraft.py", "aircraft_node.py"),
}


@pytest.mark.parametrize("example", BRIDGES)
def test_the_bridge_knows_nothing_of_the_tuner_and_the_study_is_short(example):
    for name in BRIDGES[example]:
        text = (EXAMPLES / example / name).read_text(encoding="utf-8")
        assert not any(word in text for word in ("tuner", "bo_", "trial", "evaluation"))
    text = (EXAMPLES / example / "study.yaml").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 40


@dataclass(frozen=True)
class Place:
    """Conditions of a system that exists in this test only."""

    wind: float
    seed: int = 0


@dataclass(frozen=True)
class Flight:
    """What became of a flight: metrics and a crash."""

    error: float
    overshoot: float
    effort: float
    crashed: bool


def fly(gains, place):
    """Fly: the wind is the overshoot, the gain times the wind the effort; too much is a crash."""
    effort = gains["k"] * place.wind
    return Flight(1.0 / gains["k"], place.wind + 0.1 * (place.seed % 2), effort, effort > 8.0)


@pytest.fixture
def compare(module_of):
    """Judge of gains in four drawn conditions and a grid of three."""
    campaign = module_of(".", "campaign")
    study = {
        "objective": {"metric": "error"},
        "constraints": {
            "far": {"kind": "worst_case", "metric": "overshoot", "upper": 2.5},
            "busy": {"kind": "chance", "metric": "effort", "upper": 3.0, "probability": 0.5},
        },
    }
    with ThreadPoolExecutor(1) as executor:
        grid, draws = map(Place, (0.0, 2.0, 1.0)), map(Place, (0.0, 1.0, 2.0, 3.0))
        yield campaign.Comparison(fly, list(grid), list(draws), study, executor)


def test_a_campaign_averages_counts_and_looks_for_the_worst(compare):
    found = compare({"k": 2.0})
    assert found["error"] == 0.5
    assert found["effort_within"] == 0.5  # efforts 0, 2, 4, 6
    assert (found["crashes"], found["flights"]) == (0, 7)
    # Five more flights in the worst place: seeds 20 000 to 20 004, two of them odd.
    assert found["worst"]["mean"] == pytest.approx(2.04)
    assert found["worst"]["conditions"]["wind"] == 2.0


def test_a_crash_is_worse_than_any_number_and_is_in_no_mean(compare):
    found = compare({"k": 4.0})  # crashes at a wind of 3
    assert (found["crashes"], found["error"]) == (1, 0.25)
    assert found["worst"]["mean"] == pytest.approx(2.04)
    found = compare({"k": 5.0})  # and at 2, which is on the grid
    assert (found["crashes"], found["worst"]["mean"]) == (3, None)
    assert compare({"k": 5.0})["effort_within"] == 0.25


def test_the_table_names_limits_and_changes(compare, module_of):
    judged = {"default": compare({"k": 2.0}), "tuned": compare({"k": 5.0})}
    header, _, default, tuned = module_of(".", "campaign").table(judged, compare.study).splitlines()
    assert "worst overshoot (limit 2.5)" in header
    assert "effort within 3 (at least 50%)" in header
    assert default == "| default | 0.500 | +0.0% | 2.0 | 50% | 0 of 7 |"
    assert tuned == "| tuned | 0.200 | -60.0% | crash | 25% | 3 of 7 |"
