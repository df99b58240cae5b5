"""The table of the trials on a screen."""

import pytest
from terminals import console

from bo_tuner.monitoring.trial_table import REPEATED, TrialTable

LIMITS = {
    "peak": {"kind": "worst_case", "metric": "peak", "upper": 2.0},
    "often": {"kind": "chance", "metric": "error", "upper": 2.0, "probability": 0.9},
}
METRICS = {
    "error": {"node": "axis", "unit": "m"},
    "peak": {"node": "axis", "unit": "ms", "label": "solve time"},
}


@pytest.fixture
def study(make_study):
    return make_study(metrics=METRICS, constraints=LIMITS)


def lines(study, trials, width=None, mark=""):
    table = TrialTable(study, console(width or 80, terminal=width is not None))
    return [line for trial in trials for line in table.lines(trial, mark)]


def test_the_screen(study, make_trial):
    trials = [
        make_trial(0, {"gain": 0.5}, [1.0, 2.0], worst=0.5),
        make_trial(1, {"gain": 0.25}, [1.0], worst=2.31),
        make_trial(2, {"gain": 0.125}, [2.5, 2.5, 2.5], worst=2.31),
        make_trial(3, {"gain": 1.0}),
    ]
    assert [line.plain for line in lines(study, trials, 100)] == [
        "                          worst solve",
        "trial      gain     error        time      error",
        "                        m          ms          m",
        "                                  ≤ 2        ≤ 2",
        "    0       0.5       1.5         0.5          2",
        "    1      0.25         1        2.31!         1   over the limit (solve time 2.31 > 2)",
        "    2     0.125       2.5        2.31!       2.5!  over the limit",
        "    3         1         –           –          –",
        "      FAILED: axis: stalled (context load 1.500; seed 0)",
    ]  # fmt: skip


def test_a_value_has_the_colour_of_its_outcome(study, make_trial):
    *_, line = lines(study, [make_trial(1, {"gain": 0.25}, [1.0], worst=2.31)], 100)
    styles = {line.plain[span.start : span.end].strip(): span.style for span in line.spans}
    assert styles["2.31!"] == "red"
    assert styles["1"] == "green"


def test_a_margin_that_is_too_small_has_another_sign(make_study, make_trial):
    limit = {"kind": "worst_case", "metric": "peak", "upper": 1.0, "probability": 0.9}
    study = make_study(constraints={"peak": limit})
    *_, line = lines(study, [make_trial(0, {"gain": 0.5}, [1.0], worst=0.9, noise=0.1)], 100)
    # 1.2816 deviations above the mean.
    assert line.plain.endswith(" 1.028~  margin too small (peak 1.028 > 1)")


def test_a_file_has_all_words_whatever_its_width(study, make_trial):
    *_, line = lines(study, [make_trial(2, {"gain": 0.125}, [2.5] * 3, worst=2.31)])
    assert line.plain.endswith("over the limit (solve time 2.31 > 2, error 2.5 > 2)")


@pytest.mark.parametrize("width", [20, 40, 60, 80, 100])
def test_every_line_fits_and_every_value_is_there(make_study, make_trial, width):
    item = {"node": "axis", "type": "double", "bounds": [0.0, 1.0], "default": 0.5}
    names = [f"gain_{k}" for k in range(6)]
    study = make_study(parameters=dict.fromkeys(names, item), constraints=LIMITS)
    values = {name: 0.1234 + 0.01 * k for k, name in enumerate(names)}
    found = lines(study, [make_trial(7, values, [1.5], worst=2.31)], width, "best so far")
    text = "\n".join(line.plain for line in found)
    assert max(line.cell_len for line in text_lines(found)) <= max(width, 28)
    assert all(f"{value:.4g}" in text for value in (*values.values(), 1.5, 2.31))


def text_lines(found):
    return [part for line in found for part in line.split("\n")]


def test_the_header_comes_again(study, make_trial):
    trials = [make_trial(k, {"gain": 0.5}, [1.0]) for k in range(REPEATED + 1)]
    headers = [line for line in lines(study, trials, 100) if line.plain.startswith("trial")]
    assert len(headers) == 2
