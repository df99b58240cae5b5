"""Tables and sentences from records that are written out here, so that each number is known."""

import numpy as np
import pytest
from scipy import special, stats

from tuning_benchmark.experiments.experiment import Cost, Experiment, Point, Row
from tuning_benchmark.experiments.optima import Optimum
from tuning_benchmark.pages import page, tables
from tuning_benchmark.pages.findings import about_points, beside_others, beside_the_paper
from tuning_benchmark.pages.summary import feasible_at, summarise


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
        return case, [
            summarise(case, row, done, optimum=Optimum(0.5)) for row in case.rows.values()
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
    regrets = summarise(case, case.rows["A"], done, optimum).regrets
    assert regrets == {1: pytest.approx(0.0), 2: pytest.approx(100.0 * (1.5 / 1.75 - 1.0))}
    assert summarise(case, case.rows["A"], done, Optimum(1.0)).regrets == {}


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
    assert summarise(case, case.rows["A"], done, Optimum(1.0)).reached == {1: reached}
    assert summarise(case, case.rows["A"], done, None).reached == {1: np.inf}


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


def test_realised_probabilities_are_shown_of_all_answers(make_case, answer, record):
    case = make_case(runs=2, rows={"A": Row(name="A", algorithm="IV")})
    done = {}
    for seed, kept in ((1, 0.9), (2, 0.7)):
        found = answer()
        done[f"run/c/A/{seed}"] = record(found | {"truth": found["truth"] | {"worst_kept": kept}})
    summary = summarise(case, case.rows["A"], done, Optimum(1.0))
    cells = columns_of(tables.fair_table(case, [summary]))
    assert cells["realised probability"] == "0.800, lowest 0.700"


def test_the_most_evaluations_are_those_of_one_run(make_case, record, answer):
    case = make_case(rows={"A": Row(name="A", algorithm="IV")})
    done = {f"run/c/A/{seed}": record(answer()) for seed in (1, 2)}
    done["run/c/A/1"]["result"] |= {"cuts": 110, "check_cuts": 0}
    done["run/c/A/2"]["result"] |= {"cuts": 90, "check_cuts": 40}
    found = summarise(case, case.rows["A"], done, None)
    cells = columns_of(tables.comparison_table(case, [found]))
    assert cells["evaluations (trials + checks)"] == "100 + 20, at most 130"


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
    found = [summarise(case, row, done, None) for row in rows.values()]
    assert tables.ranked_table(case, found) == ""
    truth = {"objective": 1.5, "feasible": True}
    done["run/c/peer/1"]["result"]["ranked"] = {"trial": 3, "truth": truth}
    done["run/c/peer/2"]["result"]["ranked"] = None
    assert rows_of(tables.ranked_table(case, found)) == [
        ["peer", "1 of 2: 1.5000", "2 of 2: 2.0000"]
    ]


@pytest.fixture
def published(make_case, record, answer):
    def make(numbers, objectives, **fields):
        """Rows with published numbers, and the objectives of their runs; see `answer`."""
        rows = {n: Row(name=n, algorithm="IV", published=numbers[n]) for n in numbers}
        runs = len(next(iter(objectives.values())))
        case = make_case(rows=rows, runs=runs)
        done = {
            f"run/c/{name}/{seed}": record(
                answer(E, training=E - 0.04 + 0.001 * (-1) ** seed, **fields.get(name, {}))
            )
            for name, values in objectives.items()
            for seed, E in enumerate(values, start=1)
        }
        return case, [summarise(case, row, done, None) for row in rows.values()]

    return make


def test_the_papers_numbers_stand_beside_ours(published):
    numbers = {"A": {"feasible": 0.5, "runs": 10, "objective": 0.147}, "B": {"difference": 0.002}}
    table = tables.published_table(published(numbers, {"A": [1.0, 1.2], "B": [2.0, 2.2]})[1])
    cells = rows_of(table)
    assert cells[0][:4] == ["A", "50% of 10", "2 of 2 (16% to 100%)", "0.147"]
    assert cells[1][0] == "B"
    assert "0.002" in cells[1]
    assert tables.published_table([]) == ""


def test_agreement_with_the_paper_is_said_with_its_reason(published):
    numbers = {
        "A": {"feasible": 0.3, "runs": 10, "objective": 0.2, "difference": 0.04},
        "B": {"feasible": 0.9, "runs": 10, "objective": 0.1, "difference": -0.01},
    }
    ours = {"A": [1.0, 1.01, 0.99] * 4, "B": [2.0, 2.02, 1.99] * 4}
    said = beside_the_paper(*published(numbers, ours))
    # 12 of 12 against 3 of 10: 15 over 3 of the 22 over 10 tables with these sums, and no other
    # is as unlikely.
    p = special.comb(10, 3) / special.comb(22, 15)
    assert said[0] == (
        "Differs: answers of A held in the validation in 3 of the paper's 10 runs and in 12 of 12 "
        f"here (p = {p:.2g})."
    )
    assert said[1].startswith("Agrees in sign: the validation of A differs from its")
    assert said[2].startswith("Compatible: answers of B held in the validation in 9 of the paper's")
    assert said[2].endswith(f"(p = {10 / 22:.2g}).")
    assert said[3].startswith("Differs: the validation of B")
    assert said[4].startswith("Differs: the validated objective of A less that of B is +0.100")
    ours["B"] = ours["A"][::-1]
    assert beside_the_paper(*published(numbers, ours))[-1].startswith("Undecided")


def test_a_share_of_unknown_runs_has_no_verdict(published):
    assert beside_the_paper(*published({"A": {"feasible": 0.5}}, {"A": [1.0, 1.1]})) == []


def test_the_order_is_of_pairs(published):
    """What differs from seed to seed by much hides no difference that all seeds share."""
    numbers = {"A": {"objective": 0.2}, "B": {"objective": 0.1}}
    ours = {"A": [1.0, 3.0, 2.0, 5.0]}
    ours["B"] = [E - gap for E, gap in zip(ours["A"], (0.1, 0.12, 0.09, 0.1), strict=True)]
    (said,) = beside_the_paper(*published(numbers, ours))
    assert said.startswith("Agrees in sign: the validated objective of A less that of B is +0.100")


@pytest.mark.parametrize(("other", "sentences"), [(0.151, 0), (0.152, 1)])
def test_what_the_paper_prints_almost_alike_has_no_order(published, other, sentences):
    numbers = {"A": {"objective": 0.147, "difference": 0.004}, "B": {"objective": other}}
    found = published(numbers, {"A": [1.0, 1.1, 1.2], "B": [2.0, 2.3, 2.1]})
    assert len(beside_the_paper(*found)) == sentences


@pytest.mark.parametrize(
    ("low", "reason"),
    [(0.5, ": its objective is low because it violates the limits."), (2.5, ".")],
)
def test_a_row_without_a_feasible_answer_is_not_ranked(published, low, reason):
    numbers = {"A": {"objective": 0.2}, "B": {"objective": 0.1}}
    ours = {"A": [1.0, 1.1, 0.9], "B": [low + 0.1, low, low - 0.1]}
    said = beside_the_paper(*published(numbers, ours, B={"feasible": False}))
    text = "No answer of B is truly feasible, so it is not ranked"
    assert said == [text + reason]


def test_a_gap_of_either_sign_is_no_agreement(make_case, record, answer):
    """Objectives of two plants have no common scale: a gap near the paper's says nothing."""
    row = Row(name="A", algorithm="IV", published={"difference": 0.02})
    case = make_case(rows={"A": row}, runs=4)
    answers = [answer(1.0, training=1.0 + gap) for gap in (-0.04, 0.03, 0.02, -0.03)]
    done = {f"run/c/A/{s}": record(found) for s, found in enumerate(answers, start=1)}
    (said,) = beside_the_paper(case, [summarise(case, row, done, None)])
    assert said.startswith("Undecided: the validation of A differs from its training by +0.02")


@pytest.fixture
def compared(make_case, record, answer):
    def make(objectives):
        """Sentences on our row and others, named by protocol; None is an infeasible answer."""
        random = {"protocol": "random", "contexts": 3}
        rows = {"ours": Row(name="ours", algorithm="IV")}
        for name in list(objectives)[1:]:
            fields = random if name.startswith("random") else {}
            rows[name] = Row(name=name, optimizer="valley:Draws", **fields)
        case = make_case(rows=rows, runs=len(objectives["ours"]))
        done = {
            f"run/c/{name}/{seed}": record(answer(9.0, feasible=False) if E is None else answer(E))
            for name, values in objectives.items()
            for seed, E in enumerate(values, start=1)
        }
        found = [summarise(case, row, done, None) for row in rows.values()]
        return beside_others(case, found)

    return make


def test_a_peer_that_wins_is_said_to_win(compared):
    reference, level, peer, worse, *best = compared(
        {
            "ours": [1.0, 2.0, 3.0, 1.0],
            "random": [0.9, 1.91, 2.89, 0.9],
            "lent": [1.2, 2.21, 3.19, None],
        }
    )
    assert reference.startswith("The reference is ours: 4 of 4")
    assert level.startswith("Each of the 2 comparisons is made at a confidence of 97.50%")
    assert "as many feasible answers" in peer
    assert "**a better objective where both are feasible, by -0.1000" in peer
    assert peer.endswith("over 4 runs**.")
    assert "no difference of feasible answers beyond chance (3 against 4 of 4)" in worse
    assert "a worse objective where both are feasible, by +0.2000" in worse
    assert worse.endswith("over 3 runs.")
    assert [text.split(":")[0] for text in best] == [
        "The best with random contexts is random",
        "The best with our worst-case search is lent",
    ]
    assert compared({"ours": [1.0, 1.0]}) == []


def test_fewer_feasible_answers_are_only_those_beyond_chance(compared):
    found = compared({"ours": [1.0] * 10, "lent": [1.0] + [None] * 9, "lent 2": [1.0] * 9 + [None]})
    assert "lent: 1 of 10 answers truly feasible" in found[2]
    assert "fewer feasible answers than the reference" in found[2]
    assert "beyond chance (9 against 10 of 10)" in found[3]


def test_many_comparisons_need_a_larger_difference(compared):
    """5 of 10 against 10 of 10 has p = 0.033: enough for one comparison, not for two."""
    half = [1.0] * 5 + [None] * 5
    assert "fewer feasible answers" in compared({"ours": [1.0] * 10, "lent": half})[2]
    two = compared({"ours": [1.0] * 10, "lent": half, "lent 2": half})
    assert "beyond chance (5 against 10 of 10)" in two[2]


def test_many_comparisons_have_wider_intervals(compared):
    ours = [1.0, 1.0, 1.0]
    gaps = [0.1, 0.2, 0.3]
    others = {f"lent {i}": [1.0 + gap for gap in gaps] for i in range(4)}
    half = stats.t.ppf(1.0 - 0.05 / 4 / 2, 2) * np.std(gaps, ddof=1) / np.sqrt(3)
    found = compared({"ours": ours} | others)
    assert f"+0.2000 ({0.2 - half:.4f} to {0.2 + half:.4f})" in found[2]


def test_no_best_is_named_among_infeasible_answers(compared):
    found = compared({"ours": [1.0, 1.0], "random": [None, None], "random 2": [None, None]})
    assert found[-1] == "None with random contexts has a truly feasible answer."


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
    found = [summarise(case, row, done, None) for row in case.rows.values()]
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
    found = [summarise(case, row, done, None) for row in case.rows.values()]
    (line, _) = rows_of(tables.neighbourhood_table(case, found, done))
    assert (line[0], line[3], line[-2]) == ("**best of A**", "1.5000", "infeasible")


def test_points_are_compared_with_the_papers(make_case, answer):
    tuned = {"g0": 0.5, "g1": 0.5}
    printed = {
        "default": {},
        "first": {"objective": 0.12, "feasible": 1},
        "worse": {"objective": 0.19, "feasible": 0},
        "alike": {"objective": 0.22, "feasible": 0},
        "close": {"objective": 0.124, "feasible": 1},
        "failed": {"objective": 0.2, "feasible": 1},
    }
    points = {name: Point(parameters=tuned, published=p) for name, p in printed.items()}
    judged = {
        "default": answer(), "first": answer(1.0), "worse": answer(0.9, feasible=False),
        # Two standard errors of 0.01 each.
        "alike": answer(1.028), "close": answer(2.0),
    }  # fmt: skip
    done = {f"point/c/{name}": {"failed": "", "result": found} for name, found in judged.items()}
    done["point/c/failed"] = {"failed": "ValueError: odd", "result": None}
    assert about_points(make_case(points=points), done) == [
        "Agrees: *first* is feasible in the paper and feasible here.",
        "Agrees: *worse* is infeasible in the paper and infeasible here.",
        "Differs: the objective of *worse* less that of *first* is +0.070 in the paper and "
        "-0.1000 here.",
        "Differs: *alike* is infeasible in the paper and feasible here.",
        "Differs: the objective of *alike* less that of *first* is +0.100 in the paper and "
        "+0.0280 here, which is within two standard errors.",
        "Agrees: *close* is feasible in the paper and feasible here.",
    ]


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
