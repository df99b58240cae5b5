"""What drives that were not used show of those to come, against closed forms and simulation."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from bo_tuner.evidence.next_drive import (
    DriveRun,
    NextDrive,
    attempt_in,
    drives_problem,
    least_drives,
    share_shown,
    write_next_drive,
)
from bo_tuner.numerics.sequential import spent


def of(within, beyond=0, confidence=0.95, asked=0.9):
    runs = [DriveRun(f"drive_{k}", {}, {}, ()) for k in range(within)]
    runs += [DriveRun(f"other_{k}", {}, {}, ("error",)) for k in range(beyond)]
    return NextDrive({}, tuple(runs), confidence, asked, further=confidence)


@pytest.mark.parametrize(("count", "average", "share"), [(5, 0.8333, 0.549), (29, 0.9667, 0.902)])
def test_the_worst_of_several(count, average, share):
    made = of(count)
    assert made.no_worse_on_average == pytest.approx(average, abs=1e-4)
    assert made.no_worse == pytest.approx(share, abs=1e-3)
    assert made.no_worse == pytest.approx(0.05 ** (1.0 / count))


def test_how_many_it_takes():
    """Of drives within the limits, 29 show 90 % and 59 show 95 %, with 95 % confidence."""
    assert of(5).missing == 24
    assert of(29).passed
    assert not of(28).passed
    assert of(1, asked=0.95).missing == 58
    # One beyond the limits takes many more.
    assert of(5, 1).missing == 46 - 6
    assert of(45, 1).passed
    # The first call has 4 % of the 5 %: 0.9^31 < 0.04 < 0.9^30.
    assert least_drives(0.9, spent(0.95, 1)) == 31


def test_the_bound_is_exact():
    """If so large a share is within the limits, so many or more are with the error probability."""
    for within, count in ((3, 5), (17, 20), (58, 59)):
        share = share_shown(within, count, 0.9)
        assert binom.sf(within - 1, count, share) == pytest.approx(0.1)
    assert share_shown(0, 5, 0.9) == 0.0


def test_a_pass_that_is_false_is_as_rare_as_said():
    """Where just the share that is asked for is not reached, a PASS comes in 5 % at most."""
    rng = np.random.default_rng(1)
    for count in (29, 46, 80):
        within = rng.binomial(count, 0.9 - 1e-9, 4000)
        passes = [share_shown(int(k), count, 0.95) >= 0.9 for k in within]
        # Three standard errors above 5 %.
        assert np.mean(passes) < 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / 4000)


def test_more_drives_until_one_passes():
    """What is called again and again gets less of the error probability each time."""
    spending = [1.0 - spent(0.95, attempt) for attempt in range(1, 2000)]
    assert sum(spending) < 0.05


def test_what_opens_apply(tmp_path):
    """The latest statement on the parameter set; one on another set is no matter."""
    trial = SimpleNamespace(number=3, parameters={"gain": 0.5})
    record = SimpleNamespace(path=tmp_path)
    assert "run validate --drives" in drives_problem(record, trial)
    passing, failing = replace(of(29), parameters=trial.parameters), of(5)
    write_next_drive(tmp_path, attempt_in(tmp_path), passing)
    assert attempt_in(tmp_path) == 2
    write_next_drive(tmp_path, 2, replace(failing, parameters={"gain": 0.7}))
    assert drives_problem(record, trial) == ""
    # Too few, of which none is beyond a limit, say nothing against it.
    write_next_drive(tmp_path, 3, replace(failing, parameters=trial.parameters))
    assert drives_problem(record, trial) == ""
    worse = replace(of(28, 1), parameters=trial.parameters)
    path = write_next_drive(tmp_path, 4, worse)
    assert drives_problem(record, trial) == f"{path}: expected PASS, found FAIL"
    path.write_text("{", encoding="utf-8")
    assert drives_problem(record, trial).startswith(f"{path}: cannot be read")
