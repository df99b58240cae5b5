"""The draws of the verdict as empirical distributions."""

import dataclasses

import numpy as np
import pytest

from bo_tuner.figures.figure import Limit, Line
from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.draws import draws
from bo_tuner.trials import Stage


def test_the_share_above_the_limit_is_that_of_the_record(analysis):
    section = draws(analysis)
    assert section is not None
    (panel,) = section.figures[0].panels
    (limit,) = [e for e in panel.elements if isinstance(e, Limit)]
    assert (limit.value, limit.vertical) == (1.0, True)
    lines = {e.name: e for e in panel.elements if isinstance(e, Line)}
    # No line is at the border, where half of it would be seen, and the axis begins at 0.
    seen = [limit.value, *(x for line in lines.values() for x in line.x)]
    low, high = panel.x.limits
    assert 0.0 == low < min(seen) <= max(seen) < high
    for side, name in enumerate(("default", "tuned")):
        values = [
            e.outcome.metrics["peak"]
            for e in analysis.record.evaluations
            if e.stage is Stage.VALIDATION and e.trial == side and e.outcome.metrics
        ]
        line = lines[name]
        assert sorted(values) == pytest.approx(list(line.x[1:]))
        within = np.asarray(line.y)[np.asarray(line.x) <= 1.0]
        share = within[-1] if len(within) else 0.0
        budget = analysis.study.budget.validation_draws
        assert share == pytest.approx(100.0 * sum(v <= 1.0 for v in values) / budget)


def test_a_bound_is_explained_where_one_is_drawn(analysis):
    assert "bound" not in draws(analysis).figures[0].caption
    of_its_own = Analysis(analysis.record)
    verdict = of_its_own.verdict
    found = tuple(dataclasses.replace(q, bound=0.7) for q in verdict.quantities)
    vars(of_its_own)["verdict"] = dataclasses.replace(verdict, quantities=found)
    assert "Dotted: confidence bound" in draws(of_its_own).figures[0].caption


def test_a_bound_is_beside_the_limit_that_it_is_of(analysis):
    """Another limit on the same metric has the same value."""
    record = analysis.record
    peak = record.study.constraints["peak"]
    often = dataclasses.replace(peak, name="often", kind="chance", probability=0.9)
    study = dataclasses.replace(record.study, constraints={"peak": peak, "often": often})
    both = Analysis(dataclasses.replace(record, study=study))
    verdict = analysis.verdict
    (known,) = [q for q in verdict.quantities if q.constraint]
    found = (dataclasses.replace(known, bound=0.7), dataclasses.replace(known, constraint="often"))
    vars(both)["verdict"] = dataclasses.replace(verdict, quantities=found)
    panels = {panel.title: panel for panel in draws(both).figures[0].panels}
    limits = {
        name: [e.value for e in panel.elements if isinstance(e, Limit)]
        for name, panel in panels.items()
    }
    assert limits == {"peak (peak)": [1.0, 0.7], "peak (often)": [1.0]}
