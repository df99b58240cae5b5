"""What a new run knows already: parameter sets of the user's, and trials of an earlier run."""

import json

import pytest
from axis import node, write_study
from commands import run

from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.study_file import study_to_yaml


class Commands:
    """The command on a small object, whose runs lie in a folder."""

    def __init__(self, folder, study):
        self.folder = folder
        self.study = write_study(folder, study)

    def tune(self, output, *arguments):
        given = ("--quiet", "--output", self.folder / output, *arguments)
        return run("tune", *given, folder=self.folder)

    def file(self, name, text):
        path = self.folder / name
        path.write_text(text)
        return path

    def record(self, output):
        return read_run(self.folder / output / "latest")


@pytest.fixture(scope="module")
def commands(tmp_path_factory, make_study):
    seed = {"node": "axis", "parameter": "seed"}
    study = make_study(nodes=node("known_axis"), seed_parameter=seed, start=["default"])
    return Commands(tmp_path_factory.mktemp("runs"), study)


@pytest.fixture(scope="module")
def earlier(commands):
    """A run that began with sets from a file of values and from a parameter file."""
    flat = commands.file("flat.yaml", "gain: 0.3\n")
    of_nodes = "/**/axis:\n  ros__parameters: {gain: 0.7, load: 9.0}\nother:\n  a: 1\n"
    nodes = commands.file("nodes.yaml", of_nodes)
    code, _, err = commands.tune(
        "earlier", "--study", commands.study, "--backend", "inprocess", "--start", flat, nodes
    )
    assert code in (0, 3), err
    return commands.record("earlier")


def test_sets_from_files_follow_the_default(earlier):
    begun = [(t.origin, t.parameters["gain"]) for t in earlier.trials[:3]]
    assert begun == [("default", 0.5), ("start", 0.3), ("start", 0.7)]
    assert earlier.study.start == ("default", {"gain": 0.3}, {"gain": 0.7})


def test_a_run_begins_with_the_trials_of_an_earlier_one(commands, earlier):
    """Its record names where they come from, and the earlier run stays as it is."""
    more = len(earlier.trials) + 2
    code, _, err = commands.tune("later", "--from", earlier.path, "--trials", more, "--seed", 2)
    assert code in (0, 3), err
    record = commands.record("later")
    folder = str(earlier.path.resolve())
    carried, new = record.trials[:-2], record.trials[-2:]
    assert [t.parameters for t in carried] == [t.parameters for t in earlier.trials]
    assert [t.worst_cases for t in carried] == [t.worst_cases for t in earlier.trials]
    assert carried[0].origin == f"default (from {folder})"
    assert all(e.outcome.details["from"] == folder for t in carried for e in t.evaluations)
    metrics = [e.outcome.metrics for t in earlier.trials for e in t.evaluations]
    assert [e.outcome.metrics for t in carried for e in t.evaluations] == metrics
    assert not any("from" in e.outcome.details for t in new for e in t.evaluations)
    assert record.provenance["carried_from"] == folder
    assert read_run(earlier.path) == earlier
    # Of the trials that were carried on once more, the first run is still the origin.
    code, _, err = commands.tune("last", "--from", record.path, "--trials", more + 1)
    assert code in (0, 3), err
    origins = [t.origin for t in commands.record("last").trials]
    assert origins[0] == carried[0].origin
    assert origins[-2].endswith(f"(from {record.path.resolve()})")
    # And it can be resumed, as any run.
    code, _, err = commands.tune("last", "--from", record.path, "--trials", more + 1)
    summary = json.loads((commands.folder / "last" / "latest" / "summary.json").read_text())
    assert summary["trials"] == more + 1


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("gian: 0.3\n", "set.yaml:1: gian: there is no parameter 'gian'; did you mean 'gain'?"),
        ("gain: 7.0\n", "set.yaml: gain: 7.0 lies outside the bounds (0.0, 1.0)"),
        ("- 1\n", "set.yaml: expected values by name, found a list of 1"),
        ("b:\n  ros__parameters: {a: 1}\n", "set.yaml: has none of the study's parameters"),
        (None, "set.yaml: cannot be read: No such file or directory"),
    ],
)
def test_files_that_are_no_parameter_set(commands, text, problem):
    (commands.folder / "set.yaml").unlink(missing_ok=True)
    if text is not None:
        commands.file("set.yaml", text)
    code, _, err = commands.tune("refused", "--study", commands.study, "--start", "set.yaml")
    assert (code, err) == (2, f"error: {problem}\n")
    assert not (commands.folder / "refused").exists()


def test_runs_that_a_run_cannot_begin_with(commands, earlier, make_study, tmp_path):
    other = tmp_path / "other.yaml"
    wider = {"gain": {"node": "axis", "type": "double", "bounds": [0.0, 2.0], "default": 0.5}}
    study = make_study(
        nodes=node("known_axis"),
        seed_parameter={"node": "axis", "parameter": "seed"},
        parameters=wider,
    )
    other.write_text(study_to_yaml(study))
    empty = RunFolder.create(tmp_path / "empty", study)
    empty.close()
    for arguments, problem in (
        (["--study", other, "--trials", 9], "a run of another study: parameters.gain.bounds"),
        ([], f"--trials: expected more than the {len(earlier.trials)} of --from, found 5"),
        (
            ["--trials", 9, "--algorithm", "I"],
            "--algorithm: expected boundary, as in the run of --from",
        ),
        (["--resume", earlier.path], "leave one out"),
    ):
        code, _, err = commands.tune("refused", "--from", earlier.path, *arguments)
        assert (code, err.count("\n")) == (2, 1)
        assert problem in err
