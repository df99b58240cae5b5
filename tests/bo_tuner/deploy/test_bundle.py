"""The bundle of a run, and the parameter files in it."""

import csv
import hashlib
import json
from dataclasses import replace

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from made_runs import INITIAL, make_run, write_certificate

from bo_tuner.deploy.bundle import read_rollback, result_of, write_bundle
from bo_tuner.errors import OutputError, RunRecordError
from bo_tuner.storage.parameter_file import from_yaml, to_yaml
from bo_tuner.storage.run_folder import RunFolder

FILES = {"parameters.yaml", "rollback.yaml", "difference.csv", "provenance.json"}


VALUES = "/**/x_drive: {{ros__parameters: {{mode: a, limits: [1.0], gain: {gain}, n: {n}}}}}"


def sealed(text):
    """A rollback file whose digest fits."""
    return f"# sha256 of all that follows: {hashlib.sha256(text.encode()).hexdigest()}\n{text}"


@pytest.fixture
def study(make_study):
    node = {"node": "axis"}
    return make_study(
        nodes={
            "axis": {
                "node": "x_drive",
                "result": "~/cut_result",
                "parameters": {"mode": "fast", "limits": [0.5, 1.0]},
            }
        },
        parameters={
            "gain": node | {"type": "double", "bounds": [0.0, 8.0], "default": 2.0, "unit": "1/s"},
            "taps": node | {"type": "integer", "bounds": [1, 9], "default": 4, "parameter": "n"},
        },
        constraints={},
        budget=INITIAL,
    )


@pytest.fixture
def record(tmp_path, study, function_backend):
    backend = function_backend(
        study, lambda gain, n, load, seed: {"error": gain + n * load, "peak": 0.5}
    )
    return make_run(tmp_path / "run", study, backend, result=2)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


class TestBundle:
    def test_the_parameter_file_is_the_one_of_the_run(self, record):
        folder = write_bundle(record)
        trial = record.trials[2]
        run_folder = RunFolder(record.path)
        best = run_folder.write_parameters(record.study, trial.parameters)
        run_folder.close()
        assert (folder / "parameters.yaml").read_text() == best.read_text()
        values = yaml.safe_load(best.read_text())["/**/x_drive"]["ros__parameters"]
        assert values == {"mode": "fast", "limits": [0.5, 1.0]} | {
            "gain": trial.parameters["gain"], "n": trial.parameters["taps"],
        }  # fmt: skip
        assert (type(values["gain"]), type(values["n"])) == (float, int)

    def test_the_way_back_has_the_defaults(self, record):
        folder = write_bundle(record)
        values = yaml.safe_load((folder / "rollback.yaml").read_text())
        assert values["/**/x_drive"]["ros__parameters"] == {
            "mode": "fast", "limits": [0.5, 1.0], "gain": 2.0, "n": 4,
        }  # fmt: skip

    def test_the_difference(self, record):
        folder = write_bundle(record)
        with (folder / "difference.csv").open(newline="") as file:
            rows = {row["parameter"]: row for row in csv.DictReader(file)}
        trial = record.trials[2]
        assert list(rows) == ["mode", "limits", "gain", "n"]
        assert float(rows["gain"]["default"]) == 2.0
        assert float(rows["gain"]["tuned"]) == trial.parameters["gain"]
        assert int(rows["n"]["tuned"]) == trial.parameters["taps"]
        assert (rows["gain"]["unit"], rows["gain"]["node"]) == ("1/s", "x_drive")
        assert (rows["gain"]["changed"], rows["mode"]["changed"]) == ("yes", "")

    def test_the_provenance_has_the_hash_of_every_other_file(self, record):
        write_certificate(record, record.trials[2])
        folder = write_bundle(record)
        (folder / "notes.txt").write_text("of a human")
        provenance = json.loads((folder / "provenance.json").read_text())
        files = contents(folder)
        del files["provenance.json"], files["notes.txt"]
        assert provenance["sha256"] == {
            name: hashlib.sha256(content).hexdigest() for name, content in files.items()
        }
        assert provenance["trial"] == 2
        assert provenance["parameters"] == dict(record.trials[2].parameters)
        assert provenance["provenance"] == dict(record.provenance)

    def test_what_the_run_has_is_copied_and_what_it_has_no_more_goes(self, record):
        assert set(contents(write_bundle(record))) == FILES
        certificate = write_certificate(record, record.trials[2])
        (record.path / "report.html").write_text("<html>")
        files = contents(write_bundle(record))
        assert set(files) == FILES | {
            "certificate.json",
            "certificate_evaluations.csv",
            "report.html",
        }
        assert files["report.html"] == b"<html>"
        assert json.loads(files["certificate.json"])["verdict"] == "PASS"
        assert files["certificate_evaluations.csv"] == b"evaluations"
        certificate.unlink()
        files = contents(write_bundle(record))
        assert set(files) == FILES | {"report.html"}
        assert "certificate.json" not in json.loads(files["provenance.json"])["sha256"]

    def test_an_unreadable_certificate_blocks_no_way_back(self, record):
        """It is left out, and so is the one before: the later one may be a FAIL."""
        write_certificate(record, record.trials[2])
        write_certificate(record, record.trials[2]).write_text("{")
        assert set(contents(write_bundle(record))) == FILES

    def test_again_changes_nothing(self, record):
        folder = write_bundle(record)
        (folder / "notes.txt").write_text("of a human")
        before = contents(folder)
        times = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
        assert write_bundle(record) == folder
        assert contents(folder) == before
        assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == times

    def test_a_way_back_that_was_given_stays(self, record):
        write_bundle(record)
        assert read_rollback(record)["x_drive"]["gain"] == 2.0
        live = {"x_drive": {"mode": "slow", "limits": [0.25], "gain": 7.5, "n": 9}}
        folder = write_bundle(record, rollback=live)
        write_bundle(record)
        assert read_rollback(record) == live
        expected = hashlib.sha256((folder / "rollback.yaml").read_bytes()).hexdigest()
        provenance = json.loads((folder / "provenance.json").read_text())
        assert provenance["sha256"]["rollback.yaml"] == expected


