"""What a new run knows already: parameter sets of the user's, and trials of an earlier run."""

import dataclasses
import json
import signal

import pytest
from axis import node, write_study
from commands import run

from bo_tuner.storage.record import read_run
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.other_space import with_bounds
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
    of_nodes = (
        "/**/axis:\n  ros__parameters: {gain: 0.7, load: 9.0}\nother:\n  ros__parameters: {a: 1}\n"
    )
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
    assert carried[0].origin == f"default (from {folder}, trial 0)"
    assert all(e.outcome.notes.carried_from == folder for t in carried for e in t.evaluations)
    metrics = [e.outcome.metrics for t in earlier.trials for e in t.evaluations]
    assert [e.outcome.metrics for t in carried for e in t.evaluations] == metrics
    assert not any(e.outcome.notes.carried_from for t in new for e in t.evaluations)
    assert record.provenance["carried_from"] == folder
    count, evaluations = len(carried), sum(len(trial.evaluations) for trial in carried)
    taken = f"{count} of {count} trials and {evaluations} of {evaluations} test runs"
    assert record.provenance["carried"] == taken
    shown = f"Begins with {taken}, of {folder}."
    assert shown in (record.path / "report.html").read_text()
    assert read_run(earlier.path) == earlier
    # Of the trials that were carried on once more, the first run is still the origin.
    code, _, err = commands.tune("last", "--from", record.path, "--trials", more + 1)
    assert code in (0, 3), err
    origins = [t.origin for t in commands.record("last").trials]
    assert origins[0] == carried[0].origin
    assert origins[-2].endswith(f"(from {record.path.resolve()}, trial {more - 1})")
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


