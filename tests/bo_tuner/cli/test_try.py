"""One run of one parameter set, with its response."""

import re
from functools import partial

import pytest
from axis import node, write_study
from in_process import call, complaint

from bo_tuner.cli import try_ as try_command

LIMITS = {
    "peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0},
    "error": {"kind": "chance", "metric": "error", "lower": 0.5, "upper": 9.0, "probability": 0.9},
}
TRACE = """

    def trace(self):
        time = [0.0, 1.0, 2.0]
        return {"time": ("s", time), "angle/measured": ("rad", [self.gain * t for t in time])}
"""


@pytest.fixture
def place(tmp_path, make_study, monkeypatch):
    """Folder with a study and its object, whose peak is the gain times the load."""
    study = make_study(name="axis", nodes=node("tried_axis"), constraints=LIMITS)
    write_study(tmp_path, study, peak="self.gain * self.load", error="self.load")
    (tmp_path / "values.yaml").write_text("gain: 0.7\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("CUTS", str(tmp_path / "cuts"))
    return tmp_path


@pytest.fixture
def here(place, capsys):
    """Function that tries; returns code, out and err."""
    return partial(call, try_command, capsys, "axis.yaml", "--backend", "inprocess")


@pytest.fixture
def refusal(place, capsys):
    return partial(complaint, try_command, capsys)


def cells(out, name):
    """The rows of the printed table that begin with a name, as words."""
    return [
        words for line in out.splitlines() if (words := re.findall(r"[^\s│┃]+", line))[:1] == [name]
    ]


def test_within_all_limits(here, place):
    code, out, err = here("--parameters", "values.yaml", "--context", "load=1.25")
    assert code == 0, err
    assert "parameters: gain 0.7\n" in out
    assert "context: load 1.25\n" in out
    # 0.7 * 1.25; the error has two limits, so two rows.
    assert cells(out, "peak") == [["peak", "0.875", "≤", "1", "within"]]
    assert [row[1:4] for row in cells(out, "error")] == [["1.25", "≥", "0.5"], ["1.25", "≤", "9"]]
    assert "this run is within its 3 limits\n" in out
    assert (place / "cuts").read_text() == "1"
    assert "0.875" in (place / "runs" / "axis-try" / "response.html").read_text()


def test_values_of_the_command_line_count_more_than_those_of_a_file(here):
    _, out, _ = here("--parameters", "values.yaml", "--set", "gain=0.25")
    assert "parameters: gain 0.25\n" in out


def test_beyond_a_limit(here):
    code, out, _ = here("--parameters", "values.yaml", "--context", "load=1.5")
    assert code == 3
    assert cells(out, "peak") == [["peak", "1.05", "≤", "1", "BEYOND"]]
    assert "this run is beyond 1 of 3 limits: peak\n" in out


def test_the_default_in_the_nominal_context(here, place, make_study):
    study = make_study()
    nominal = study.context_space().to_dict(study.context_space().nominal())["load"]
    default = study.search_space().defaults["gain"]
    _, out, _ = here()
    assert f"context: load {nominal:.4g}\n" in out
    assert float(cells(out, "peak")[0][1]) == pytest.approx(default * nominal)


def test_a_run_that_fails(here, place, monkeypatch):
    monkeypatch.setenv("FAILING", "1000")
    code, out, _ = here()
    assert code == 3
    assert "the run is failed: " in out
    assert "stalled" in out
    assert "stalled" in (place / "runs" / "axis-try" / "response.html").read_text()
    assert not (place / "runs" / "axis-try" / "response.png").exists()


def test_without_signals_it_says_so(here):
    _, out, _ = here()
    assert "No signals: the object of node 'axis' has no trace()." in out


def test_the_response(here, place, make_study):
    # In a module of its own: the process keeps those of other tests.
    study = make_study(name="axis", nodes=node("traced_axis"), constraints=LIMITS)
    write_study(place, study, peak="self.gain * self.load", error="self.load")
    module = place / "traced_axis.py"
    module.write_text(module.read_text() + TRACE)
    code, out, err = here("--parameters", "values.yaml", "--context", "load=1", "--output", "shown")
    assert code == 0, err
    assert (place / "cuts").read_text() == "1"
    assert (place / "shown" / "response.png").read_bytes().startswith(b"\x89PNG")
    page = (place / "shown" / "response.html").read_text()
    # 0.7 times 0, 1 and 2 s.
    low, high = map(float, re.search(r'data-y="(\S+) (\S+) linear"', page).groups())
    path = re.search(r'<path d="([^"]+)"[^>]* class="traced"/>', page)[1]
    shares = [float(point) / 1000.0 for point in re.findall(r",([-\d.]+)", path)]
    shown = [high - share * (high - low) for share in shares]
    assert shown == pytest.approx([0.0, 0.7, 1.4], abs=0.001)
    assert "response: shown/response.png" in out
    assert "page: shown/response.html" in out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["nothing.yaml"], "nothing.yaml: "),
        (["axis.yaml", "--parameters", "nothing.yaml"], "nothing.yaml: "),
        (["axis.yaml", "--context", "load"], "expected NAME=VALUE, such as load=1.5"),
        (["axis.yaml", "--context", "load={a: 1}"], "expected NAME=VALUE"),
        (
            ["axis.yaml", "--context", "load=[1]"],
            "--context: load: expected a number, found text '[1]'",
        ),
        (["axis.yaml", "--context", "lode=1"], "--context: expected load, found 'lode'"),
        (
            ["axis.yaml", "--context", "load=5"],
            "--context: load: expected a possible value, the nearest is 2, found 5",
        ),
        (["axis.yaml", "--context", "load=heavy"], "--context: load: expected a number, found"),
        (
            ["axis.yaml", "--context", "load=1", "--context", "load=2"],
            "--context: load has more than one value",
        ),
        (
            ["axis.yaml", "--set", "gein=1"],
            "--set: there is no parameter 'gein'; did you mean 'gain'?",
        ),
        (["axis.yaml", "--set", "gain=7"], "--set: "),
        (
            ["axis.yaml", "--set", "gain=1", "--set", "gain=0"],
            "--set: gain has more than one value",
        ),
        (["axis.yaml", "--attach"], "--attach needs --backend ros"),
    ],
)
def test_bad_input(refusal, place, arguments, complaint):
    assert complaint in refusal("--backend", "inprocess", *arguments)
    assert not (place / "runs").exists()


def test_values_that_are_no_parameter_set(refusal, place):
    (place / "values.yaml").write_text("gain: 70\n")
    arguments = ("axis.yaml", "--backend", "inprocess", "--parameters", "values.yaml")
    assert "values.yaml" in refusal(*arguments)


def test_a_folder_that_cannot_be_written(refusal, place):
    (place / "runs").touch()
    assert "runs" in refusal("axis.yaml", "--backend", "inprocess")
