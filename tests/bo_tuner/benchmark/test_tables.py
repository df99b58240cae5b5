"""Tables and sentences from records that are written out here, so that each number is known."""

import pytest

from bo_tuner.benchmark import tables
from bo_tuner.benchmark.experiment import Experiment
from bo_tuner.benchmark.experiment_parts import Cost, Point, Row
from bo_tuner.benchmark.findings import beside_others, beside_the_paper
from bo_tuner.benchmark.summary import feasible_at, summarise


def rows_of(table):
    """Cells of a Markdown table by row, without the header."""
    lines = [line.strip("|").split("|") for line in table.splitlines()[2:]]
    return [[cell.strip() for cell in line] for line in lines]


def columns_of(table, row=0):
    header = [cell.strip() for cell in table.splitlines()[0].strip("|").split("|")]
    return dict(zip(header, rows_of(table)[row], strict=True))


@pytest.fixture
def summaries(make_case, answer, record):
    def make(**rows):
        """Summaries of a case's rows, given by the answers of their runs."""
        case = make_case(
            rows={n: Row(name=n, algorithm="IV") for n in rows}, runs=len(next(iter(rows.values())))
        )
        done = {
            f"run/c/{name}/{seed}": record(found)
            for name, answers in rows.items()
            for seed, found in enumerate(answers, start=1)
        }
        return case, [summarise(case, row, done, optimum=0.5) for row in case.rows.values()]

    return make


def test_a_row_counts_and_averages_its_runs(summaries, answer):
    good, bad = answer(0.6, 0.4), answer(1.0, 0.9, feasible=False, held=False, narrow=True)
    case, found = summaries(A=[good, bad, None])
    cells = columns_of(tables.comparison_table(case, found))
    assert cells["row"] == "A"
    assert cells["held in validation"].startswith("1 of 3")
    assert cells["truly feasible"].startswith("1 of 3")
    assert cells["validated objective"].startswith("0.8000")
    assert cells["validated - training"].startswith("-0.1000")
    assert cells["true objective of feasible answers"] == "0.6000"
    assert cells["above the optimum [%]"] == "20.0"
    assert cells["worst case"].startswith("0.6500")
    assert cells["narrow"] == "1 of 2"
    assert cells["cuts (trials + checks)"] == "100 + 20"


def test_a_row_without_answers_has_no_numbers(summaries):
    case, found = summaries(A=[None, None])
    cells = columns_of(tables.comparison_table(case, found))
    assert cells["truly feasible"].startswith("0 of 2")
    assert cells["validated objective"] == cells["worst case"] == "none"


def test_a_failed_run_counts_as_infeasible_and_keeps_its_reason(make_case, answer, record):
    case = make_case()
    failed = record(None) | {"failed": "ValueError: odd", "result": None}
    done = {"run/c/A/1": record(answer()), "run/c/A/2": failed}
    found = summarise(case, case.rows["A"], done, None)
    assert (found.feasible.count, found.feasible.runs) == (1, 2)
    assert found.failures == ("ValueError: odd",)
    assert found.distance is None


def test_an_answer_believed_infeasible_does_not_hold(make_case, answer, record):
    case = make_case(runs=1)
    done = {"run/c/A/1": record(answer() | {"believed": False})}
    assert summarise(case, case.rows["A"], done, None).validated.count == 0


def test_incumbents_are_those_of_the_time(make_case, answer, record):
    case = make_case(runs=2)
    incumbents = {
        "3": {"objective": 2.0, "feasible": True},
        "7": {"objective": 1.0, "feasible": False},
        "9": {"objective": 1.5, "feasible": True},
    }
    way = [(10, None), (20, 3), (50, 7), (100, 9)]
    done = {f"run/c/A/{s}": record(answer(), way, incumbents) for s in (1, 2)}
    found = summarise(case, case.rows["A"], done, None)
    values = {cuts: feasible_at(found.results, cuts) for cuts in (5, 19, 20, 49, 50, 100)}
    assert values == {5: [], 19: [], 20: [2.0] * 2, 49: [2.0] * 2, 50: [], 100: [1.5] * 2}
    cells = columns_of(tables.convergence_table(case, [found]))
    assert cells["after 25 cuts"] == "2 of 2: 2.0000"
    assert cells["after 50 cuts"] == "0 of 2"


def published(make_case, record, answer, numbers, objectives):
    """Summaries of rows with published numbers, and the objectives of their runs here."""
    rows = {n: Row(name=n, algorithm="IV", published=numbers[n]) for n in numbers}
    runs = len(next(iter(objectives.values())))
    case = make_case(rows=rows, runs=runs)
    done = {
        f"run/c/{name}/{seed}": record(answer(E, training=E - 0.04 + 0.001 * (-1) ** seed))
        for name, values in objectives.items()
        for seed, E in enumerate(values, start=1)
    }
    return [summarise(case, row, done, None) for row in rows.values()]


def test_the_papers_numbers_stand_beside_ours(make_case, record, answer):
    numbers = {"A": {"feasible": 0.5, "objective": 0.147}, "B": {"difference": 0.002}}
    found = published(make_case, record, answer, numbers, {"A": [1.0, 1.2], "B": [2.0, 2.2]})
    table = tables.published_table(found)
    cells = rows_of(table)
    assert cells[0][:4] == ["A", "50%", "2 of 2 (16% to 100%)", "0.147"]
    assert cells[1][0] == "B"
    assert "0.002" in cells[1]
    assert tables.published_table([]) == ""


