import time

import pytest

from bo_tuner.tuning.loop import Tuning
from tuning_benchmark.campaign import cost


@pytest.fixture
def passed(monkeypatch):
    """Spans of processor time [s] that have passed; a test appends to them."""
    spans = []
    monkeypatch.setattr(time, "process_time", lambda: sum(spans))
    return spans


def test_cost_is_that_of_the_optimizer_at_the_marks(monkeypatch, passed):
    evaluate = cost.Valley.evaluate

    def evaluated(valley):
        passed.append(100.0)
        return evaluate(valley)

    def optimized(*arguments):
        for trial in Tuning(*arguments):
            passed.append(1.5)
            yield trial

    monkeypatch.setattr(cost.Valley, "evaluate", evaluated)
    monkeypatch.setattr(cost, "Tuning", optimized)
    result = cost.cost_of_run("IV", 3, 1, [4, 22])
    assert passed.count(100.0) > 22
    assert result == {"trials": [4, 22], "seconds": [6.0, 33.0]}
