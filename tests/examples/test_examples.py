"""What all examples promise, and how a campaign judges."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from bo_tuner.study.study_file import load_study

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


FIELD = EXAMPLES / "field"


@pytest.mark.parametrize("study", sorted(FIELD.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_study_of_a_public_controller_is_short(study):
    load_study(str(study))
    assert len(study.read_text(encoding="utf-8").splitlines()) <= 40


def test_where_the_code_of_public_controllers_is_to_be_had(tmp_path):
    """Of each study, by a script that fetches nothing; it runs none without its code."""
    for file in FIELD.glob("*.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    command = [sys.executable, str(tmp_path / "field.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert told.keys() == {path.stem for path in FIELD.glob("*.yaml")}
    assert all("https://github.com/" in where and " at " in where for where in told.values())
    refused = subprocess.run([*command, "ais_pid"], capture_output=True, text=True, check=False)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.startswith("error: code/AIS2105_lab1: a clone of https://github.com/")


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
    comparison = module_of(".", "comparison")
    study = {
        "objective": {"metric": "error"},
        "constraints": {
            "far": {"kind": "worst_case", "metric": "overshoot", "upper": 2.5},
            "busy": {"kind": "chance", "metric": "effort", "upper": 3.0, "probability": 0.5},
        },
    }
    with ThreadPoolExecutor(1) as executor:
        grid, draws = map(Place, (0.0, 2.0, 1.0)), map(Place, (0.0, 1.0, 2.0, 3.0))
        yield comparison.Comparison(fly, list(grid), list(draws), study, executor)


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


def test_the_tables_name_limits_and_changes(compare, module_of):
    comparison = module_of(".", "comparison")
    judged = {
        "default": compare({"k": 2.0}),
        "tuned, seed 1": compare({"k": 2.5}),
        "tuned, seed 2": compare({"k": 5.0}),
    }
    header, _, default, tuned = comparison.table(judged, compare.study).splitlines()
    assert "worst overshoot (limit 2.5)" in header
    assert "effort within 3 (at least 50%)" in header
    assert default == "| default | 0.500 | +0.0% | 2.0 | 50% | 0 of 7 | yes |"
    assert tuned == (
        "| tuned, 2 seeds | 0.300 (0.200 to 0.400) | -40.0% (-60.0% to -20.0%) | crash | 25% "
        "| 3 of 14 | 1 of 2 |"
    )
    runs = [
        {"seed": 1, "evaluations": 200, "certificate": "PASS"},
        {"seed": 2, "evaluations": 210, "certificate": "FAIL"},
    ]
    _, _, first, second = comparison.seeds_table(runs, judged, compare.study).splitlines()
    assert first == "| 1 | 200 | PASS | 0.400 | -20.0% | 2.0 | 50% | 0 of 7 | yes |"
    assert second == "| 2 | 210 | FAIL | 0.200 | -60.0% | crash | 25% | 3 of 7 | no |"


def test_a_rule_is_detuned_with_the_flights_that_it_has(compare, module_of):
    """The error is 1/k, the effort 2k in two of three flights, 3 at most: so k is 1.5 at best."""
    detuning, flown = module_of(".", "detuning"), []
    judge = compare.judge

    def counted(gains, place):
        flown.append(gains["k"])
        return judge(gains, place)

    tested = replace(compare, judge=counted)
    hard = detuning.hardest(compare, {"k": 1.0})
    assert [compare.grid[k].wind for k in hard] == [0.0, 1.0, 2.0]  # the hardest last
    drawn = [Place(2.0), Place(2.0), Place(1.0)]
    limits = (2.0, 20.0)  # k of the rule; one is too much, the other far too much
    for highest in limits:
        flown.clear()
        found = detuning.detune(
            lambda factors, highest=highest: {"k": highest * factors[0]},
            1, tested, hard, drawn, 240, seed=1,
        )  # fmt: skip
        assert len(flown) <= 240
        assert 1.45 <= found["k"] <= 1.5


def test_a_rule_that_never_keeps_the_limits(compare, module_of):
    detune = module_of(".", "detuning").detune
    never = [Place(3.0)] * 3  # an overshoot of 3 whatever the gain
    assert detune(lambda _: {"k": 1.0}, 1, compare, [0], never, 60, seed=1) is None


def test_runs_of_a_campaign_have_different_seeds(module_of, monkeypatch, capsys):
    """By their seeds they are told apart."""
    campaign = module_of(".", "campaign")
    monkeypatch.setattr("sys.argv", ["campaign.py", "quadrotor", "--seeds", "1", "2", "1"])
    monkeypatch.setattr(campaign, "command", lambda *_: pytest.fail("it ran"))
    with pytest.raises(SystemExit) as stop:
        campaign.main()
    assert stop.value.code == 2
    assert capsys.readouterr().err.endswith("error: --seeds: expected different ones\n")
