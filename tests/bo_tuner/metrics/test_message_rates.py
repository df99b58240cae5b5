"""How often messages come, by the first runs of a study, and what a silence makes of a run."""

import numpy as np
import pytest
from signal_runs import signal_study

from bo_tuner.metrics.message_rates import MessageRates, rate_of, used_signals
from bo_tuner.metrics.recording import FailedRunError, RecordedSignal, Recording
from bo_tuner.run_notes import Notes
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import EvaluationState, Outcome

END = 2.0
EVEN = np.arange(200) * 0.01
"""Times [s] of messages at 100 Hz, the first one at 0."""


def study(**angle):
    mapping = signal_study()
    mapping["signals"]["angle"] = mapping["signals"]["angle"] | angle
    # It is told once.
    mapping["signals"]["setpoint"] = mapping["signals"]["setpoint"] | {"minimum_messages": 0}
    return study_from_mapping(mapping)


def recording(times, end=END):
    times = np.asarray(times, dtype=float)
    once = RecordedSignal(np.array([0.0]), np.array([1.0]))
    return Recording({"angle": RecordedSignal(times, np.ones_like(times)), "setpoint": once}, end)


def outcome(rates, heard, state=EvaluationState.COMPLETE):
    return Outcome(state, notes=Notes(rates=rates.of(heard)))


def after(*runs, of=None):
    """The rates of a study after runs with messages at these times."""
    rates = MessageRates(of or study())
    for times in runs:
        rates.note(outcome(rates, recording(times)))
    return rates


def verdict(rates, times, of=None):
    """What becomes of a run: `failed`, `noted` or `whole`."""
    heard = recording(times)
    try:
        heard.check((of or study()).signals, rates.largest_gaps)
    except FailedRunError:
        return "failed"
    return "noted" if rates.remarks(heard) else "whole"


FROZEN = EVEN[EVEN < 1.2]
"""Of a node that freezes at 1.2 s."""
STALLED = EVEN[(EVEN < 0.5) | (EVEN > 0.675)]
"""182 of 200 messages."""
EXPECTED = [
    (EVEN, "whole"),
    (EVEN[(EVEN < 0.5) | (EVEN > 0.545)], "whole"),
    (STALLED, "noted"),
    (np.delete(EVEN, np.arange(5, 200, 10)), "noted"),
    (EVEN[(EVEN < 0.5) | (EVEN > 0.95)], "noted"),
    (FROZEN, "failed"),
    (EVEN[EVEN < 0.05], "failed"),
    (EVEN[EVEN > 0.8], "failed"),
    (np.concatenate([EVEN[EVEN < 0.5], EVEN[EVEN > 1.3]]), "failed"),
]
IDS = "even|short stall|long stall|every tenth lost|half a second|frozen|at once|late|for a while"


@pytest.mark.parametrize(("times", "expected"), EXPECTED, ids=IDS.split("|"))
def test_a_run_after_three_even_ones(times, expected):
    assert verdict(after(EVEN, EVEN, EVEN), times) == expected


def test_jitter_of_a_busy_machine_is_nothing():
    """Each message late by up to 8 of the 10 ms between two of them."""
    rng = np.random.default_rng(1)
    jittered = [np.sort(EVEN + rng.uniform(0.0, 0.008, len(EVEN))) for _ in range(5)]
    rates = after(*jittered[:3])
    assert [verdict(rates, times) for times in [*jittered[3:], FROZEN]] == [
        "whole",
        "whole",
        "failed",
    ]


@pytest.mark.parametrize(
    "times",
    [
        [0.0],
        [0.1, 0.2, 0.9],
        np.concatenate([EVEN[:60], [1.9]]),
        np.concatenate([0.3 * k + EVEN[:8] for k in range(6)]),
    ],
    ids=["once", "few", "on a change", "in bursts"],
)
def test_what_is_sporadic_by_design_may_be_silent(times):
    rates = after(times, times, times)
    assert rates.largest_gaps == {}
    assert rates.remarks(recording([0.0])) == []
    assert verdict(rates, EVEN[:50]) == "whole"


