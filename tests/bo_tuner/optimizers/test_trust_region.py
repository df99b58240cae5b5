"""The box in which many parameters are searched, by the rules of TuRBO and SCBO."""

import numpy as np
import pytest

import bo_tuner as bt
from bo_tuner.optimizers.trust_region import FAILED, TrustRegion, edge, trust_region
from bo_tuner.storage.record import read_run

START = (0.0, 100.0)


def better(count, begin=90.0):
    """Merits without a violation, each a tenth lower than the one before it."""
    return [(0.0, begin * 0.9**k) for k in range(count)]


class TestEdge:
    """As in Algorithm 1 and supplement A of Eriksson and others: 0.8, three successes double it."""

    def test_it_begins_with_four_fifths_of_the_cube(self):
        assert edge([], START, 60) == 0.8

    @pytest.mark.parametrize(
        ("successes", "expected"), [(2, 0.8), (3, 1.6), (5, 1.6), (6, 1.6), (9, 1.6)]
    )
    def test_three_successes_double_it_up_to_the_largest(self, successes, expected):
        assert edge(better(successes), START, 60) == expected

    @pytest.mark.parametrize(
        ("failures", "expected"), [(59, 0.8), (60, 0.4), (119, 0.4), (120, 0.2), (360, 0.0125)]
    )
    def test_as_many_failures_as_parameters_halve_it(self, failures, expected):
        assert edge([(0.0, 100.0)] * failures, START, 60) == expected

    def test_of_few_parameters_four_failures_do(self):
        assert edge([(0.0, 100.0)] * 4, START, 2) == 0.4

    def test_when_it_is_too_small_it_begins_anew(self):
        # 0.8 / 2^7 < 2^-7 <= 0.8 / 2^6.
        assert edge([(0.0, 100.0)] * 6 * 60, START, 60) == 0.8 / 64
        assert edge([(0.0, 100.0)] * 7 * 60, START, 60) == 0.8

    def test_a_success_ends_a_row_of_failures(self):
        merits = [*[(0.0, 100.0)] * 59, (0.0, 50.0), *[(0.0, 60.0)] * 59]
        assert edge(merits, START, 60) == 0.8

    def test_hardly_better_is_none(self):
        assert edge([(0.0, 100.0 - 0.09 * k) for k in (1, 1, 1)], START, 60) == 0.8
        assert edge([(0.0, 99.95)] * 60, START, 60) == 0.4

    def test_less_violating_is_better_whatever_it_costs(self):
        merits = [(0.5, 1e6), (0.2, 1e7), (0.0, 1e8)]
        assert edge(merits, (1.0, 0.0), 60) == 1.6
        # A cheaper one over a limit is none.
        assert edge([(0.1, 0.0)] * 60, START, 60) == 0.4

    def test_what_failed_is_a_failure(self):
        assert edge([FAILED] * 60, START, 60) == 0.4
        assert edge(better(3), FAILED, 60) == 1.6


def test_points_differ_from_the_centre_in_about_twenty_coordinates():
    centre = np.full(100, 0.5)
    region = TrustRegion(centre - 0.1, centre + 0.1, centre)
    points = region.latin_hypercube(2000, np.random.default_rng(0))
    moved = (points != centre).sum(axis=1)
    assert moved.min() >= 1
    # Binomial with 100 times 1/5, and one more now and then.
    assert moved.mean() == pytest.approx(20.8, abs=0.5)
    assert np.abs(points - centre).max() <= 0.1


def bowl(parameters, context, seed):
    """The lowest sum is that of x_k = 0.3 where the first two are at most 0.2 in sum."""
    x = np.array(list(parameters.values()))
    return {"cost": float(((x - 0.3) ** 2).sum()), "sum": float(x[0] + x[1])}


def made(trials, initial, count=60, **sections):
    return bt.Study(
        name="many",
        parameters={f"x{k}": bt.Double(0.0, 1.0, default=0.9) for k in range(count)},
        metrics=["cost", "sum"],
        objective="cost",
        budget=bt.Budget(
            trials=trials, initial_trials=initial, drawn_contexts=1, validation_draws=1
        ),
        **sections,
    )


def test_a_proposal_is_in_the_box_around_the_best(tmp_path):
    """By its own runs; the edges along parameters of which the cost depends less are longer."""
    study = made(4, 3, constraints={"sum": bt.Chance("sum", upper=0.5, probability=0.5)})
    with study.tuner(tmp_path / "run") as tuner:
        while (run := tuner.ask()) is not None:
            tuner.tell(run, bowl(run.parameters, run.context, run.seed))
    record = read_run(tmp_path / "run")
    known = record.trials[:3]
    region = trust_region(record.study, known, None)
    costs = [bowl(trial.parameters, {}, 0) for trial in known]
    best = min(known, key=lambda t: (max(costs[t.number]["sum"] - 0.5, 0), costs[t.number]["cost"]))
    assert region.centre == pytest.approx(list(best.parameters.values()))
    assert region.lower == pytest.approx(np.maximum(region.centre - 0.4, 0.0))
    scales = np.where(np.arange(60) % 2, 0.5, 2.0)
    longer = trust_region(record.study, known, scales)
    inside = (longer.lower > 0.0) & (longer.upper < 1.0)
    half = 0.5 * (longer.upper - longer.lower)[inside]
    # Their geometric mean is 1, so that the volume of the box stays as it is.
    assert half == pytest.approx(0.4 * np.where(np.arange(60) % 2, 0.5, 2.0)[inside])
    # No more than one trial can be proposed by the models: it is in the box of its scales.
    assert record.trials[3].origin in ("acquisition", "refinement")


@pytest.mark.slow
def test_sixty_parameters_are_searched_better_than_at_random(tmp_path):
    """From 21.6 at the default; a global model proposes corners in so many dimensions."""
    found = made(60, 20).optimize(bowl, tmp_path / "run")
    rng = np.random.default_rng(0)
    at_random = min(float(((rng.random(60) - 0.3) ** 2).sum()) for _ in range(60))
    assert bowl(found.best, {}, 0)["cost"] < at_random