def test_agreement_with_the_paper_is_said_with_its_reason(make_case, record, answer):
    numbers = {
        "A": {"feasible": 0.5, "objective": 0.2, "difference": 0.04},
        "B": {"feasible": 1.0, "objective": 0.1, "difference": -0.01},
    }
    ours = {"A": [1.0, 1.01, 0.99] * 4, "B": [2.0, 2.01, 1.99] * 4}
    said = beside_the_paper(published(make_case, record, answer, numbers, ours))
    # 12 of 12 leaves 74 % to 100 %.
    assert said[0].startswith("Differs: answers of A held in the validation in 50% of the paper's")
    assert said[1].startswith("Agrees in sign: the validation of A differs from its")
    assert said[2].startswith("Agrees: answers of B")
    assert said[3].startswith("Differs: the validation of B")
    assert said[4].startswith("Differs: the validated objective of A less that of B is +0.100")
    ours["B"] = ours["A"]
    said = beside_the_paper(published(make_case, record, answer, numbers, ours))
    assert said[-1].startswith("Undecided")


def test_a_gap_of_either_sign_is_no_agreement(make_case, record, answer):
    """Objectives of two plants have no common scale: a gap near the paper's says nothing."""
    row = Row(name="A", algorithm="IV", published={"difference": 0.02})
    case = make_case(rows={"A": row}, runs=4)
    answers = [answer(1.0, training=1.0 + gap) for gap in (-0.04, 0.03, 0.02, -0.03)]
    done = {f"run/c/A/{s}": record(found) for s, found in enumerate(answers, start=1)}
    (said,) = beside_the_paper([summarise(case, row, done, None)])
    assert said.startswith("Undecided: the validation of A differs from its training by +0.02")


def test_a_peer_that_wins_is_said_to_win(make_case, record, answer):
    rows = {
        "ours": Row(name="ours", algorithm="IV"),
        "peer": Row(name="peer", optimizer="valley:Draws", protocol="random", contexts=3),
        "worse": Row(name="worse", optimizer="valley:Draws"),
    }
    case = make_case(rows=rows, runs=4)
    objectives = {
        "ours": [1.0, 1.01, 0.99, 1.0],
        "peer": [0.9, 0.91, 0.89, 0.9],
        "worse": [1.2, 1.21, 1.19, None],
    }
    done = {
        f"run/c/{name}/{seed}": record(None if E is None else answer(E))
        for name, values in objectives.items()
        for seed, E in enumerate(values, start=1)
    }
    found = [summarise(case, row, done, None) for row in rows.values()]
    reference, peer, worse, *best = beside_others(case, found)
    assert "The reference is ours: 4 of 4" in reference
    assert "as many feasible answers" in peer
    assert "**a better objective among feasible ones by -0.1000" in peer
    assert "fewer feasible answers than the reference; a worse objective" in worse
    assert [text.split(":")[0] for text in best] == [
        "The best with random contexts is peer",
        "The best with the worst-case search lent to it is worse",
    ]
    assert beside_others(case, found[:1]) == []


def test_each_neighbour_has_its_verdict(make_case, record, answer, study):
    points = {"default": Point(parameters={"g0": 0.5, "g1": 0.5}, published={"objective": 0.2})}
    case = make_case(rows={"A": Row(name="A", algorithm="IV")}, runs=2, points=points)
    experiment = Experiment(name="e", judge="valley:Judge", cases={"c": case})
    best = answer(1.0, narrow=True)
    best["neighbours"][0]["truth"] = {"objective": 1.1, "worst": 0.9, "feasible": False}
    point = {"failed": "", "result": answer(3.0, worst=0.9, feasible=False)}
    done = {
        "run/c/A/1": record(best),
        "run/c/A/2": record(answer(2.0)),
        "point/c/default": point,
    }
    found = [summarise(case, row, done, None) for row in case.rows.values()]
    lines = rows_of(tables.neighbourhood_table(experiment, case, found, done))
    assert lines[0] == ["**best of A**", "0.5", "0.25", "1.0000", "0.5000", "yes", "narrow", ""]
    assert lines[1][5:] == ["no", "objective +10%, limit exceeded by 20%: not tolerable", ""]
    assert lines[2][0] == "**default**"
    assert lines[2][-2:] == ["infeasible", "0.2"]


def test_costs_are_grouped_by_parameters_and_trials(make_case):
    cost = Cost(dimensions=(2, 4), trials=(50, 100), compared_trials=100, seeds=2)
    experiment = Experiment(name="e", judge="valley:Judge", cases={"c": make_case()}, cost=cost)
    done = {
        f"cost/{d}/{s}": {"result": {"trials": t, "seconds": [1.0 * d * s * k for k in t]}}
        for d, t in ((2, [50, 100]), (4, [100]))
        for s in (1, 2)
    }
    assert tables.costs(experiment, done) == {
        (2, 50): [100.0, 200.0], (2, 100): [200.0, 400.0], (4, 100): [400.0, 800.0]
    }  # fmt: skip
    assert [line[:2] for line in rows_of(tables.cost_table(experiment, done))] == [
        ["2", "50"], ["2", "100"], ["4", "100"]
    ]  # fmt: skip