@pytest.mark.parametrize("rate", [15, 100, 1000])
def test_messages_that_come_at_random_are_as_usual(rate):
    """In 40 runs, by a Poisson process of `rate` messages a second."""
    rng = np.random.default_rng(2)

    def run():
        return np.sort(rng.uniform(0.0, END, rng.poisson(rate * END)))

    rates = after(run(), run(), run())
    found = [verdict(rates, run()) for _ in range(40)]
    # A gap of twice the largest of three runs comes now and then where there are few messages.
    assert "failed" not in found
    assert found.count("whole") >= 38


@pytest.mark.parametrize("times", [FROZEN, STALLED])
def test_in_the_first_runs_a_signal_is_compared_with_itself(times):
    """A run is not made to fail by itself alone: who knows that it is not by design."""
    assert verdict(after(), times) == "noted"
    assert verdict(after(EVEN, EVEN), EVEN) == "whole"


def test_one_of_the_first_runs_may_be_the_one_that_stalls():
    assert verdict(after(EVEN, FROZEN, EVEN), FROZEN) == "failed"


def test_only_complete_runs_show_what_is_usual():
    rates = MessageRates(study())
    for _ in range(3):
        rates.note(outcome(rates, recording(EVEN), EvaluationState.FAILED))
    assert rates.largest_gaps == {}


def test_a_resumed_run_has_the_same_limits():
    """Whatever came after the first three runs, and to the last bit."""
    rng = np.random.default_rng(3)
    runs = [np.sort(EVEN + rng.uniform(0.0, 0.008, len(EVEN))) for _ in range(6)]
    at_once, of_record = MessageRates(study()), MessageRates(study())
    record = []
    for times in runs:
        record.append(outcome(at_once, recording(times)))
        at_once.note(record[-1])
        if len(record) == 3:
            limits = at_once.largest_gaps
    for known in record:
        of_record.note(known)
    assert at_once.largest_gaps == of_record.largest_gaps == limits != {}


@pytest.mark.parametrize("own", [{"largest_gap": 1.0}, {"minimum_messages": 0}])
def test_a_signal_with_a_limit_of_its_own_is_judged_by_that_alone(own):
    made = study(**own)
    rates = after(EVEN, EVEN, EVEN, of=made)
    assert verdict(rates, FROZEN, made) == "whole"


def test_a_signal_that_nothing_is_made_of_fails_no_run():
    mapping = signal_study()
    mapping["signals"]["unused"] = {"topic": "/unused", "field": "data"}
    made = study_from_mapping(mapping)
    assert used_signals(made) == {"setpoint", "angle"}
    aborting = signal_study(run={"end": {"after": 2.0}, "abort_when": "unused > 1 and t > 0.1"})
    aborting["signals"] = mapping["signals"]
    assert used_signals(study_from_mapping(aborting)) - {"t"} == {"setpoint", "angle", "unused"}


def test_a_bag_has_its_own_gaps():
    run = {"clock": "sim", "start": [{"play": "drive"}], "end": "played"}
    played = study_from_mapping(signal_study(run=run))
    assert verdict(after(EVEN, EVEN, EVEN, of=played), FROZEN, of=played) == "whole"


def test_what_is_said_of_a_gap():
    rates = after(EVEN, EVEN, EVEN)
    noted = rates.remarks(recording(STALLED))
    assert noted == [
        "signal angle (/joint_states) has no message for 0.19 s from 0.490 s on, usually one every "
        "0.01 s"
    ]
    few = rates.remarks(recording(np.delete(EVEN, np.arange(5, 200, 10))))
    assert few == ["signal angle (/joint_states) has 180 messages, usually about 200"]
    with pytest.raises(FailedRunError) as caught:
        recording(FROZEN).check(study().signals, rates.largest_gaps)
    assert str(caught.value).startswith(
        "signal angle (/joint_states) has no message for 0.81 s from 1.190 s on, expected one at "
        "least every 0.5 s, as in the first runs"
    )


def test_the_rate_of_a_signal():
    rate = rate_of(recording(FROZEN).signals["angle"], END)
    found = (rate.messages, rate.distance, rate.most, rate.gap, rate.duration)
    assert found == pytest.approx((120, 0.01, 0.01, 0.81, 2.0))
    assert rate_of(recording(EVEN[:9]).signals["angle"], END) is None