class TestOtherBounds:
    def test_a_run_goes_on_with_wider_bounds(self, commands, earlier):
        """As many trials more as the earlier run had, with a study that says so."""
        code, _, err = run(
            "tune", "--from", earlier.path, "--bounds", "gain=-1:3.5", "--output", "wider",
            folder=commands.folder,
        )  # fmt: skip
        assert code in (0, 3), err
        record = commands.record("wider")
        assert record.study.parameters["gain"].bounds == (-1.0, 3.5)
        assert "bounds: [-1.0, 3.5]" in (record.path / "study.yaml").read_text()
        count = len(earlier.trials)
        assert record.study.budget.trials == len(record.trials) == 2 * count
        assert [t.parameters for t in record.trials[:count]] == [
            t.parameters for t in earlier.trials
        ]
        assert f"begins with {count} of {count} trials and " in err
        # Once more: as many as this run had itself.
        code, _, err = commands.tune("widest", "--from", record.path, "--bounds", "gain=-2:4")
        assert code in (0, 3), err
        assert commands.record("widest").study.budget.trials == 3 * count

    def test_narrower_ones_say_what_was_left_out(self, commands, earlier):
        inside = [t for t in earlier.trials if 0.4 <= t.parameters["gain"] <= 0.6]
        left = len(earlier.trials) - len(inside)
        code, _, err = run(
            "tune", "--from", earlier.path, "--bounds", "gain=0.4:0.6", "--trials", "7",
            "--start", commands.file("inside.yaml", "gain: 0.45\n"), "--output", "narrower",
            folder=commands.folder,
        )  # fmt: skip
        # The sets that it began with lie outside.
        assert code == 2
        assert "--bounds: start[1]: gain: 0.3 lies outside the bounds (0.4, 0.6)" in err
        study = with_bounds(dataclasses.replace(earlier.study, start=()), {"gain": (0.4, 0.6)})
        file = commands.file("narrow.yaml", study_to_yaml(study))
        code, _, err = run(
            "tune", "--from", earlier.path, "--study", file, "--trials", "7", "--output",
            "narrower", folder=commands.folder,
        )  # fmt: skip
        assert code in (0, 3), err
        record = commands.record("narrower")
        taken = f"{len(inside)} of {len(earlier.trials)} trials"
        reason = f"left out: {left} trials outside the bounds of gain"
        (line,) = [line for line in err.splitlines() if line.startswith("begins with ")]
        assert line.startswith(f"begins with {taken}")
        assert line.endswith(f"{reason}, of {earlier.path.resolve()}")
        assert record.provenance["carried"].endswith(reason)
        assert reason in (record.path / "report.html").read_text()
        assert len(record.trials) == 7

    def test_it_is_resumed_as_any_run(self, commands, earlier):
        """What was taken is on its own record; the earlier run is not asked again."""
        options = ("--from", earlier.path, "--bounds", "gain=0:2", "--trials", "8", "--quiet")
        expected = commands.tune("undisturbed", *options)
        for name, kill in (("at once", 1), ("later", 9)):
            counter = commands.folder / f"{name}.evaluations"
            code, _, _ = run(
                "tune", *options, "--output", commands.folder / name, folder=commands.folder,
                env={"CUTS": str(counter), "KILL": str(kill)},
            )  # fmt: skip
            assert code == -signal.SIGKILL
            code, _, err = run("tune", "--resume", commands.folder / name / "latest",
                folder=commands.folder)  # fmt: skip
            assert code == expected[0], err
            found, whole = commands.record(name), commands.record("undisturbed")
            assert found.trials == whole.trials
            assert found.summary["tuned"] == whole.summary["tuned"]

    @pytest.mark.parametrize(
        ("bounds", "problem"),
        [
            (["gian=1:2"], "--bounds: there is no parameter 'gian'; did you mean 'gain'?"),
            (["gain=0.8:3"], "--bounds: parameters.gain.default: 0.5 lies outside the bounds "
             "[0.8, 3.0]"),
            (["gain=3:0"], "--bounds: parameters.gain.bounds: lower bound 3.0 is not below"),
            (["gain=0:inf"], "--bounds: parameters.gain.bounds[1]: expected a finite number"),
            (["gain=0:1", "gain=0:2"], "--bounds: gain has more than one; leave all but one out"),
            (["gain=2"], "gain=2: expected NAME=LOWER:UPPER, such as kp=0.1:20"),
            (["0.1:20"], "0.1:20: expected NAME=LOWER:UPPER, such as kp=0.1:20"),
            (["gain=a:b"], "gain=a:b: expected NAME=LOWER:UPPER, such as kp=0.1:20"),
        ],
    )  # fmt: skip
    def test_bounds_that_are_none(self, commands, earlier, bounds, problem):
        given = [text for item in bounds for text in ("--bounds", item)]
        code, _, err = commands.tune("refused", "--from", earlier.path, *given)
        assert (code, err.count("\n")) == (2, 1)
        assert problem in err
        assert not (commands.folder / "refused").exists()

    def test_a_run_that_is_resumed_keeps_its_own(self, commands, earlier):
        code, _, err = commands.tune("x", "--resume", earlier.path, "--bounds", "gain=0:2")
        assert code == 2
        assert "--resume" in err

    def test_of_a_study_that_is_run_for_the_first_time(self, commands):
        code, _, err = commands.tune(
            "first", "--study", commands.study, "--backend", "inprocess", "--bounds", "gain=0.2:0.9"
        )
        assert code in (0, 3), err
        record = commands.record("first")
        assert record.study.parameters["gain"].bounds == (0.2, 0.9)
        assert all(0.2 <= trial.parameters["gain"] <= 0.9 for trial in record.trials)


def test_runs_that_a_run_cannot_begin_with(commands, earlier, make_study, tmp_path):
    other = tmp_path / "other.yaml"
    study = make_study(
        nodes=node("known_axis"),
        seed_parameter={"node": "axis", "parameter": "seed"},
        trigger={"node": "axis", "service": "~/begin"},
    )
    other.write_text(study_to_yaml(study))
    same = tmp_path / "same.yaml"
    same.write_text(study_to_yaml(earlier.study))
    empty = RunFolder.create(tmp_path / "empty", study)
    empty.close()
    for arguments, problem in (
        (["--study", other, "--trials", 9], "a run of another study: trigger.service"),
        (
            ["--study", same],
            f"--trials: expected more than the {len(earlier.trials)} of --from, found 5",
        ),
        (["--trials", 4], f"--trials: expected more than the {len(earlier.trials)} of --from"),
        (
            ["--trials", 9, "--algorithm", "I"],
            "--algorithm: expected boundary, as in the run of --from",
        ),
        (["--resume", earlier.path], "leave one out"),
    ):
        code, _, err = commands.tune("refused", "--from", earlier.path, *arguments)
        assert (code, err.count("\n")) == (2, 1)
        assert problem in err
