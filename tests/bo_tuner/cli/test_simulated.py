"""`tune --from RUN --simulated`: on a machine that knows its simulation."""

import json
import shutil
import sqlite3

import pytest
from axis import node
from command_runs import Runs
from commands import run

from bo_tuner.storage.record import read_run
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.tuning.summary import summary_from_record

LOAD = "getattr(self, 'load', 1.9)"
"""Of the machine, where nobody can set it; in the simulation it is 1.5 in the mean."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory, make_study):
    """A run of the simulation, and a study of the machine."""
    folder = tmp_path_factory.mktemp("runs")
    seed = {"node": "axis", "parameter": "seed"}
    study = make_study(nodes=node("counting_axis"), seed_parameter=seed)
    error = f"25 * (self.gain - 0.3) ** 2 + {LOAD} * (1 + 0.001 * (self.seed % 100))"
    made = Runs(folder, study, error=error, peak=f"{LOAD} * self.gain")
    code, _, err = made.begin("simulation", "--trials", 8)
    assert code == 0, err
    machine = make_study(
        name="machine", nodes=node("counting_axis"), seed_parameter=seed, contexts=None
    )
    (folder / "machine.yaml").write_text(study_to_yaml(machine))
    return made


@pytest.fixture(scope="module")
def whole(runs):
    """A run on the machine, with its output."""
    code, out, err = on_machine(runs, "whole")
    assert code == 0, err
    return out + err


def on_machine(runs, name, *options, kill=0):
    known = ("--from", runs.latest("simulation"), "--simulated")
    given = ("--study", "machine.yaml", "--backend", "inprocess", "--output", name)
    return runs.run(name, *given, *known, *options, kill=kill)


def test_the_bias_is_shown(runs, whole):
    assert "Machine and simulation, by the models of both, at these values: error" in " ".join(
        whole.split()
    )
    folder = runs.latest("whole")
    summary = json.loads((folder / "summary.json").read_text())
    error, peak = summary["biases"]
    gain = read_run(folder.resolve()).result.parameters["gain"]
    assert (error["metric"], peak["metric"]) == ("error", "peak")
    assert error["low"] < 0.4 < error["high"]
    assert peak["low"] < 0.4 * gain < peak["high"]
    assert "on the machine" in (folder / "report.html").read_text()


def test_its_trials_are_none_of_the_simulation(runs, whole):
    record = read_run(runs.latest("whole").resolve())
    assert "knows 8 of 8 trials" in whole
    assert len(record.simulation) == 8
    assert len(record.trials) == record.study.budget.trials == 5
    best = read_run(runs.latest("simulation").resolve()).result
    assert record.trials[0].parameters["gain"] == best.parameters["gain"]
    assert record.study.budget.initial_trials == 1


@pytest.mark.parametrize("kill", [2, 6])
def test_after_a_kill_the_run_is_the_same(runs, whole, kill):
    name = f"killed{kill}"
    on_machine(runs, name, kill=kill)
    code, _, err = runs.resume(name)
    assert code == 0, err
    assert runs.results(name) == runs.results("whole")


def test_its_summary_can_be_made_again(runs, whole):
    record = read_run(runs.latest("whole").resolve())
    made = summary_from_record(record)
    assert made["biases"]
    assert {key: record.summary[key] for key in made} == made


def test_a_report_is_made_again(runs, whole):
    folder = runs.latest("whole")
    code, _, err = run("report", folder, "--output", "again.html", folder=runs.folder)
    assert code == 0, err
    assert "Machine and simulation" in (runs.folder / "again.html").read_text()


def test_a_run_that_has_lost_what_it_knew_is_refused(runs, whole):
    runs.copy("whole", "lost")
    (runs.latest("lost") / "simulation.sqlite").unlink()
    code, _, err = runs.resume("lost")
    assert code == 2
    assert "simulation.sqlite: no journal there" in err


def test_one_that_is_damaged_is_refused(runs, whole):
    runs.copy("whole", "damaged")
    path = runs.latest("damaged") / "simulation.sqlite"
    shutil.copyfile(runs.latest("damaged") / "best.yaml", path)
    code, _, err = runs.resume("damaged")
    assert code == 2
    assert "simulation.sqlite" in err


def test_one_of_another_run_is_refused(runs, whole):
    """Whatever is in it: a resumed run is to know what it knew."""
    runs.copy("whole", "other")
    other = runs.latest("simulation") / "journal.sqlite"
    shutil.copyfile(other, runs.latest("other") / "simulation.sqlite")
    for command in (["tune", "--resume"], ["report"]):
        code, _, err = run(*command, runs.latest("other"), folder=runs.folder)
        assert code == 2
        assert "simulation.sqlite: is not the file that the run began with; restore it" in err


def test_a_further_run_begins_without_the_simulation(runs, whole):
    """Its models have another dimension, so that nothing of their fits is taken along."""
    options = ("--from", runs.latest("whole"), "--trials", 7, "--output", "further")
    code, _, err = runs.run("further", *options)
    assert code == 0, err
    record = read_run(runs.latest("further").resolve())
    assert (len(record.trials), record.simulation) == (7, ())


def test_a_simulation_without_its_summary_has_its_result_all_the_same(runs, whole):
    runs.copy("simulation", "unsummed")
    (runs.latest("unsummed") / "summary.json").unlink()
    given = ("--study", "machine.yaml", "--backend", "inprocess", "--output", "again")
    code, _, err = runs.run("again", *given, "--from", runs.latest("unsummed"), "--simulated")
    assert code == 0, err
    assert "missing; made from the journal" in err
    assert (runs.latest("again") / "trials.csv").read_bytes() == (
        runs.latest("whole") / "trials.csv"
    ).read_bytes()


@pytest.mark.parametrize("options", [["--simulated", "--study", "machine.yaml"], ["--trials", 9]])
def test_a_damaged_record_is_named(runs, whole, options):
    name = f"broken{len(options)}"
    runs.copy("simulation", name)
    with sqlite3.connect(runs.latest(name) / "journal.sqlite") as db:
        db.execute("UPDATE evaluation SET seed = seed + 1 WHERE trial = 6")
    backend = ("--backend", "inprocess", "--output", f"{name}_on")
    code, _, err = runs.run(f"{name}_on", "--from", runs.latest(name), *options, *backend)
    assert code in (0, 3), err
    assert "warning: the record of --from was damaged: journal.sqlite" in err


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--simulated"], "--simulated needs --from: the run of the simulation"),
        (["--from", "RUN", "--simulated"], "--simulated needs --study: that of the machine"),
        (
            ["--from", "RUN", "--simulated", "--study", "machine.yaml", "--algorithm", "IV"],
            "--simulated: IV takes no runs of a simulation; expected boundary",
        ),
    ],
)
def test_bad_options(runs, options, problem):
    given = [str(runs.latest("simulation")) if each == "RUN" else each for each in options]
    code, _, err = run("tune", "--backend", "inprocess", *given, folder=runs.folder)
    assert code == 2
    assert problem in " ".join(err.split())
    assert "Traceback" not in err
