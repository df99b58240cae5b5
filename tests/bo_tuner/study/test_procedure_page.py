"""The recipes of docs/procedure.md are sections of a study that is read without complaint."""

import re
from pathlib import Path

import pytest
import yaml
from signal_runs import signal_study

from bo_tuner.study.study_file import study_from_mapping, study_to_mapping

PAGE = Path(__file__).parents[3] / "docs" / "procedure.md"
BLOCKS = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
PID = {"node": "pid"}
STUDY = signal_study(
    nodes={"pid": PID},
    parameters={
        "kp": PID | {"type": "double", "bounds": [0, 9], "default": 0.5},
        "ki": PID | {"type": "double", "bounds": [0, 9], "default": 0.5},
    },
    signals={
        **signal_study()["signals"],
        "speed": {"topic": "/joint_states", "field": "velocity[motor]"},
        "temperature": {"topic": "/motor/temperature", "field": "temperature"},
    },
    budget={"trials": 4, "initial_trials": 2},
)


@pytest.mark.parametrize("block", BLOCKS)
def test_a_recipe(block):
    sections = yaml.safe_load(block)
    metrics = STUDY["metrics"] | sections.pop("metrics", {})
    study = study_from_mapping(STUDY | sections | {"metrics": metrics})
    read = study_to_mapping(study)
    assert {"metrics", *sections} <= read.keys()
    assert read["metrics"].keys() == metrics.keys()


@pytest.mark.parametrize(
    "title",
    [
        "PID position control",
        "An estimator with noise parameters",
        "A node behind an action",
        "A lifecycle node",
    ],
)
def test_a_recipe_that_users_look_for(title):
    """Under its title comes a study's section before the next title."""
    _, found, text = PAGE.read_text(encoding="utf-8").partition(f"**{title}")
    assert found
    assert "```yaml" in text.split("\n**")[0]


NAMED = ("nodes", "parameters", "contexts", "signals", "metrics")
"""Sections of parts by name, to which a recipe adds its own."""


@pytest.mark.parametrize(
    "page", sorted((PAGE.parent / "recipes").glob("*.md")), ids=lambda p: p.stem
)
def test_a_page_with_a_recipe(page):
    blocks = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    others = {name: {"topic": f"/{name}", "field": "data"} for name in ("x", "z", "roll")}
    base = STUDY | {"signals": others | STUDY["signals"]}
    assert blocks or page.stem == "zenoh"
    for block in blocks:
        sections = yaml.safe_load(block)
        named = {key: base.get(key, {}) | sections[key] for key in NAMED if key in sections}
        study = study_from_mapping(base | sections | named)
        assert sections.keys() <= study_to_mapping(study).keys()
