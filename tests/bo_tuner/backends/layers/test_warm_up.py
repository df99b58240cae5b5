"""Runs that warm a machine up ahead of others."""

from dataclasses import replace

import pytest
from ten_lines import COMPLETE, FAILED, PLANNED, Machine

from bo_tuner.backends.layers.warm_up import warm_up_runs, warmed_up
from bo_tuner.run_notes import Death, Notes, Unusable
from bo_tuner.trials import EvaluationState, Outcome, Stage

AFTER = 60.0
WARMING = [replace(PLANNED, index=k, seed=k) for k in range(2)]


def warm(machine, ended=lambda: None):
    return warmed_up(WARMING, AFTER, machine.run, ended, machine.clock)(machine.run)


def test_they_come_first_and_count_nothing():
    machine = Machine()
    ended = []
    run = warm(machine, lambda: ended.append(len(machine.ran)))
    assert run(PLANNED) == COMPLETE.noted(warm_ups=2, warm_up_seconds=2.0)
    assert machine.ran == [*WARMING, PLANNED]
    assert ended == [1, 2]
    assert run(PLANNED) == COMPLETE
    assert machine.ran == [*WARMING, PLANNED, PLANNED]


@pytest.mark.parametrize(("seconds", "is_cold"), [(AFTER, False), (AFTER + 0.5, True)])
def test_a_break_counts_from_the_end_of_a_run(seconds, is_cold):
    machine = Machine()
    machine.takes = 2.0 * AFTER
    run = warm(machine)
    run(PLANNED)
    machine.now += seconds
    assert run(PLANNED).notes.warm_ups == 2 * is_cold


@pytest.mark.parametrize(
    ("ended", "ending"),
    [
        (FAILED, "unprepared"),
        (Outcome(EvaluationState.LOST, reason="gone", notes=Notes(death=Death("axis"))), "lost"),
        (replace(FAILED, notes=Notes(unusable=Unusable.DISTURBED)), "disturbed"),
    ],
)
def test_where_one_fails_nothing_is_known_of_the_evaluation(ended, ending):
    machine = Machine(COMPLETE, ended)
    run = warm(machine)
    found = run(PLANNED)
    assert (found.ending, found.unusable, found.metrics) == (ending, True, {})
    assert found.reason == f"run 2 of 2 to warm up: {ended.reason}"
    assert found.notes.death is None, "it did not die of the parameters of the evaluation"
    assert machine.ran == WARMING
    assert run(PLANNED).notes.warm_ups == 2, "the machine is still cold"


def test_they_have_the_parameters_that_the_search_begins_with(make_study):
    first, second = warm_up_runs(make_study(start=[{"gain": 0.25}, {"gain": 0.75}]), 2)
    assert [dict(run.parameters) for run in (first, second)] == [{"gain": 0.25}] * 2
    assert {run.stage for run in (first, second)} == {Stage.NOMINAL}
    # The middle of a uniform distribution on [1, 2].
    assert first.context == second.context == {"load": 1.5}
    assert first.seed != second.seed
    (default,) = warm_up_runs(make_study(start=[]), 1)
    assert dict(default.parameters) == {"gain": 0.5}
