"""Small runs to report on: of the feed axis, and of an object with texts that would do harm."""

import sys
from pathlib import Path

import yaml
from functions import NODE, study_mapping

from bo_tuner.cli import tune
from bo_tuner.interruption import Interruption
from bo_tuner.study.study_file import load_study, study_to_yaml

HARM = "</script><script>window.harmed = 1</script><img src=x onerror='window.harmed = 2'>&\"$x$"
"""In a page of which a part is not escaped, this leaves a mark on `window`."""

OBJECTS = f"""\
class Axis:
    def __init__(self):
        self.values = {{"ends": 2.0, "load": 1.0}}

    def set_parameters(self, values):
        self.values |= values

    def evaluate(self):
        gain, load = self.values["gain"], self.values["load"]
        if gain > self.values["ends"]:
            return {{"status": "failed", "reason": {HARM!r}}}
        error = 1.0 + load * (gain - 0.3) ** 2
        return {{"status": "ok", "error": error, "peak": 2.0 * gain * load}}


class Traced(Axis):
    def trace(self):
        steps = range(5)
        gain = self.values["gain"]
        return {{
            "time": ("s", [0.1 * k for k in steps]),
            "position/reference": ("m", [1.0 for k in steps]),
            "position/actual": ("m", [gain * k for k in steps]),
            "force": ("N", [gain for k in steps]),
        }}


class Untold(Axis):
    def trace(self):
        return {{"force": ("N", [1.0])}}


class Blank(Axis):
    def trace(self):
        return {{"time": ("s", []), "force": ("N", [])}}


class OnlyTime(Axis):
    def trace(self):
        return {{"time": ("s", [0.0, 1.0])}}
"""


def axis_study(**sections):
    """Study of the object, with harmful texts wherever a study takes a text."""
    return study_mapping(
        **{
            "name": "axis",
            "description": HARM,
            "nodes": {"axis": NODE | {"result": "~/cut_result", "object": "report_objects:Traced"}},
            "parameters": {
                "gain": NODE
                | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
                | {"unit": HARM}
            },
            "metrics": {"error": NODE | {"unit": HARM}, "peak": NODE | {"unit": "N"}},
            "budget": {
                "trials": 7,
                "initial_trials": 5,
                "drawn_contexts": 2,
                "search_evaluations": 2,
                "validation_draws": 5,
            },
            "start": None,
        }
        | sections
    )


def with_ends(ends, **node):
    """Sections of a study whose evaluations fail if the gain exceeds `ends`."""
    of_node = NODE | {"result": "~/cut_result", "object": "report_objects:Traced"} | node
    return {"nodes": {"axis": of_node | {"parameters": {"ends": ends}}}}


def feed_axis_study(**budget):
    """The shipped benchmark study with a smaller budget, as text."""
    small = {
        "trials": 7,
        "initial_trials": 5,
        "drawn_contexts": 3,
        "search_evaluations": 3,
        "validation_draws": 6,
    }
    return study_to_yaml(load_study("benchmark").replace(**small | budget))


def sections(analysis):
    """All sections of the chapters of a report, in order."""
    from bo_tuner.report.page import chapters

    return [section for chapter in chapters(analysis) for section in chapter.sections]


def run_axis(folder: Path, **sections) -> Path:
    """Run a study of the object, with changed sections, and return its run folder."""
    return run_study(folder, yaml.safe_dump(axis_study(**sections)))


def run_study(folder: Path, text: str, *options: str) -> Path:
    """Run a study in this process, with further options, and return its run folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report_objects.py").write_text(OBJECTS, encoding="utf-8")
    (folder / "study.yaml").write_text(text, encoding="utf-8")
    arguments = ["--study", folder / "study.yaml", "--output", folder / "runs"]
    # Every folder holds the same objects, so it does not matter which one is found first.
    sys.path.append(str(folder))
    try:
        tune.run([*map(str, arguments), "--backend", "inprocess", *options], Interruption())
    finally:
        sys.path.remove(str(folder))
    return (folder / "runs" / "latest").resolve()
