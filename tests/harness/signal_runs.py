"""Runs whose metrics are those of recorded signals: a study of them, and their record."""

import numpy as np

from bo_tuner.metrics.collect import Collector
from bo_tuner.metrics.recording import RecordedSignal, Recording
from bo_tuner.metrics.signal_sources import signal_sources
from bo_tuner.recording.recorder import Recorder
from bo_tuner.recording.retention import Policy, RecordOptions
from bo_tuner.storage.journal import Journal
from bo_tuner.storage.provenance import STUDY_YAML
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.trials import Evaluation, Stage, Trial, TrialState

NODE = {"node": "servo"}
SETPOINT = {"topic": "/setpoint", "field": "data"}
ANGLE = {"topic": "/joint_states", "field": "position[motor]"}


def signal_study(**sections):
    """Mapping of a study of the node `servo`, whose gain decides how it follows a setpoint."""
    return {
        "name": "servo",
        "nodes": {"servo": NODE},
        "parameters": {"gain": NODE | {"type": "double", "bounds": [0, 3], "default": 0.5}},
        "signals": {"setpoint": SETPOINT, "angle": ANGLE},
        "run": {"end": {"after": 2.0}},
        "metrics": {"error": {"of": "setpoint - angle", "measure": "iae"}},
        "objective": {"metric": "error"},
        "budget": {"trials": 1, "initial_trials": 1},
    } | sections


def recording(seed):
    """Signals at odd times, of which one began before the run."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, 2.0, 200))
    angle = RecordedSignal(
        time, 1.0 - np.exp(-3.0 * time) + rng.normal(0.0, 0.01, 200), lost=2, late=1
    )
    return Recording(
        {"setpoint": RecordedSignal(np.array([-0.1, 0.1]), np.array([1.0, 1.0])), "angle": angle},
        2.0,
    )


def outcome_of(study, recording):
    """The metrics of a recording."""
    with signal_sources(study, lambda: recording) as sources:
        return Collector(study, sources).outcome({})


def record_run(path, study, recordings):
    """Write a run folder with a trial for each gain, and the bags of its recordings."""
    path.mkdir()
    (path / "study.yaml").write_text(study_to_yaml(study))
    recorder = Recorder(path / "bags", study, RecordOptions(Policy.ALL))
    trials = []
    for number, (gain, heard) in enumerate(recordings.items()):
        parameters, evaluations = {"gain": gain}, []
        for index, recording in enumerate(heard):
            outcome = outcome_of(study, recording)
            evaluations.append(
                Evaluation(number, index, Stage.DRAWN, parameters, {}, index, outcome)
            )
            recorder.evaluation(evaluations[-1], recording)
        trials.append(
            Trial(number, parameters, "", TrialState.COMPLETE, evaluations=tuple(evaluations))
        )
        recorder.trial(trials[-1], best=True)
    summary = recorder.close()
    assert summary["bags"] == [f"trial_{trial.number:04d}" for trial in trials], summary
    provenance = {"algorithm": "IV", "backend": "ros", STUDY_YAML: study_to_yaml(study)}
    Journal(path / "journal.sqlite", provenance, trials).close()
    return path
