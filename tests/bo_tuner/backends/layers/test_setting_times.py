"""How long it took until nodes had the values of a run."""

import pytest
from ten_lines import COMPLETE, PLANNED, Machine

from bo_tuner.backends.layers.setting_times import ramped, with_starts


def test_the_way_of_the_run_before_does_not_count():
    machine = Machine()
    machine.now, taken = 5.0, [0.0]

    def take():
        seconds, taken[0] = machine.now - taken[0], machine.now
        return seconds

    run = ramped(take)(machine.run)
    assert run(PLANNED) == COMPLETE.noted(ramped_seconds=1.0)
    machine.now += 10.0
    assert run(PLANNED) == COMPLETE.noted(ramped_seconds=1.0)


@pytest.mark.parametrize(
    ("starts", "noted"),
    [([], {}), ([0.5, 1.0], {"starts": 2, "start_seconds": 1.5})],
)
def test_starts_are_counted_and_timed(starts, noted):
    assert with_starts(lambda: starts)(Machine().run)(PLANNED) == COMPLETE.noted(**noted)
