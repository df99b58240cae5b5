"""Tables from records that are written out here, so that each number is known."""

import numpy as np
import pytest
from markdown_tables import columns_of, rows_of
from scipy import stats

from tuning_benchmark.experiments.experiment import Cost, Point, Row
from tuning_benchmark.experiments.optima import Optimum
from tuning_benchmark.pages import tables
from tuning_benchmark.pages.summary import feasible_at, summarize


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
        return case, [
            summarize(case, row, done, optimum=Optimum(0.5)) for row in case.rows.values()
        ]

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
    assert cells["evaluations (trials + checks)"] == "100 + 20, at most 120"


def test_regret_is_against_the_best_at_the_same_worst_case(make_case, answer, record):
    case = make_case(runs=4, rows={"A": Row(name="A", algorithm="IV")})
    found = [answer(1.5, 0.5), answer(1.5, 0.25), answer(0.9, 0.75, feasible=False), answer(2, 9)]
    done = {f"run/c/A/{seed}": record(a) for seed, a in enumerate(found, start=1)}
    # Lowest objectives 2, 1.5 and 1 at worst cases 0, 0.5 and 1.
    optimum = Optimum(1.0, (0.0, 1.0), (2.0, 1.0))
    regrets = summarize(case, case.rows["A"], done, optimum).regrets
    assert regrets == {1: pytest.approx(0.0), 2: pytest.approx(100.0 * (1.5 / 1.75 - 1.0))}
    assert summarize(case, case.rows["A"], done, Optimum(1.0)).regrets == {}


@pytest.mark.parametrize(
    ("way", "reached"),
    [
        ([(10, None), (20, 1), (30, 2), (40, 2)], 30),
        ([(10, 2), (20, 1), (30, 2)], 30),
        ([(10, 2), (20, 2)], 10),
        ([(10, 2), (20, None)], np.inf),
        ([(10, 3), (20, 1)], np.inf),
    ],
)
def test_near_is_when_the_incumbent_stays_near(make_case, answer, record, way, reached):
    case = make_case(runs=1, rows={"A": Row(name="A", algorithm="IV")})
    incumbents = {
        "1": {"objective": 1.06, "feasible": True},
        "2": {"objective": 1.04, "feasible": True},
        "3": {"objective": 0.9, "feasible": False},
    }
    done = {"run/c/A/1": record(answer(), way, incumbents)}
    assert summarize(case, case.rows["A"], done, Optimum(1.0)).reached == {1: reached}
    assert summarize(case, case.rows["A"], done, None).reached == {1: np.inf}


def test_rows_are_compared_pair_by_pair(summaries, answer):
    bad = answer(feasible=False)
    case, found = summaries(
        A=[answer(1.0), answer(2.0), answer(3.0), bad, bad],
        B=[answer(1.5), answer(2.3), bad, answer(1.0), bad],
    )
    cells = columns_of(tables.paired_table(case, found))
    assert cells["row less A"] == "B"
    assert cells["feasible only in the row : only in A"] == "1 : 1 (p = 1)"
    interval = stats.ttest_rel([1.5, 2.3], [1.0, 2.0]).confidence_interval()
    assert cells["objective"] == f"+0.4000 ({interval.low:.4f} to {interval.high:.4f})"
    assert cells["regret at equal margin [%]"] == "none"
    assert tables.paired_table(case, found[:1]) == ""


def test_realized_probabilities_are_shown_of_all_answers(make_case, answer, record):
    case = make_case(runs=2, rows={"A": Row(name="A", algorithm="IV")})
    done = {}
    for seed, kept in ((1, 0.9), (2, 0.7)):
        found = answer()
        done[f"run/c/A/{seed}"] = record(found | {"truth": found["truth"] | {"worst_kept": kept}})
    summary = summarize(case, case.rows["A"], done, Optimum(1.0))
    cells = columns_of(tables.fair_table(case, [summary]))
    assert cells["realized probability"] == "0.800, lowest 0.700"
    assert (cells["near"], cells["median evaluations until near"]) == ("0 of 2", "never")
    unknown = summarize(case, case.rows["A"], done, None)
    cells = columns_of(tables.fair_table(case, [unknown]))
    assert (cells["near"], cells["median evaluations until near"]) == ("", "")


def test_the_most_evaluations_are_those_of_one_run(make_case, record, answer):
    case = make_case(rows={"A": Row(name="A", algorithm="IV")})
    done = {f"run/c/A/{seed}": record(answer()) for seed in (1, 2)}
    done["run/c/A/1"]["result"] |= {"cuts": 110, "check_cuts": 0}
    done["run/c/A/2"]["result"] |= {"cuts": 90, "check_cuts": 40}
    found = summarize(case, case.rows["A"], done, None)
    cells = columns_of(tables.comparison_table(case, [found]))
    assert cells["evaluations (trials + checks)"] == "100 + 20, at most 130"


def test_a_row_without_answers_has_no_numbers(summaries):
    case, found = summaries(A=[None, None])
    cells = columns_of(tables.comparison_table(case, found))
    assert cells["truly feasible"].startswith("0 of 2")
    assert cells["validated objective"] == cells["worst case"] == "none"


def test_a_failed_run_counts_as_infeasible(make_case, answer, record):
    case = make_case()
    failed = record(None) | {"failed": "ValueError: odd", "result": None}
    done = {"run/c/A/1": record(answer()), "run/c/A/2": failed}
    found = summarize(case, case.rows["A"], done, None)
    assert (found.feasible.count, found.feasible.runs) == (1, 2)
    assert found.distance is None


def test_an_answer_believed_infeasible_does_not_hold(make_case, answer, record):
    case = make_case(runs=1)
    done = {"run/c/A/1": record(answer() | {"believed": False})}
    assert summarize(case, case.rows["A"], done, None).validated.count == 0


