"""Objects of this process that end a run once its outcome is decided."""

import dataclasses
import math
import sys

import pytest
from cut_short_runs import GROWS, short_study
from functions import NODE, planned

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.errors import JournalError, StudyError
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.trials import EvaluationState

OBJECTS = """\
class Axis:
    answer = {}

    def set_parameters(self, values):
        self.values = dict(values)

    def end_beyond(self, values):
        self.bounds = dict(values)

    def evaluate(self):
        peak = self.values["gain"] * 2.0
        if peak > self.bounds.get("top", peak):
            return {
                "status": "cut short", "after": 1.25, "error": 0.5, "top": peak, **self.answer
            }
        return {"status": "ok", "reason": "", "error": 1.0, "top": peak}


class Lying(Axis):
    answer = {"top": 0.1}


class Timeless(Axis):
    answer = {"after": "soon"}


class Silent(Axis):
    answer = {"error": None}


class Whole:
    set_parameters, evaluate = Axis.set_parameters, Axis.evaluate
"""

METRICS = {"error": GROWS, "peak": GROWS | {"key": "top", "unit": "mm"}}


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """Function that opens a backend on one of the classes above."""
    (tmp_path / "axis_objects.py").write_text(OBJECTS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "axis_objects", raising=False)

    def make(name="Axis", **sections):
        node = NODE | {"result": "~/cut_result", "object": f"axis_objects:{name}"}
        backend = InProcessBackend(
            short_study(**({"nodes": {"axis": node}, "metrics": METRICS} | sections))
        )
        backend.open()
        return backend

    return make


def run(backend, gain=0.9, **beyond):
    return backend.outcome(
        dataclasses.replace(planned({"gain": gain}, {"load": 1.5}), beyond=beyond)
    )


def test_what_is_known_is_a_lower_bound_of_each_metric(opened):
    outcome = run(opened(), peak=1.2)
    assert outcome.state is EvaluationState.CUT_SHORT
    assert outcome.reason == "cut short after 1.25 s: peak at least 1.8 mm"
    assert outcome.notes.at_least == {"error": 0.5, "peak": 1.8}
    assert outcome.metrics == {}
    assert not outcome.unusable


def test_without_a_bound_or_below_it_a_run_is_whole(opened):
    backend = opened()
    assert run(backend).metrics == {"error": 1.0, "peak": 1.8}
    assert run(backend, gain=0.5, peak=1.2).metrics == {"error": 1.0, "peak": 1.0}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Lying", "ended early after 1.25 s, but no metric was beyond its bound"),
        ("Timeless", "axis: the time after which it was cut short is soon"),
        ("Silent", "metric error is None"),
    ],
)
def test_an_object_that_does_not_say_why_fails(opened, name, reason):
    outcome = run(opened(name), peak=1.2)
    assert outcome.state is EvaluationState.FAILED
    assert outcome.reason == reason


def test_an_object_that_cannot_end_a_run_is_refused(opened):
    with pytest.raises(StudyError, match="cannot end a run early, which `budget"):
        opened("Whole")
    assert run(opened("Axis")).complete


def test_metrics_of_other_nodes_do_not_end_a_run(opened):
    nodes = {
        key: {"node": key, "result": "~/result", "object": "axis_objects:Axis"}
        for key in ("axis", "sensor")
    }
    metrics = {name: {"node": "sensor", "grows": True} for name in ("error", "peak")}
    with pytest.raises(StudyError, match="axis, which performs a run, reports none of peak, error"):
        opened(nodes=nodes, metrics=metrics)


def test_the_journal_has_it(opened, tmp_path):
    backend = opened()
    evaluation = dataclasses.replace(
        planned({"gain": 0.9}, {"load": 1.5}), outcome=run(backend, peak=1.2)
    )
    with Journal(tmp_path / "journal.sqlite", {}) as journal:
        journal.record_evaluation(evaluation)
    (read,) = read_journal(tmp_path / "journal.sqlite").evaluations
    assert read == evaluation
    assert read.outcome.notes.at_least == {"error": 0.5, "peak": 1.8}


@pytest.mark.parametrize("value", [math.nan, math.inf, "much"])
def test_a_record_with_a_bound_that_is_none_is_refused(opened, tmp_path, value):
    outcome = run(opened(), peak=1.2).noted(at_least={"peak": value})
    evaluation = dataclasses.replace(planned({"gain": 0.9}, {"load": 1.5}), outcome=outcome)
    with Journal(tmp_path / "journal.sqlite", {}) as journal:
        journal.record_evaluation(evaluation)
    with pytest.raises(JournalError, match=r"notes\.at_least\.peak: expected a number, found"):
        read_journal(tmp_path / "journal.sqlite")
