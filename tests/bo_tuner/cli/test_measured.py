"""`tune` and `validate` of a study in a wind that is measured: from the runs to the verdict."""

import json
import re

import pytest
from functions import NODE
from in_process import call, complaint
from report_runs import axis_study

from bo_tuner.cli import tune, validate
from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_from_mapping, study_to_yaml

OBJECT = """\
import numpy as np


class Windy:
    def set_parameters(self, values):
        self.values = {"gain": 0.5, "load": 1.0, "seed": 0} | values

    def evaluate(self):
        gain, load = self.values["gain"], self.values["load"]
        wind = 0.2 + 2.9 * np.random.default_rng(self.values["seed"]).random()
        error = 1.0 + (gain - 0.3) ** 2 + 0.2 * wind**2
        peak = 0.3 * gain * load + 0.1 * wind
        return {"status": "ok", "error": error, "peak": peak, "gust": wind}
"""
CLAIM = re.compile(
    r"gust was between ([\d.]+) and ([\d.]+) m/s in these runs \(mean ([\d.]+)\); "
    r"nothing is claimed beyond\."
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the study and its object."""
    (tmp_path / "windy_object.py").write_text(OBJECT)
    study = study_from_mapping(
        axis_study(
            nodes={"axis": NODE | {"result": "~/cut_result", "object": "windy_object:Windy"}},
            metrics={"error": NODE, "peak": NODE, "gust": NODE | {"unit": "m/s"}},
            measured=["gust"],
        )
    )
    (tmp_path / "windy.yaml").write_text(study_to_yaml(study))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_from_the_runs_to_the_certificate(folder, capsys):
    code, out, err = call(tune, capsys, "--study", "windy.yaml", "--backend", "inprocess")
    assert code == 0, err
    path = (folder / "runs" / "latest").resolve()
    told = json.loads((path / "summary.json").read_text())["verdict"]["sentences"]
    (by_validation,) = filter(CLAIM.fullmatch, told)
    assert by_validation in " ".join(out.split())
    assert by_validation in (path / "report.html").read_text()
    record = read_run(path)
    assert not any("gust" in e.context for e in record.evaluations)

    code, out, err = call(validate, capsys, path, "--runs", 100)
    assert code in (0, 3), err
    certificate = json.loads(next((path / "certificates").glob("*.json")).read_text())
    seen = certificate["seen"]["gust"]
    assert 0.2 <= seen["low"] < seen["mean"] < seen["high"] <= 3.1
    for constraint in certificate["tuned"]["constraints"]:
        assert all(worst["context"].keys() == {"load"} for worst in constraint["worst"])
    (line,) = CLAIM.finditer(" ".join(out.split()))
    assert list(map(float, line.groups())) == pytest.approx([*seen.values()], rel=0.01)
    assert line.group() in (path / "report.html").read_text()


def test_another_algorithm_is_refused(folder, capsys):
    arguments = ["--study", "windy.yaml", "--backend", "inprocess", "--algorithm", "IV"]
    assert "IV knows nothing of what is measured, and the study measures 'gust'" in complaint(
        tune, capsys, *arguments
    )
