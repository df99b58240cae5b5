import pytest

from tuning_benchmark.campaign.fields import true_fields
from tuning_benchmark.experiments.experiment import SurrogateFigure

FIGURE = SurrogateFigure(row="IV", points=4)


def test_the_true_field_is_the_closed_form(study):
    values = FIGURE.axes(study)[0]
    for first in values:
        truth = true_fields(study, "valley:Judge", FIGURE, first)
        worst = [0.6 * (first + second) for second in values]
        assert truth["worst"] == pytest.approx(worst, abs=1e-5)