def test_a_study_in_which_no_node_has_a_parameter(tmp_path, make_study, function_backend):
    """They stand in what starts the node; there is nothing to set, or to set back, on any."""
    study = make_study(
        nodes={"axis": {"node": "x_drive", "result": "~/cut_result", "command": "drive {gain}"}},
        parameters={"gain": {"type": "double", "bounds": [0.0, 8.0], "default": 2.0}},
        contexts={},
        constraints={},
        budget=INITIAL,
    )
    backend = function_backend(study, lambda seed: {"error": seed % 7.0, "peak": 0.5})
    record = make_run(tmp_path / "run", study, backend, result=2)
    folder = write_bundle(record)
    assert read_rollback(record) == {}
    gain = record.result.parameters["gain"]
    said = f"# gain = {gain}: stands in nodes.axis.command; put it there"
    assert said in (folder / "parameters.yaml").read_text().splitlines()


class TestRefusals:
    def test_a_run_without_a_result(self, record):
        with pytest.raises(RunRecordError, match="has no result"):
            write_bundle(replace(record, summary=None))
        with pytest.raises(RunRecordError, match="names trial 77, not on record"):
            result_of(replace(record, summary={"trial": 77}))
        assert not (record.path / "deploy").exists()

    def test_values_from_which_no_file_leads_back(self, record):
        values = {"x_drive": {"mode": "slow", "limits": [0.5], "gain": float("nan"), "n": 1}}
        with pytest.raises(OutputError, match=r"rollback\.yaml: cannot hold the nodes' values"):
            write_bundle(record, rollback=values)
        assert not (record.path / "deploy").exists()

    def test_a_folder_that_cannot_be_made(self, record):
        (record.path / "deploy").write_text("in the way")
        with pytest.raises(OutputError, match="deploy: cannot be written: File exists"):
            write_bundle(record)

    @pytest.mark.parametrize(
        ("text", "complaint"),
        [
            ("[1, 2", "line 1: a list cannot be a key"),
            ("", "expected a parameter file, found"),
            ("7", "expected a parameter file, found no section"),
            ("x_drive: {ros__parameters: {}}", "expected a section /**/<node>, found 'x_drive'"),
            ("/**/x_drive: {gain: 1.0}", "line 1: a value ahead of ros__parameters"),
            ("/**/x_drive: {ros__parameters: 7}", "line 1: a value ahead of"),
            ("/**/x_drive: {ros__parameters: [}", "line 1: not valid YAML: "),
            ("/**/x_drive: {ros__parameters: {gain: .nan}}", "x_drive.gain: "),
            ("/**/x_drive: {ros__parameters: {gain: {a: 1}}}", "expected values of mode, limits,"),
            ("/**/x_drive: {ros__parameters: {gain: 1.0}}", "expected values of mode, limits,"),
            (VALUES.format(gain="3", n="4"), "gain: expected a value of the type of 2.0, found 3"),
            (VALUES.format(gain="3.0", n="4.0"), "n: expected a value of the type of 4, found 4.0"),
            (VALUES.format(gain="3.0", n="true"), "n: expected a value of the type of 4, found tr"),
            (VALUES.format(gain="fast", n="4"), "gain: expected a value of the type of 2.0"),
            ("/**/other: {ros__parameters: {gain: 1.0}}", "of x_drive, and no others"),
            ("!!python/object/apply:os.getcwd []", "line 1: a list cannot be a key"),
        ],
    )
    def test_a_way_back_that_is_none(self, record, text, complaint):
        folder = write_bundle(record)
        (folder / "rollback.yaml").write_text(sealed(text))
        with pytest.raises(RunRecordError) as caught:
            read_rollback(record)
        assert complaint in str(caught.value)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("change", [("gain: 2.0", "gain: 9.0"), ("# sha256", "# "), ("\n", "")])
    def test_a_changed_way_back_is_refused_and_nothing_vouches_for_it(self, record, change):
        folder = write_bundle(record)
        path = folder / "rollback.yaml"
        changed = path.read_text().replace(*change)
        path.write_text(changed)
        with pytest.raises(RunRecordError, match="does not match the digest in its first line"):
            read_rollback(record)
        write_bundle(record)
        assert path.read_text() == changed
        provenance = json.loads((folder / "provenance.json").read_text())
        assert "rollback.yaml" not in provenance["sha256"]

    def test_values_of_other_types_are_not_set_to_begin_with(self, record):
        live = {"x_drive": {"mode": "slow", "limits": [0.25], "gain": 7, "n": 9}}
        with pytest.raises(OutputError, match=r"gain: expected a value of the type of 2\.0"):
            write_bundle(record, rollback=live)

    def test_no_way_back(self, record):
        with pytest.raises(RunRecordError, match=r"rollback\.yaml: cannot be read: No such file"):
            read_rollback(record)


