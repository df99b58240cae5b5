"""The examples from Python run, and their results hold by the functions themselves."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import bo_tuner as bt

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "python"


@pytest.fixture
def module(monkeypatch):
    """Names of an example, without its main part."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return lambda name: runpy.run_path(str(EXAMPLES / f"{name}.py"))


def test_the_position_loop_keeps_its_limit_in_the_corners(module):
    example = module("position_loop")
    study, turn = example["study"], example["turn"]
    best = study.optimize(turn).best
    corners = [
        {"inertia": inertia, "friction": friction}
        for inertia in (0.5, 2.0)
        for friction in (0.5, 1.5)
    ]
    overshoots = [
        [np.mean([turn(values, c, seed)["overshoot"] for seed in range(5)]) for c in corners]
        for values in (study.defaults, best)
    ]
    assert max(overshoots[1]) <= 0.05 < max(overshoots[0])


def test_the_pole_stays_upright(module):
    example = module("reset_and_step")
    best = example["study"].optimize(example["balance"]).best
    largest = [
        example["balance"](best, {"length": length}, seed)["largest"]
        for length in np.linspace(0.3, 1.5, 10)
        for seed in range(10)
    ]
    assert np.mean(np.array(largest) <= 0.3) >= 0.9


def test_the_document_describes_one_study_in_two_ways(tmp_path):
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    (file,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (code,) = (c for c in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "bt.Study(" in c)
    (tmp_path / "study.yaml").write_text(file, encoding="utf-8")
    names = {"bt": bt}
    exec(code, names)
    assert names["study"] == bt.Study.from_yaml(tmp_path / "study.yaml")
