"""Modules of an example, of which several have the same names."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from bo_tuner.backends.ros.backend import RosBackend
from bo_tuner.study.study_file import parse_study

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


@pytest.fixture
def module_of(monkeypatch):
    """Function that imports a module of an example."""

    def imported(example, name):
        folder = EXAMPLES / example
        monkeypatch.syspath_prepend(folder)
        for path in folder.glob("*.py"):
            known = sys.modules.get(path.stem)
            if known is not None and known.__file__ != str(path):
                monkeypatch.delitem(sys.modules, path.stem)
        return importlib.import_module(name)

    return imported


@pytest.fixture
def backend_of(monkeypatch, tmp_path):
    """Function that opens the study of an example over ROS, as from the root of the repository."""
    opened = []

    def backend(example, *changes, study="study.yaml"):
        monkeypatch.chdir(ROOT)
        # A backend before this one has left its own here; each takes one that is free.
        monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
        text = (EXAMPLES / example / study).read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        made = replace(parse_study(text), folder=str(EXAMPLES / example))
        opened.append(RosBackend(made, tmp_path))
        opened[0].open()
        return opened[0]

    yield backend
    for made in opened:
        made.close()
