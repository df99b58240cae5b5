"""Messages of a feed axis, and trials, as a recorder is handed them."""

from dataclasses import replace

import numpy as np
from rosbags.typesys import Stores, get_typestore

from bo_tuner.recording.bag import NANOSECONDS, make_topic
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    Trial,
    TrialState,
    WorstCase,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINTS = make_topic("/joint_states", "sensor_msgs/msg/JointState")
EVENTS = make_topic("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
NUMBERS = make_topic("/number", "std_msgs/msg/Float64")
START = 1_700_000_000 * NANOSECONDS
STUDY = load_study("benchmark")
PARAMETERS = STUDY.search_space().defaults
CONTEXT = {"stiffness_factor": 1.0, "damping_factor": 0.9}


def time_message(time):
    seconds, nanoseconds = divmod(time, NANOSECONDS)
    return STORE.types["builtin_interfaces/msg/Time"](seconds, nanoseconds)


def joints(time, velocity=0.0):
    header = STORE.types["std_msgs/msg/Header"](time_message(time), "")
    message = STORE.types[JOINTS.type](
        header, ["x"], np.array([]), np.array([velocity]), np.array([])
    )
    return JOINTS, bytes(STORE.serialize_cdr(message, JOINTS.type))


def event(name="node"):
    message = STORE.types[EVENTS.type](time_message(5), name, [], [], [])
    return EVENTS, bytes(STORE.serialize_cdr(message, EVENTS.type))


def scalar(value):
    return NUMBERS, bytes(STORE.serialize_cdr(STORE.types[NUMBERS.type](value), NUMBERS.type))


def evaluation_of(trial, index=0, **changes):
    metrics = {"tracking_error": 0.1, "overshoot": 0.01, "return_time": 1e-4}
    outcome = Outcome(EvaluationState.COMPLETE, metrics)
    evaluation = Evaluation(trial, index, Stage.DRAWN, PARAMETERS, CONTEXT, 7 + index, outcome)
    return replace(evaluation, **changes)


def trial_of(number, worst=0.05, state=TrialState.COMPLETE, evaluations=1):
    return Trial(
        number,
        PARAMETERS,
        "initial",
        state,
        "" if state is TrialState.COMPLETE else "stalled",
        tuple(evaluation_of(number, k) for k in range(evaluations)),
        {"overshoot": WorstCase(worst, CONTEXT, worst)} if state is TrialState.COMPLETE else {},
    )


def record(recorder, trial, best=False, samples=50):
    """Hand a trial to a recorder as a run does."""
    for evaluation in trial.evaluations:
        start = START + (100 * trial.number + evaluation.index) * 10 * NANOSECONDS
        recorder.take(*event())
        for k in range(samples):
            recorder.take(*joints(start + k * 20_000_000, 0.1 * k))
        recorder.evaluation(evaluation)
    recorder.trial(trial, best)
