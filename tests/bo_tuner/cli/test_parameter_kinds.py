"""A run with parameters of all kinds, from the study to report, certificate and replay."""

import csv

import pytest
import yaml
from axis import node, write_study
from commands import run

from bo_tuner.storage.record import read_run

NODE = {"node": "axis"}
MODES = {"slow": 1.0, "fast": 0.0, "wild": 2.0}
PARAMETERS = {
    "gain": NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5},
    "mode": NODE | {"type": "string", "choices": list(MODES), "default": "slow"},
    "smooth": NODE | {"type": "boolean", "default": False},
    "weights[1]": NODE | {"type": "double", "bounds": [0.0, 1.0], "step": 0.25, "default": 1.0},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, make_study):
    folder = tmp_path_factory.mktemp("kinds")
    costs = f"{MODES!r}[self.mode] + (not self.smooth) + self.weights[1]"
    error = f"25 * (self.gain - 0.3) ** 2 + self.load + {costs}"
    nodes = node("kinds_axis")
    nodes["axis"]["parameters"] = {"weights": [0.5, 1.0]}
    seed = {"node": "axis", "parameter": "seed"}
    budget = {"trials": 14, "initial_trials": 6, "drawn_contexts": 2, "search_evaluations": 2}
    study = make_study(
        nodes=nodes,
        parameters=PARAMETERS,
        seed_parameter=seed,
        budget=budget | {"validation_draws": 5},
        start=["default"],
        constraints={
            "peak": {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.5}
        },
        certificate={"draws": 5, "confidence": 0.5},
    )
    write_study(folder, study, error=error, peak="0.2 * self.load")
    code, _, err = run(
        "tune", "--study", "axis.yaml", "--backend", "inprocess", "--quiet", folder=folder
    )
    assert code == 0, err
    return folder


def test_the_search_finds_the_best_choice(folder):
    record = read_run(folder / "runs" / "latest")
    assert record.trials[0].parameters == {
        "gain": 0.5, "mode": "slow", "smooth": False, "weights[1]": 1.0,
    }  # fmt: skip
    best = yaml.safe_load((folder / "runs/latest/best.yaml").read_text())
    values = best["/**/axis"]["ros__parameters"]
    assert (values["mode"], values["smooth"]) == ("fast", True)
    assert values["weights"][0] == 0.5
    assert values["weights"][1] in (0.0, 0.25, 0.5, 0.75, 1.0)


def test_the_other_commands_take_them(folder):
    for command in (
        ["report", "latest"],
        ["validate", "latest", "--runs", "40"],
        ["replay", "latest"],
        ["tune", "--resume", "latest", "--trials", "15", "--quiet"],
    ):
        code, out, err = run(*command, folder=folder)
        assert code == 0, (command, out, err)
    page = (folder / "runs/latest/report.html").read_text()
    assert "Without an axis of numbers: mode, smooth" in page
    with (folder / "runs/latest/trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 15
    assert {row["parameters.mode"] for row in rows} <= set(MODES)


def test_a_later_run_begins_with_the_parameter_file_of_this_one(folder):
    best = read_run(folder / "runs" / "latest").result.parameters
    code, _, err = run(
        *("tune", "--study", "axis.yaml", "--backend", "inprocess", "--quiet"),
        *("--start", "runs/latest/best.yaml", "--trials", "7", "--output", "later"),
        folder=folder,
    )
    assert code in (0, 3), err
    assert read_run(folder / "later" / "latest").trials[1].parameters == best
