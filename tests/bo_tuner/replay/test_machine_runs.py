"""Runs of a machine, from run folders and bags, and what is no run of the machine."""

import json

import pytest
import yaml
from functions import NODE, FunctionBackend, failed, make_study
from made_runs import INITIAL, make_run
from signal_runs import record_run, recording, signal_study

from bo_tuner.errors import RunRecordError
from bo_tuner.replay.machine_runs import machine_runs
from bo_tuner.study.study_file import study_from_mapping

SIMULATED = make_study()
MACHINE = make_study(contexts={}, budget=INITIAL)


def machine(gain, seed):
    """A machine that fails with large gains."""
    if gain > 0.6:
        return failed("stalled")
    return {"error": gain, "peak": 2.0 * gain}


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    return make_run(
        tmp_path_factory.mktemp("machine") / "run", MACHINE, FunctionBackend(MACHINE, machine)
    )


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    study = study_from_mapping(signal_study())
    path = tmp_path_factory.mktemp("bags") / "run"
    record_run(path, study, {0.5: [recording(0), recording(1)], 0.7: [recording(2)]})
    return path / "bags"


def test_the_runs_of_a_folder(record):
    runs = machine_runs([record.path], SIMULATED)
    complete = [e for e in record.evaluations if e.outcome.complete]
    assert 0 < len(complete) < len(record.evaluations)
    assert runs.count == len(complete)
    assert runs.left_out == len(record.evaluations) - len(complete)
    assert runs.metrics == ("error", "peak")
    for key, metrics in runs.sets.items():
        assert {m["error"] for m in metrics} == {dict(key)["gain"]}


def test_the_runs_of_a_trial(record):
    number = next(t.number for t in record.trials if t.parameters["gain"] <= 0.6)
    runs = machine_runs([record.path], SIMULATED, trial=number)
    assert runs.count == len(record.trials[number].evaluations)
    with pytest.raises(RunRecordError, match="has no complete run of trial 99"):
        machine_runs([record.path], SIMULATED, trial=99)


def test_the_runs_of_a_bag_are_those_of_its_folder(bags):
    """What a simulator reports is compared with what the machine's signals give."""
    simulated = make_study(metrics={"error": NODE, "peak": NODE})
    both = machine_runs(sorted(bags.glob("trial_*")), simulated)
    assert both.metrics == ("error",)
    assert both.sets == machine_runs([bags.parent], simulated).sets
    assert both.count == 3
    assert machine_runs([bags / "trial_0001"], simulated).count == 1


def test_measured_times_are_compared_only_if_asked_for(record):
    study = make_study(metrics={"error": NODE, "peak": NODE | {"reproducible": False}})
    assert machine_runs([record.path], study).metrics == ("error",)
    assert machine_runs([record.path], study, ["peak"]).metrics == ("peak",)


def test_metrics_of_another_machine(record):
    study = make_study(
        metrics={"error": NODE | {"key": "x"}, "force": NODE, "peak": NODE},
        constraints={},
    )
    assert machine_runs([record.path], study).metrics == ("error", "peak")
    with pytest.raises(RunRecordError, match="another machine: expected the metric force, found"):
        machine_runs([record.path], study, ["force"])
    other = make_study(metrics={"force": NODE}, objective={"metric": "force"}, constraints={})
    with pytest.raises(RunRecordError, match="another machine: expected the metric force, found"):
        machine_runs([record.path], other)


def test_metrics_in_another_unit(record, tmp_path):
    metrics = {"error": NODE | {"unit": "mm"}, "peak": NODE}
    study = make_study(contexts={}, budget=INITIAL, metrics=metrics)
    run = make_run(tmp_path / "run", study, FunctionBackend(study, machine))
    simulated = make_study(metrics={"error": NODE | {"unit": "m"}, "peak": NODE})
    with pytest.raises(RunRecordError, match="metric error is in mm; expected m, as in the study"):
        machine_runs([run.path], simulated)


@pytest.mark.parametrize("source", ["run", "bag"])
def test_parameters_of_another_machine(record, bags, source):
    path = record.path if source == "run" else bags / "trial_0000"
    double = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
    more = make_study(parameters={"gain": double, "damping": double})
    with pytest.raises(RunRecordError, match="of another machine: with no damping; expected the"):
        machine_runs([path], more)
    other = make_study(parameters={"damping": double})
    with pytest.raises(RunRecordError, match="no damping and gain, which the study does not have"):
        machine_runs([path], other)


def test_a_run_in_contexts_that_the_tuner_has_set(tmp_path):
    study = make_study(budget=INITIAL)
    run = make_run(
        tmp_path / "run", study, FunctionBackend(study, lambda gain, load, seed: machine(gain, 0))
    )
    with pytest.raises(RunRecordError, match=r"has set a context in its runs \(load\)"):
        machine_runs([run.path], SIMULATED)


@pytest.mark.parametrize(
    ("evaluations", "why"),
    [
        (None, "expected a bag of a run of tune"),
        ("[{}]", "'parameters'"),
        ("{", "Expecting property name"),
        (json.dumps([{"parameters": {"gain": [1]}}]), "expected a value"),
    ],
)
def test_a_bag_without_readable_parameters(bags, tmp_path, evaluations, why):
    bag = tmp_path / "bag"
    bag.mkdir()
    data = {} if evaluations is None else {"evaluations": evaluations, "trial": "0"}
    content = {"rosbag2_bagfile_information": {"custom_data": data}}
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(RunRecordError, match="the parameters of its runs cannot be read") as caught:
        machine_runs([bag], SIMULATED)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_run_and_no_complete_run(tmp_path):
    with pytest.raises(RunRecordError, match="no such run folder"):
        machine_runs([tmp_path / "nowhere"], SIMULATED)
    run = make_run(
        tmp_path / "run", MACHINE, FunctionBackend(MACHINE, lambda **_: failed("no power"))
    )
    with pytest.raises(RunRecordError, match="has no complete run"):
        machine_runs([run.path], SIMULATED)
