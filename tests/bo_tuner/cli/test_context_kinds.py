"""A run whose contexts are of all kinds, from the study to report, certificate and replay."""

import csv
import json

import pytest
from axis import node, write_study
from commands import run

from bo_tuner.storage.record import read_run

NODE = {"node": "axis"}
CONTEXTS = {
    "load": NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]},
    "payload": NODE | {"type": "integer", "distribution": "uniform", "bounds": [0, 4]},
    "brake": NODE | {"distribution": "discrete", "values": [False, True]},
    "room": NODE | {"distribution": "discrete", "values": ["office", "yard", "garage"]},
}
# The worst room is neither at the beginning nor at the end of the list.
PEAK = "0.3 * (self.room == 'yard') + 0.1 * self.brake + 0.05 * self.payload + 0.3 * self.gain"


@pytest.fixture(scope="module")
def folder(tmp_path_factory, make_study):
    folder = tmp_path_factory.mktemp("context_kinds")
    budget = {"trials": 12, "initial_trials": 5, "drawn_contexts": 2, "search_evaluations": 4}
    study = make_study(
        nodes=node("context_kinds_axis"),
        contexts=CONTEXTS,
        start=["default"],
        budget=budget | {"validation_draws": 5},
        # Kept where the gain is at most 0.3, in the worst context.
        constraints={"peak": {"kind": "worst_case", "metric": "peak", "upper": 0.69}},
        certificate={"draws": 10, "confidence": 0.6},
    )
    write_study(folder, study, error="(self.gain - 0.9) ** 2 + 0.1 * self.load", peak=PEAK)
    code, _, err = run(
        "tune", "--study", "axis.yaml", "--backend", "inprocess", "--quiet", folder=folder
    )
    assert code in (0, 3), err
    return folder


def test_the_worst_context_is_found(folder):
    """In the middle of the texts, with the largest integer and the brake on."""
    record = read_run(folder / "runs" / "latest")
    types = {
        name: {type(e.context[name]) for t in record.trials for e in t.evaluations}
        for name in CONTEXTS
    }
    assert types == {"load": {float}, "payload": {int}, "brake": {bool}, "room": {str}}
    worst = record.result.worst_cases["peak"].context
    assert (worst["payload"], worst["brake"], worst["room"]) == (4, True, "yard")
    assert record.result.parameters["gain"] <= 0.35


def test_the_other_commands_take_them(folder):
    for command in (
        ["report", "latest"],
        ["validate", "latest", "--runs", "60"],
        ["replay", "latest"],
        ["tune", "--resume", "latest", "--trials", "13", "--quiet"],
        ["tune", "--from", "latest", "--trials", "14", "--quiet"],
    ):
        code, out, err = run(*command, folder=folder)
        assert code in (0, 3), (command, out, err)
        assert "Traceback" not in err
    with (folder / "runs/latest/evaluations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["context.room"] for row in rows} == {"office", "yard", "garage"}
    assert {row["context.brake"] for row in rows} == {"true", "false"}


def test_the_certificate_evaluates_every_text(folder):
    certificate = next((folder / "runs").glob("**/0001.json"))
    content = json.loads(certificate.read_text())
    worst = content["tuned"]["constraints"][0]["worst"][0]["context"]
    assert (worst["payload"], worst["brake"], worst["room"]) == (4, True, "yard")
    with certificate.with_name("0001_evaluations.csv").open() as file:
        rooms = {json.loads(row["context.room"]) for row in csv.DictReader(file)}
    assert rooms == {"office", "yard", "garage"}


def test_a_study_of_texts_alone(tmp_path, make_study):
    """Has no box, no drift and no line along which anything is drawn."""
    budget = {"trials": 6, "initial_trials": 3, "drawn_contexts": 2, "search_evaluations": 3}
    study = make_study(
        nodes=node("texts_axis"),
        contexts={"room": CONTEXTS["room"]},
        start=["default"],
        budget=budget | {"validation_draws": 5},
        constraints={"peak": {"kind": "worst_case", "metric": "peak", "upper": 0.7}},
    )
    peak = "0.3 * (self.room == 'yard') + 0.3 * self.gain"
    write_study(tmp_path, study, error="(self.gain - 0.3) ** 2 + 1", peak=peak)
    for command in (
        ["tune", "--study", "axis.yaml", "--backend", "inprocess", "--quiet"],
        ["validate", "latest", "--runs", "80"],
        ["report", "latest"],
    ):
        code, out, err = run(*command, folder=tmp_path)
        assert code in (0, 3), (command, out, err)
    record = read_run(tmp_path / "runs" / "latest")
    assert record.result.worst_cases["peak"].context == {"room": "yard"}
