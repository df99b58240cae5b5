"""The rest of a machine ahead of a run."""

from ten_lines import COMPLETE, FAILED, PLANNED, Machine

from bo_tuner.backends.layers.rest import rested


def test_the_run_comes_after_the_rest():
    machine = Machine()

    def rest():
        assert machine.ran == []
        return 1.23456, None

    assert rested(rest)(machine.run)(PLANNED) == COMPLETE.noted(rested_seconds=1.235)
    assert machine.ran == [PLANNED]


def test_a_machine_that_does_not_come_to_rest_is_not_run():
    machine = Machine()
    assert rested(lambda: (0.0, FAILED))(machine.run)(PLANNED) == FAILED
    assert machine.ran == []