# ROS takes a double closer to zero than these for text, and ends a text at its first zero.
DOUBLES = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)
NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
SCALARS = st.one_of(
    st.booleans(),
    st.integers(-(2**63) + 1, 2**63 - 1),
    DOUBLES,
    st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=10),
)
LISTS = st.one_of(
    st.lists(DOUBLES, min_size=1, max_size=3),
    st.lists(st.integers(-9, 9), min_size=1, max_size=3),
)
SECTIONS = st.dictionaries(NAMES, st.one_of(SCALARS, LISTS), max_size=4)


def test_an_array_without_an_item_may_be_what_leads_back():
    values = {"drive": {"gains": [], "gain": 1.0}}
    assert from_yaml(to_yaml(values)) == values


@given(st.dictionaries(NAMES, SECTIONS, min_size=1, max_size=3))
def test_parameter_files_read_back_as_they_were_with_their_types(values):
    assert repr(from_yaml(to_yaml(values))) == repr(values)


def test_a_rollback_need_not_have_what_has_a_condition(tmp_path, make_study, function_backend):
    node = {"node": "axis"}
    study = make_study(
        parameters={
            "fast": node | {"type": "boolean", "default": False},
            "k": node
            | {"type": "double", "bounds": [0, 1], "default": 0.5, "when": {"fast": True}},
        },
        constraints={},
        budget=INITIAL,
    )
    backend = function_backend(
        study, lambda load, seed, fast, k=0.0: {"error": k + load, "peak": 0.5}
    )
    record = make_run(tmp_path / "run", study, backend, result=2)
    name = study.nodes["axis"].node
    folder = write_bundle(record)
    # Nothing was noted of the nodes: back to the default, and all that it may have.
    assert read_rollback(record) == {name: {"fast": False, "k": 0.5}}
    for values in ({"fast": False}, {"fast": True, "k": 0.25}):
        write_bundle(record, {name: values})
        assert read_rollback(record) == {name: values}
    with pytest.raises(OutputError, match="expected values of fast, k"):
        write_bundle(record, {name: {"k": 0.25}})
    of_result = yaml.safe_load((folder / "parameters.yaml").read_text())
    (own,) = of_result.values()
    assert ("k" in own["ros__parameters"]) == own["ros__parameters"]["fast"]
