"""Sentences from records that are written out here, so that each number is known."""

import numpy as np
import pytest
from markdown_tables import rows_of
from scipy import special, stats

from tuning_benchmark.experiments.experiment import Point, Row
from tuning_benchmark.pages import tables
from tuning_benchmark.pages.findings import about_points, beside_others, beside_the_paper
from tuning_benchmark.pages.summary import summarize


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
        return case, [summarize(case, row, done, None) for row in rows.values()]

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
    (said,) = beside_the_paper(case, [summarize(case, row, done, None)])
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
        found = [summarize(case, row, done, None) for row in rows.values()]
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
