"""What is too much is refused in a line, at once, and before anything is done with it."""

import re
from pathlib import Path

import pytest
from small_run import make_run

from bo_tuner import maxima
from bo_tuner.cli import tune, validate
from bo_tuner.errors import StudyError
from bo_tuner.metrics.collect import Collector
from bo_tuner.trials import EvaluationState

NODE = {"node": "axis"}
DOUBLE = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}


def many(count, item):
    return {f"n{k}": item for k in range(count)}


BUDGET = {"trials": 5, "initial_trials": 3}


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("sections", "path", "complaint"),
    [
        ({"budget": BUDGET | {"trials": 10**18}}, "budget.trials", "at most 10000,"),
        ({"budget": BUDGET | {"drawn_contexts": 10**12}}, "budget.drawn_contexts", "at most"),
        ({"budget": BUDGET | {"search_evaluations": 10**12}}, "search_evaluations", "at most"),
        ({"budget": BUDGET | {"validation_draws": 10**12}}, "validation_draws", "at most 100000,"),
        ({"parameters": many(9_000, DOUBLE)}, "parameters", "at most 500 entries, found 9000"),
        ({"parameters": many(201, DOUBLE)}, "parameters", "at most 200 tuned ones, found 201"),
        ({"metrics": {"error": NODE, "peak": NODE} | many(199, NODE)}, "metrics", "at most 200"),
        (
            {"contexts": many(51, NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]})},
            "contexts",
            "at most 50 entries, found 51",
        ),
        ({"order": [["gain", "gain"]] * 501}, "order", "at most 500 entries"),
        ({"trigger": NODE | {"service": "~/run", "timeout": 1e300}}, "timeout", "at most 86400 s"),
        (
            {"nodes": {"axis": NODE | {"result": "~/r", "parameters": {"x": [1.0] * 1001}}}},
            "nodes.axis.parameters.x",
            "at most 1000 entries, found 1001",
        ),
    ],
)
def test_a_study(make_study, sections, path, complaint):
    with pytest.raises(StudyError, match=complaint) as caught:
        make_study(**sections)
    assert path in str(caught.value)
    assert len(str(caught.value)) < 200


def test_the_largest_are_taken(make_study):
    study = make_study(parameters=many(50, DOUBLE), budget=BUDGET | {"trials": maxima.TRIALS})
    assert len(study.parameters) == 50


@pytest.mark.parametrize("size", ["1e300", "inf", "nan", "10000001", "0", "-1"])
def test_a_limit_of_the_record(size, capsys):
    with pytest.raises(SystemExit) as end:
        tune.make_parser().parse_args(["--record-limit", size])
    assert end.value.code == 2
    assert "at most 10000000 megabytes" in capsys.readouterr().err


def test_draws_of_a_certificate(tmp_path, capsys):
    make_run(tmp_path / "run")
    with pytest.raises(SystemExit) as end:
        validate.run([str(tmp_path / "run"), "--trial", "0", "--runs", str(10**18)], None)
    assert end.value.code == 2
    assert "--runs: expected at most 100000" in capsys.readouterr().err


def test_an_answer_of_megabytes(make_study):
    said = {f"key_{k}": "x" * 60 for k in range(100_000)}
    outcome = Collector(make_study()).outcome(
        {"axis": {"status": "ok", "error": "1", "peak": "1"} | said}
    )
    assert outcome.state is EvaluationState.FAILED
    assert outcome.reason == "axis: reports 100003 values; at most 1000 are accepted"
    assert outcome.details == {}


def test_the_documents_have_the_same_numbers():
    page = (Path(__file__).parents[3] / "docs" / "interfaces.md").read_text()
    section = page.partition("## Maxima")[2].partition("\n## ")[0]
    told = {row[0]: float(row[1].replace(" ", "")) for row in re.findall(
        r"^\| `(\w+)` \|[^|]*\| ([\de ]+)[^|]*\|$", section, re.M)}  # fmt: skip
    held = {name: value for name, value in vars(maxima).items() if name.isupper()}
    assert told == held
