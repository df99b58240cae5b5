"""Conditions between parameters on the command line: refused, kept by a run, and by a later one."""

import pytest
from axis import node, write_study
from commands import run

from bo_tuner.storage.record import read_run

NODE = {"node": "axis"}
# The best of the error, at gain 0.3, is beyond the condition.
WHERE = ["gain >= 0.4 + trim"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, make_study):
    folder = tmp_path_factory.mktemp("conditions")
    trim = NODE | {"type": "double", "bounds": [0.0, 0.5], "default": 0.05}
    gain = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
    budget = {"trials": 9, "initial_trials": 4, "drawn_contexts": 2, "search_evaluations": 2}
    study = make_study(
        nodes=node("conditions_axis"),
        parameters={"gain": gain, "trim": trim},
        where=WHERE,
        start=["default"],
        budget=budget | {"validation_draws": 5},
    )
    write_study(folder, study)
    code, _, err = run(
        "tune", "--study", "axis.yaml", "--backend", "inprocess", "--quiet", folder=folder
    )
    assert code in (0, 3), err
    return folder


def test_all_trials_of_a_run_keep_them(folder):
    record = read_run(folder / "runs" / "latest")
    assert len(record.trials) >= 9
    assert all(t.parameters["gain"] >= 0.4 + t.parameters["trim"] for t in record.trials)


def test_a_start_that_breaks_one_is_refused(folder):
    (folder / "known.yaml").write_text("gain: 0.3\n")
    code, out, err = run(
        "tune", "--study", "axis.yaml", "--backend", "inprocess", "--start", "known.yaml",
        folder=folder,
    )  # fmt: skip
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert "breaks the condition 'gain >= 0.4 + trim': gain 0.3 and trim 0.05" in line
    assert "known.yaml" in line


def test_bounds_that_leave_nothing_are_refused(folder):
    options = ("--bounds", "gain=0.3:0.5", "--bounds", "trim=0.05:1000000")
    code, out, err = run(
        "tune", "--study", "axis.yaml", "--backend", "inprocess", *options, folder=folder
    )
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert "where[0]: 'gain >= 0.4 + trim' holds for " in line


def test_a_file_with_a_bad_condition_names_its_line(folder):
    text = (folder / "axis.yaml").read_text().replace("0.4 + trim", "0.4 + trimm")
    (folder / "bad.yaml").write_text(text)
    number = next(k for k, line in enumerate(text.splitlines(), 1) if "trimm" in line)
    code, out, err = run("tune", "--study", "./bad.yaml", "--backend", "inprocess", folder=folder)
    assert (code, out) == (2, "")
    assert err.splitlines() == [
        f"error: ./bad.yaml:{number}: where[0]: there is no parameter or function 'trimm'; "
        "did you mean 'trim'?"
    ]


def test_a_later_run_leaves_out_what_breaks_them(folder):
    """And says so, by the condition."""
    record = read_run(folder / "runs" / "latest")
    gains = sorted(t.parameters["gain"] for t in record.trials)
    edge = 0.5 * (gains[1] + gains[2])
    text = (folder / "axis.yaml").read_text().replace("0.4 + trim", f"{edge} - 0.0 * trim")
    text = text.replace("default: 0.5\n", "default: 0.9\n")
    (folder / "later.yaml").write_text(text)
    code, _, err = run(
        "tune", "--from", record.path, "--study", "./later.yaml", "--quiet", folder=folder
    )
    assert code in (0, 3), err
    later = read_run(folder / "runs" / "latest")
    assert all(t.parameters["gain"] >= edge for t in later.trials)
    assert f"against the condition gain >= {edge} - 0.0 * trim" in str(later.provenance)
