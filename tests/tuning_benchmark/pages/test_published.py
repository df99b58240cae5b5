"""Published records: the same page and tables from less."""

import json

import pytest

from tuning_benchmark.experiments.experiment import Experiment, Point, Row
from tuning_benchmark.pages import page
from tuning_benchmark.pages.published import publish, reduced


@pytest.fixture(params=[False, True], ids=["answers", "points"])
def experiment(request, make_case):
    rows = {"A": Row(name="A", algorithm="IV"), "B": Row(name="B", optimizer="valley:Draws")}
    points = {"p": Point(parameters={"g0": 0.5, "g1": 0.5}, neighbours=True)}
    case = make_case(rows=rows, points=points if request.param else {})
    return Experiment(name="e", judge="valley:Judge", cases={"c": case})


@pytest.fixture
def done(experiment, record, answer):
    """Records of all tasks: two answers, none, and a run that failed."""
    found = answer(narrow=True)
    found["truth"] = found["truth"] | {"worst_kept": 0.9, "worst_context": {"w1": 0.25}}
    whole = record(found, [[20, 1]], {"1": found["truth"] | {"single_violation": 0.1}})
    whole["result"]["ranked"] = {"trial": 1, "truth": found["truth"]}
    failed = record(None) | {"failed": "ValueError: odd", "result": None}
    records = {
        "run/c/A/1": whole,
        "run/c/B/1": whole,
        "run/c/A/2": record(None),
        "run/c/B/2": failed,
    }
    if experiment.cases["c"].points:
        records["point/c/p"] = record(None) | {"result": found}
    return {name: {"task": name, "version": "1"} | item for name, item in records.items()}


def shown(experiment, done):
    campaign = page.Campaign(experiment, done)
    text = page.markdown(page.sections(campaign), [campaign], "", "")
    return text, page.numbers(experiment, done)


def test_published_records_make_the_same_page_and_tables(experiment, done, tmp_path):
    path = publish(experiment, done, tmp_path / "new" / "e.jsonl")
    published = {line["task"]: line for line in map(json.loads, path.read_text().splitlines())}
    assert shown(experiment, published) == shown(experiment, done)
    assert len(json.dumps(published)) < len(json.dumps(done))


def test_what_is_published_stays_as_it_is_when_it_is_published_again(experiment, done):
    once = reduced(experiment, done)
    assert reduced(experiment, once) == once


def test_the_worst_context_of_an_answer_is_published(experiment, done):
    truth = reduced(experiment, done)["run/c/A/1"]["result"]["answer"]["truth"]
    assert truth["worst_context"] == {"w1": 0.25}
