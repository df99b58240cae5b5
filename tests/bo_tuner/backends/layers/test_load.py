"""What a busy computer may be blamed for."""

from dataclasses import replace

import pytest
from ten_lines import COMPLETE, FAILED, PLANNED, Machine

from bo_tuner.backends.layers.load import measured, weighed
from bo_tuner.processor_load import Load
from bo_tuner.trials import EvaluationState

GAP = 0.5
BUSY = Load(machine=0.25, nodes=0.4)
SECONDS = 4.0
"""A run in which processes waited for 0.25 * 4 s = 1 s in all."""


def test_the_load_is_measured_of_the_processes_that_there_are_by_then():
    machine, asked = Machine(FAILED), []

    def processes():
        asked.append(len(machine.ran))
        return ()

    found = measured(processes)(machine.run)(PLANNED)
    assert found == FAILED
    assert found.load is not None
    assert asked == [0, 1]


@pytest.mark.parametrize(
    ("load", "gap", "blamed"),
    [
        (BUSY, GAP, True),
        (BUSY, 1.0, True),
        (BUSY, 1.1, False),
        (Load(machine=None, nodes=0.4), 1.1, True),
        (Load(machine=0.25, nodes=0.1), GAP, False),
        (None, GAP, False),
        (BUSY, None, False),
    ],
)
def test_a_gap_is_the_computers_if_processes_waited_as_long(load, gap, blamed):
    failed = replace(FAILED, load=load).noted(gap=gap)
    found = weighed(failed, SECONDS)
    assert found.ending == ("disturbed" if blamed else "failed")
    assert found.reason == FAILED.reason + blamed * (
        "; the computer was busy: processes waited for it 40 % of the time"
    )


@pytest.mark.parametrize("state", [EvaluationState.LOST, EvaluationState.COMPLETE])
def test_only_a_failure_is_weighed(state):
    outcome = replace(COMPLETE, state=state, load=BUSY).noted(gap=GAP)
    assert weighed(outcome, SECONDS) is outcome
