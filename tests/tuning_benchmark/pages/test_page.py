"""The page of an experiment, from records that are written out here."""

import dataclasses

from tuning_benchmark.experiments.experiment import Cost, Experiment, Row
from tuning_benchmark.pages import page


def test_the_page_begins_with_what_was_found(make_case, record, answer):
    rows = {name: Row(name=name, algorithm="IV") for name in "ABC"}
    case = make_case(rows=rows, runs=2)
    kept, broken = answer(), answer()
    broken["truth"] = broken["truth"] | {"feasible": False}
    better = answer()
    better["truth"] = better["truth"] | {"objective": 0.5 * kept["truth"]["objective"]}
    answers = {"A": [kept, kept], "B": [better, better], "C": [kept, broken]}
    done = {
        f"run/c/{name}/{seed}": record(answers[name][seed - 1]) for name in rows for seed in (1, 2)
    }
    experiment = Experiment(name="e", judge="valley:Judge", cases={"c": case})
    text = page.markdown(page.sections(experiment, done), "Results", "Introduction.")
    best, common = better["truth"]["objective"], kept["truth"]["objective"]
    assert text.splitlines()[4] == (
        f"- {case.title}: B, 2 of 2 answers truly feasible, mean objective {best:.4g}; next "
        f"A, 2 of 2 answers truly feasible, mean objective {common:.4g}; fewest feasible: C, "
        "1 of 2."
    )


def test_a_page_tells_protocols_and_marks_remarks(make_case, record, answer):
    rows = {
        "A": Row(name="A", algorithm="IV"),
        "drawn": Row(name="drawn", optimizer="valley:Draws", protocol="random", contexts=3),
        "lent": Row(name="lent", optimizer="valley:Draws"),
    }
    case = make_case(rows=rows, runs=1, remarks="So it is.")
    done = {f"run/c/{name}/1": record(answer()) for name in rows}
    done["run/c/lent/1"]["result"]["ranked"] = {"trial": 1, "truth": answer()["truth"]}

    def text(case):
        experiment = Experiment(name="e", judge="valley:Judge", cases={"c": case})
        return page.sections(experiment, done)[0].text

    whole = text(case)
    assert "*Random*: each trial is evaluated in 3 newly drawn contexts" in whole
    assert "*Worst case*: the trial is evaluated as in Algorithm IV" in whole
    assert "Remarks on the published campaign, written by hand:\n\nSo it is." in whole
    assert "This separates the search from the final" in whole
    alone = text(make_case(rows={"A": rows["A"]}, runs=1))
    for words in ("*Random*", "*Worst case*", "Remarks", "separates"):
        assert words not in alone


def test_every_task_that_failed_is_listed_once(make_case, record, answer):
    case = make_case(rows={"A": Row(name="A", algorithm="IV")}, runs=2)
    failed = record(None) | {"failed": "ValueError: odd", "result": None}
    names = ["run/c/A/2", "cost/2/1"]
    done = {"run/c/A/1": record(answer())} | dict.fromkeys(names, failed)
    experiment = Experiment(name="e", judge="valley:Judge", cases={"c": case})
    experiment = dataclasses.replace(experiment, cost=Cost(dimensions=(2,), seeds=1))
    text = page.markdown(page.sections(experiment, done), "Results", "Introduction.")
    for name in names:
        assert text.count(f"- {name}: ValueError: odd") == 1
