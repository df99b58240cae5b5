"""The Pareto front in the terminal."""

import io
from pathlib import Path

from rich.console import Console

from bo_tuner.monitoring.front import print_front
from bo_tuner.optimizers.ranking import Candidate
from bo_tuner.tuning.front import pareto_front


def test_an_empty_front_tells_what_a_point_of_it_needs(make_study, make_trial):
    """The models believe the only trial feasible, which broke the limit itself."""
    study = make_study(further_objectives=[{"metric": "peak"}])
    broke = Candidate(make_trial(0, {"gain": 0.5}, [1.0], worst=1.2), 1.0, 0.9, 0.0, 0.0, 0.0, 0.5)
    assert broke.believed_feasible
    front = pareto_front(study, [broke])
    assert front == []
    out = Console(file=io.StringIO(), width=60)
    print_front(out, study, front, 0, Path("runs/a b"))
    assert out.file.getvalue() == (
        "each parameter set that is likely within limits broke a limit in its own test runs, so "
        "there is no Pareto front\n"
    )
