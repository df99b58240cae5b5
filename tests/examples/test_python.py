"""The examples from Python run, and their results hold by the functions themselves."""

import re
import runpy
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from waiting import wait_until

import bo_tuner as bt
from bo_tuner.storage.journal_reader import read_journal

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


def test_ask_and_tell_goes_on_after_it_was_stopped(tmp_path):
    command = [sys.executable, EXAMPLES / "ask_and_tell.py", tmp_path / "run"]
    journal = tmp_path / "run" / "journal.sqlite"

    def on_record():
        return len(read_journal(journal).evaluations) if journal.exists() else 0

    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as stopped:
        wait_until(lambda: on_record() > 3, "some runs are on record", stopped)
        stopped.send_signal(signal.SIGINT)
    assert stopped.returncode != 0
    before = on_record()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "No limit broken" in done.stdout
    assert on_record() > before


def test_the_document_describes_one_study_in_two_ways(tmp_path):
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    (file,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (code,) = (c for c in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "bt.Study(" in c)
    (tmp_path / "study.yaml").write_text(file, encoding="utf-8")
    names = {"bt": bt}
    exec(code, names)
    assert names["study"] == bt.Study.from_yaml(tmp_path / "study.yaml")
