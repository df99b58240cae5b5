"""The page of an experiment, from records that are written out here."""

import dataclasses

import pytest
from markdown_tables import columns_of

from tuning_benchmark.experiments.experiment import Cost, Experiment, Row
from tuning_benchmark.pages import page


@pytest.fixture
def campaign(make_case, record, answer):
    """Function that makes a campaign of one case, whose rows all have the same answers."""

    def make(rows, runs=1, **fields):
        case = make_case(rows=rows, runs=runs, **fields)
        done = {f"run/c/{n}/{s}": record(answer()) for n in rows for s in range(1, runs + 1)}
        experiment = Experiment(name="e", judge="valley:Judge", cases={"c": case})
        return page.Campaign(experiment, done, argument="./e.yaml", records="records/e.jsonl")

    return make


PRINTED = {"runs": 10, "objective": 0.25}


def rows_named(names):
    """Rows of which the paper prints something."""
    return {name: Row(name=name, algorithm="IV", published=PRINTED) for name in names}


def test_a_question_begins_with_what_was_found(campaign, record, answer):
    made = campaign(rows_named("ABC"), runs=2)
    kept, broken, better = answer(), answer(), answer()
    broken["truth"] = broken["truth"] | {"feasible": False}
    better["truth"] = better["truth"] | {"objective": 0.5 * kept["truth"]["objective"]}
    answers = {"A": [kept, kept], "B": [better, better], "C": [kept, broken]}
    for name, two in answers.items():
        made.done.update({f"run/c/{name}/{seed + 1}": record(two[seed]) for seed in (0, 1)})
    best, common = better["truth"]["objective"], kept["truth"]["objective"]
    assert page.sections(made)[0].text.splitlines()[0] == (
        f"B, 2 of 2 answers truly feasible, mean objective {best:.4g}; next A, 2 of 2 answers "
        f"truly feasible, mean objective {common:.4g}; fewest feasible: C, 1 of 2."
    )


def test_a_question_has_one_table_and_its_origin(campaign):
    (section,) = page.sections(campaign(rows_named("AB"), runs=2))
    assert sum(line.startswith("| ---") for line in section.text.splitlines()) == 1
    assert section.text.splitlines()[-1] == (
        "*`benchmark --experiment ./e.yaml`, commit c0ffee, seeds 1 to 2, m, 2026-01-01, "
        "[records](records/e.jsonl).*"
    )


@pytest.mark.parametrize(("names", "drawn"), [("A", 0), ("AB", 1), ("ABCDE", 1), ("ABCDEF", 0)])
def test_a_figure_compares_as_many_rows_as_can_be_told_apart(campaign, names, drawn):
    (section,) = page.sections(campaign(rows_named(names)))
    assert len(section.figures) == section.text.count("![") == drawn


def test_cases_that_the_paper_does_not_have_are_in_one_table(campaign):
    rows = {
        "A": Row(name="A", algorithm="IV"),
        "drawn": Row(name="drawn", optimizer="valley:Draws", protocol="random", contexts=3),
        "lent": Row(name="lent", optimizer="valley:Draws"),
    }
    made = campaign(rows, remarks="So it is.")
    case = made.experiment.cases["c"]
    twice = dataclasses.replace(made.experiment, cases={"c": case, "d": case})
    (section,) = page.sections(dataclasses.replace(made, experiment=twice))
    lines = section.text.splitlines()
    assert sum(line.startswith("| ---") for line in lines) == 1
    assert sum(line.startswith(f"| {case.title} |") for line in lines) == 2
    assert section.text.count("\n\nSo it is.\n\n") == 1
    assert "*Random*: each trial is evaluated in 3 newly drawn contexts" in section.text
    assert "*Worst case*: the trial is evaluated as in Algorithm IV" in section.text
    assert section.figures == ()


def test_what_the_paper_says_is_beside_what_came_out(campaign):
    (section,) = page.sections(campaign(rows_named("A")))
    table = "\n".join(line for line in section.text.splitlines() if line.startswith("|"))
    cells = columns_of(table)
    assert cells["validated objective, paper"] == "0.25"
    assert cells["validated objective, here"] == "1.0000"


def test_every_task_that_failed_is_listed_once(campaign, record):
    made = campaign(rows_named("A"), runs=2)
    failed = record(None) | {"failed": "ValueError: odd", "result": None}
    names = ["run/c/A/2", "cost/2/1"]
    made.done.update(dict.fromkeys(names, failed))
    experiment = dataclasses.replace(made.experiment, cost=Cost(dimensions=(2,), seeds=1))
    made = dataclasses.replace(made, experiment=experiment)
    text = page.markdown(page.sections(made), [made], "Results", "Introduction.")
    for name in names:
        assert text.count(f"- {name}: ValueError: odd") == 1


def test_the_tables_have_the_choice_of_our_rule_among_the_trials_of_others(campaign, answer):
    made = campaign({"lent": Row(name="lent", optimizer="valley:Draws")})
    made.done["run/c/lent/1"]["result"]["ranked"] = {"trial": 1, "truth": answer()["truth"]}
    text = page.numbers(made.experiment, made.done)
    assert "Algorithm IV's choice, truly feasible" in text
