import re
from pathlib import Path

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.method_names import BOUNDARY, SAFE
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study_file import load_study
from tuning_benchmark.experiments.experiment_file import load_experiment, shipped_experiments

DOCUMENT = Path(__file__).parents[3] / "docs" / "campaigns.md"


@pytest.mark.parametrize("name", shipped_experiments())
def test_shipped_experiments_can_be_read(name):
    assert load_experiment(name).name == name


@pytest.mark.parametrize(("name", "without"), [("paper", {BOUNDARY}), ("small", set())])
def test_experiments_have_all_algorithms(name, without):
    experiment = load_experiment(name)
    # A safe search is compared with plain ones by what it breaks, not by what it finds.
    assert set(experiment.cases["benchmark"].rows) == set(METHODS) - without - {SAFE}


def test_the_paper_has_its_tables():
    paper = load_experiment("paper")
    assert paper.cases["benchmark"].runs == 10
    assert paper.cases["full"].runs == 4
    assert paper.optimum(paper.cases["full"].study).objective < 0.17
    assert paper.cases["benchmark"].rows["I"].published["feasible"] == 0.5


def test_a_study_lies_beside_the_experiment(experiment_file):
    case = load_experiment(str(experiment_file)).cases["valley"]
    assert case.study.name == "valley2"
    assert case.budget(case.rows["I"]) == 10
    assert case.budget(case.rows["IV"]) == 60


def test_a_case_changes_keys_of_its_study(experiment_file):
    text = experiment_file.read_text()
    changes = "{name: other, budget.trials: 77, budget.drawn_contexts: null}"
    experiment_file.write_text(text.replace("    rows:", f"    changes: {changes}\n    rows:"))
    before = load_study(experiment_file.parent / "valley.yaml")
    study = load_experiment(str(experiment_file)).cases["valley"].study
    assert (study.name, study.budget.trials, study.budget.drawn_contexts) == ("other", 77, None)
    assert study.replace(trials=before.budget.trials).constraints == before.constraints


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("runs: 2", "runs: 0", r"closed.yaml:7: cases.valley.runs: .* at least 1, found 0"),
        ("runs: 2", "rums: 2", r"closed.yaml:7: cases.valley.rums: unknown key; did you mean"),
        ("    runs: 2\n", "", r"cases.valley.runs: missing"),
        ("algorithm: IV", "algorithm: VI", r"rows.IV.algorithm: unknown 'VI'"),
        ("{algorithm: IV}", "{}", r"rows.IV: expected either an algorithm or an optimizer"),
        ("valley:Draws\", protocol", "valley\", protocol", r"optimizer: expected module:Class"),
        (", contexts: 6", "", r"rows.draws.contexts: expected an integer of at least 1, found 0"),
        ("ed_evaluations: 20", "ed_evaluations: 60", r"reserved_evaluations: expected less than"),
        ("valley:Judge", "valley.Judge", r"closed.yaml:2: judge: expected module:Class"),
        ("study: valley.yaml", "study: other.yaml", r"other.yaml: cannot be read"),
        ("cases:", "cases: {}\nx:", r"closed.yaml:4: x: unknown key"),
        ("{algorithm: IV}", "{algorithm: IV, published: {cost: 1}}", r"published.cost: unknown"),
        ("title: A valley", "title: 2024", r"closed.yaml:5: cases.valley.title: expected text"),
        ("runs: 2", "runs: 2\n    remarks: 7", r"cases.valley.remarks: expected text, found 7"),
        ("name: closed", "name: closed\ntitle: 7", r"closed.yaml:2: title: expected text, found 7"),
        ("name: closed", "name: closed\ndescription: 7", r"description: expected text, found 7"),
        (
            "    rows:",
            "    points: {middle: {parameters: {}, neighbours: 1}}\n    rows:",
            r"points.middle.neighbours: expected true or false, found 1",
        ),
        ("name: closed", "name: closed\ntruth: none.json", r"truth: cannot read"),
        (
            "    rows:",
            "    surrogates: {row: draws}\n    rows:",
            r"surrogates: expected an algorithm on a study of two",
        ),
        (
            "    rows:",
            "    points: {middle: {parameters: {g0: 0.5}}}\n    rows:",
            r"points.middle.parameters: .*g1",
        ),
        ("cases:", "cost: {dimensions: [0]}\ncases:", r"cost.dimensions\[0\]: expected"),
        (
            "    rows:",
            "    changes: {budget.trial.s: 3}\n    rows:",
            r"closed.yaml:\d+: cases.valley.changes.budget.trial.s: expected a path of keys",
        ),
        (
            "    rows:",
            "    changes: {budget.trials: none}\n    rows:",
            r"cases.valley.changes.budget.trials: expected an integer",
        ),
    ],
)  # fmt: skip
def test_mistakes_are_one_line_with_their_place(experiment_file, old, new, message):
    text = experiment_file.read_text()
    assert old in text
    experiment_file.write_text(text.replace(old, new, 1))
    with pytest.raises(StudyError, match=message) as caught:
        load_experiment(str(experiment_file))
    assert "\n" not in str(caught.value)


def test_unknown_names_list_what_is_shipped():
    with pytest.raises(
        StudyError,
        match="unknown experiment 'papr'; shipped are boundary, choices, closed_form, exploration",
    ):
        load_experiment("papr")


def test_the_documented_experiment_is_one(tmp_path):
    (block,) = re.findall(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    (tmp_path / "mine.yaml").write_text(block)
    (case,) = load_experiment(str(tmp_path / "mine.yaml")).cases.values()
    assert list(case.rows) == ["IV", "IV, random", "mine"]
    assert case.rows["mine"].optimizer == "my_module:MyOptimizer"