def test_incumbents_are_those_of_the_time(make_case, answer, record):
    case = make_case(runs=2)
    incumbents = {
        "3": {"objective": 2.0, "feasible": True},
        "7": {"objective": 1.0, "feasible": False},
        "9": {"objective": 1.5, "feasible": True},
    }
    way = [(10, None), (20, 3), (50, 7), (100, 9)]
    done = {f"run/c/A/{s}": record(answer(), way, incumbents) for s in (1, 2)}
    found = summarize(case, case.rows["A"], done, None)
    values = {
        evaluations: feasible_at(found.results.values(), evaluations)
        for evaluations in (5, 19, 20, 49, 50, 100)
    }
    assert values == {5: [], 19: [], 20: [2.0] * 2, 49: [2.0] * 2, 50: [], 100: [1.5] * 2}
    cells = columns_of(tables.convergence_table(case, [found]))
    assert cells["after 25 evaluations"] == "2 of 2: 2.0000"
    assert cells["after 50 evaluations"] == "0 of 2"
    assert cells["answer"] == "2 of 2: 1.0000"


def test_a_median_stands_beside_a_mean_that_an_outlier_moved(summaries, answer):
    good = [answer(E) for E in (1.0, 1.1, 1.2)]
    skewed, even = [*good, answer(10.0)], [*good, answer(9.0, feasible=False)]
    case, found = summaries(skewed=skewed, even=even, none=[None] * 4)
    shown = {line[0]: line[-1] for line in rows_of(tables.convergence_table(case, found))}
    assert shown == {
        "skewed": "4 of 4: 3.3250 (median 1.1500)", "even": "3 of 4: 1.1000", "none": "0 of 4"
    }  # fmt: skip


def test_what_the_rule_of_algorithm_iv_chooses_stands_beside_the_own_choice(
    make_case, record, answer
):
    rows = {name: Row(name=name, optimizer="valley:Draws") for name in ("peer", "old")}
    case = make_case(rows=rows)
    done = {f"run/c/{name}/{seed}": record(answer(2.0)) for name in rows for seed in (1, 2)}
    found = [summarize(case, row, done, None) for row in rows.values()]
    assert tables.ranked_table(case, found) == ""
    truth = {"objective": 1.5, "feasible": True}
    done["run/c/peer/1"]["result"]["ranked"] = {"trial": 3, "truth": truth}
    done["run/c/peer/2"]["result"]["ranked"] = None
    assert rows_of(tables.ranked_table(case, found)) == [
        ["peer", "1 of 2: 1.5000", "2 of 2: 2.0000"]
    ]


def test_each_neighbour_has_its_verdict(make_case, record, answer):
    tuned = {"g0": 0.5, "g1": 0.5}
    points = {
        "default": Point(parameters=tuned, published={"objective": 0.2}),
        "listed": Point(parameters=tuned, neighbours=True),
        "old": Point(parameters=tuned),
    }
    case = make_case(rows={"A": Row(name="A", algorithm="IV")}, runs=1, points=points)
    best = answer(1.0, narrow=True)
    best["neighbours"][0]["truth"] = {"objective": 1.1, "worst": 0.9, "feasible": False}
    judged = {
        "default": answer(3.0, worst=0.9, feasible=False),
        "listed": answer(3.0),
        "old": answer(3.0) | {"neighbours": []},
    }
    done = {f"point/c/{name}": {"failed": "", "result": found} for name, found in judged.items()}
    done["run/c/A/1"] = record(best)
    found = [summarize(case, row, done, None) for row in case.rows.values()]
    lines = rows_of(tables.neighbourhood_table(case, found, done))
    assert lines[0] == ["**best of A**", "0.5", "0.25", "1.0000", "0.5000", "yes", "narrow", ""]
    assert lines[1][5:] == ["no", "objective +10%, limit exceeded by 20%: not tolerable", ""]
    assert [(line[0], *line[-2:]) for line in lines[2:]] == [
        ("**default**", "infeasible", "0.2"),
        ("**listed**", "robust", ""),
        ("", "objective +0%", ""),
        ("**old**", "", ""),
    ]


def test_the_best_of_a_row_is_the_best_that_its_user_knows(make_case, record, answer):
    """The truth is not at hand, and an answer that did not hold is not taken."""
    case = make_case(rows={"A": Row(name="A", algorithm="IV")}, runs=3)
    answers = [answer(2.0), answer(1.5, feasible=False), answer(1.0, held=False)]
    answers[0]["truth"]["objective"] = 0.5
    done = {f"run/c/A/{seed}": record(found) for seed, found in enumerate(answers, start=1)}
    found = [summarize(case, row, done, None) for row in case.rows.values()]
    (line, _) = rows_of(tables.neighbourhood_table(case, found, done))
    assert (line[0], line[3], line[-2]) == ("**best of A**", "1.5000", "infeasible")


def test_costs_are_grouped_by_parameters_and_trials():
    cost = Cost(dimensions=(2, 4), trials=(50, 100), compared_trials=100, seeds=2)
    done = {
        f"cost/{d}/{s}": {"result": {"trials": t, "seconds": [1.0 * d * s * k for k in t]}}
        for d, t in ((2, [50, 100]), (4, [100]))
        for s in (1, 2)
    }
    assert tables.costs(cost, done) == {
        (2, 50): {1: 100.0, 2: 200.0},
        (2, 100): {1: 200.0, 2: 400.0},
        (4, 100): {1: 400.0, 2: 800.0},
    }
    assert [line[:2] for line in rows_of(tables.cost_table(cost, done))] == [
        ["2", "50"], ["2", "100"], ["4", "100"]
    ]  # fmt: skip
