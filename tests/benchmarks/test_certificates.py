"""Parameter sets that are infeasible by as little as bisection finds."""

import json
from types import SimpleNamespace

import pytest
from certificates import BISECTIONS, answers, just_infeasible, summary
from common import BENCHMARKS, RESULTS

from bo_tuner.study.study_file import load_study


class Truth:
    """Feasible where lambda_mpc is at least -1."""

    def verdict(self, parameters, _):
        return SimpleNamespace(feasible=parameters["lambda_mpc"] >= -1.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_is_just_beyond_the_limit(seed):
    study = load_study("benchmark")
    parameters = study.search_space().defaults | {"lambda_mpc": 0.5}
    found = just_infeasible(study, Truth(), parameters, seed)
    lower, upper = study.parameters["lambda_mpc"].bounds
    assert -1.0 - (upper - lower) / 2**BISECTIONS <= found["lambda_mpc"] < -1.0


def test_there_is_none_where_nothing_is_infeasible():
    study = load_study("benchmark")
    truth = SimpleNamespace(verdict=lambda *_: SimpleNamespace(feasible=True))
    assert just_infeasible(study, truth, study.search_space().defaults, 1) is None


def test_answers_are_those_of_one_row_of_one_case(tmp_path):
    answer = '"result": {"answer": {"trial": 7}}'
    none = '"result": {"answer": null}'
    lines = [
        f'{{"task": "run/mean/boundary/2", {answer}}}',
        f'{{"task": "run/mean/IV/2", {answer}}}',
        f'{{"task": "run/other/boundary/2", {answer}}}',
        f'{{"task": "run/mean/boundary/3", {none}}}',
        '{"task": "run/mean/boundary/4", "failed": "OSError: odd", "result": null}',
    ]
    (tmp_path / "x.jsonl").write_text("\n".join(lines))
    assert answers(tmp_path, "x", "mean") == [(2, {"trial": 7})]


def test_a_summary_counts_what_passed():
    certified = [
        {"passed": passed, "evaluations": k, "least": 2}
        for k, passed in enumerate((True, False, True))
    ]
    found = summary(certified)
    assert (found["certified"], found["passed"]) == (3, 2)
    assert (found["median_evaluations"], found["most_evaluations"]) == (1, 2)
    assert found["median_of_least"] == 0.5
    assert found["interval"][0] < 2 / 3 < found["interval"][1]
    assert summary([]) is None


def test_the_readme_says_what_the_record_has():
    record = json.loads((RESULTS / "certificates.json").read_text(encoding="utf-8"))
    runs = [run for case in record["cases"].values() for run in case["runs"]]
    kept = [run["answer"]["passed"] for run in runs if run["feasible"] and "answer" in run]
    broken = [run["infeasible"]["passed"] for run in runs if "infeasible" in run]
    readme = (BENCHMARKS.parent / "README.md").read_text(encoding="utf-8")
    assert (
        f"PASS for {sum(kept)} of {len(kept)} results that are truly within limits, and for "
        f"{sum(broken)} of {len(broken)} that are just over"
    ) in readme
