"""Screens, numbers and pictures of README and tutorials are made by one script."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MADE = {"axis-origin", "axis-rows", "axis-verdict", "axis-certificate"}
WITH_NODES = {"position-gain", "position-verdict"}


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("screens", ROOT / "docs" / "screens.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_output_of_a_tutorial_is_made_by_the_script(script):
    named = [n for path in script.DOCUMENTS for n in script.names(path.read_text("utf-8"))]
    assert sorted(named) == sorted(MADE | WITH_NODES)
    # A block of output that the script does not make would become old unseen.
    first = script.DOCUMENTS[1].read_text("utf-8")
    outputs = re.findall(r"(.*)\n```text\n", first)
    assert sum("<!-- screen: " in line for line in outputs) == 3


def test_a_screen_takes_the_place_of_the_old_one_and_of_nothing_else(script):
    text = "a\n<!-- screen: x -->\n```text\nold\n```\n\nb\n<!-- screen: y -->\nold\n\nc\n"
    once = script.filled(text, {"x": "new\n", "y": "newer\n"})
    assert once == text.replace("old\n```", "new\n```").replace("old\n\nc", "newer\n\nc")
    assert script.filled(once, {}) == once


def test_the_rows_of_a_run_are_its_heading_its_first_and_its_best(script):
    rows = "heading\n    0  1.0\n    1  2.0\n    2  3.0\n    3  2.5\n    4  0.5   best so far\n"
    assert script.shortened(rows).splitlines() == [
        "heading", "    0  1.0", "    1  2.0", "  ...", "    4  0.5   best so far",
    ]  # fmt: skip


@pytest.mark.slow
def test_the_script_fills_the_first_tutorial(script, tmp_path):
    made = script.axis(tmp_path, "12", tmp_path)
    assert made.keys() == MADE
    assert made["axis-rows"].count("\n") > 4
    assert "test runs" in made["axis-verdict"]
    assert made["axis-certificate"].startswith(("PASS", "FAIL"))
