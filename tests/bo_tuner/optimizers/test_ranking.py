"""The ranking, on trials of a known function."""

from dataclasses import replace

import numpy as np
import pytest

from bo_tuner.evidence.certificate.parameter_sensitivity import parameter_sensitivity
from bo_tuner.methods.registry import METHODS
from bo_tuner.models.fitting import FITTED_EACH
from bo_tuner.models.narrowness import TOLERABLE
from bo_tuner.optimizers import ranking
from bo_tuner.optimizers.ranking import LARGEST_PENALTY

NODE = {"node": "axis"}
DOUBLE = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
INTEGER = NODE | {"type": "integer", "bounds": [0, 20], "default": 10}
NOISE = 0.05
OF_TRIALS = METHODS["IV"].ranking
rank = OF_TRIALS.rank


@pytest.fixture
def study(make_study):
    return make_study(parameters={"x": DOUBLE})


def noisy(value, seed, count=5, noise=NOISE):
    return (value + noise * np.random.default_rng(seed).normal(size=count)).tolist()


def along(make_trial, points, cost, worst=lambda x: 0.5, seed=100, kind=float):
    """Trials at `points` with the true cost, noise, and the true worst case."""
    return [
        make_trial(k, {"x": kind(x)}, noisy(cost(x), seed + k), worst(x))
        for k, x in enumerate(points)
    ]


def bowl(x):
    return 1.0 + 4.0 * (x - 0.4) ** 2


def gorge(x):
    walls = 1.0 + 1.5 * np.exp(-(((x - 4) / 2) ** 2)) + 0.005 * (x - 14) ** 2
    return walls - 2.2 * np.exp(-(((x - 4) / 0.4) ** 2))


GRID = np.linspace(0.0, 1.0, 11)


class TestObjective:
    def test_the_best_of_a_smooth_function(self, study, make_trial):
        first, *_ = rank(study, along(make_trial, GRID, bowl))
        assert first.trial.parameters["x"] == pytest.approx(0.4, abs=0.11)
        assert first.objective == pytest.approx(1.0, abs=NOISE)

    @pytest.mark.parametrize("seed", range(3))
    def test_a_single_low_sample_is_not_ranked_first(self, study, make_trial, seed):
        """One trial far from the optimum has a single evaluation, with a low value by chance.

        It is two standard deviations of the noise below the truth, 1.49.
        """
        trials = [
            make_trial(k, {"x": float(x)}, noisy(bowl(x), 100 * seed + k, noise=0.4))
            for k, x in enumerate(GRID)
        ]
        lucky = make_trial(11, {"x": 0.75}, [0.69])
        assert all(np.mean(trial.observations("error")) > 0.69 for trial in trials)
        first, *_ = rank(study, [*trials, lucky])
        assert first.trial.number != 11
        assert first.trial.parameters["x"] == pytest.approx(0.4, abs=0.21)

    def test_on_the_log_scale(self, make_study, make_trial):
        study = make_study(parameters={"x": DOUBLE}, objective={"metric": "error", "scale": "log"})
        trials = [
            make_trial(k, {"x": float(x)}, np.exp(noisy(20 * (x - 0.4) ** 2, k)).tolist())
            for k, x in enumerate(GRID)
        ]
        first, *_ = rank(study, trials)
        assert first.trial.parameters["x"] == pytest.approx(0.4, abs=0.11)
        assert first.objective == pytest.approx(1.0, rel=0.1)

    def test_maximizing(self, make_study, make_trial):
        study = make_study(
            parameters={"x": DOUBLE}, objective={"metric": "error", "direction": "maximize"}
        )
        first, *_ = rank(study, along(make_trial, GRID, lambda x: -bowl(x)))
        assert first.trial.parameters["x"] == pytest.approx(0.4, abs=0.11)
        assert first.objective == pytest.approx(-1.0, abs=NOISE)

    def test_a_narrow_optimum_loses(self, make_study, make_trial):
        """The narrow optimum at 4 is slightly lower than the wide one at 14."""
        study = make_study(parameters={"x": INTEGER})
        trials = along(make_trial, range(21), gorge, kind=int)
        deepest = min(trials, key=lambda trial: np.mean(trial.observations("error")))
        assert deepest.parameters["x"] == 4
        first, *_ = rank(study, trials)
        assert first.trial.parameters["x"] > 10
        (narrow,) = [c for c in rank(study, trials) if c.trial is deepest]
        assert narrow.score - narrow.objective == pytest.approx(narrow.objective * narrow.penalty)

    @pytest.mark.parametrize(
        ("direction", "worse"), [("minimize", np.exp(0.5)), ("maximize", np.exp(-0.5))]
    )
    def test_a_penalty_on_the_log_scale_is_that_of_the_certificate(
        self, make_study, make_trial, direction, worse
    ):
        """The best is 20; at 19 the metric is e^0.5 times as large, or as small."""
        objective = {"metric": "error", "scale": "log", "direction": direction}
        study = make_study(parameters={"x": INTEGER}, objective=objective, constraints={})
        trials = [make_trial(x, {"x": x}, [float(worse ** (20 - x))]) for x in range(21)]
        first, *_ = rank(study, trials)
        assert first.trial.parameters["x"] == 20
        loss = abs(worse - 1.0)
        assert first.penalty == pytest.approx(loss - TOLERABLE, rel=0.02)
        penalized = 1.0 + first.penalty if direction == "minimize" else 1.0 - first.penalty
        assert study.objective.from_cost(first.score) == pytest.approx(first.objective * penalized)
        around = parameter_sensitivity(study, {"x": 20}, OF_TRIALS.models(study, trials))
        assert around.score == pytest.approx(first.penalty)

    def test_a_far_better_optimum_wins_however_far_the_limit_is_exceeded_beside_it(
        self, make_study, make_trial
    ):
        """At 11 the limit 1 is exceeded fourfold; 9 costs 0.4 more than 10."""
        study = make_study(parameters={"x": INTEGER})
        points = range(5, 16)
        trials = along(
            make_trial, points, lambda x: 5.0 - 0.4 * x, lambda x: 0.8 + 4.0 * (x - 10), kind=int
        )
        first, *_ = rank(study, trials)
        assert first.trial.parameters["x"] == 10
        assert 0.0 < first.penalty <= LARGEST_PENALTY

    def test_a_limit_beside_a_real_parameter_makes_nothing_narrow(self, study, make_trial):
        """One step beyond the best, at x = 0.5, the limit 1 is exceeded threefold."""
        trials = along(make_trial, GRID, lambda x: 2.0 - x, lambda x: 0.9 + 20.0 * (x - 0.5))
        first, *_ = rank(study, trials)
        assert first.trial.parameters["x"] == 0.5
        assert first.penalty == 0.0


class TestFeasibility:
    def worst(self, x):
        """The limit 1 is met up to x = 0.25."""
        return 0.5 + 2.0 * x

    def test_an_infeasible_one_never_wins_over_a_feasible(self, study, make_trial):
        ranked = rank(study, along(make_trial, GRID, bowl, self.worst))
        feasible = [candidate.believed_feasible for candidate in ranked]
        assert feasible == sorted(feasible, reverse=True)
        assert any(feasible)
        assert ranked[0].trial.parameters["x"] <= 0.25
        # The best of what is feasible, not just any of it.
        assert ranked[0].trial.parameters["x"] >= 0.1

    def test_nothing_feasible_gives_the_least_violating(self, study, make_trial):
        ranked = rank(study, along(make_trial, GRID, bowl, lambda x: 1.5 + (x - 0.8) ** 2))
        assert not any(candidate.believed_feasible for candidate in ranked)
        assert ranked[0].trial.parameters["x"] == pytest.approx(0.8, abs=0.1)
        assert ranked[0].violation == pytest.approx(0.5, abs=0.05)
        violations = [candidate.violation for candidate in ranked]
        assert violations == sorted(violations)

    def test_a_limit_of_0_is_exceeded_by_the_unit(self, make_study, make_trial):
        """As much as a limit of 1 is, which nothing is divided by either."""
        found = []
        for limit in (0.0, 1.0):
            peak = {"kind": "worst_case", "metric": "peak", "upper": limit}
            study = make_study(parameters={"x": DOUBLE}, constraints={"peak": peak})
            trials = along(make_trial, GRID, bowl, lambda x, at=limit: at + 0.5 + (x - 0.8) ** 2)
            ranked = rank(study, trials)
            assert ranked[0].trial.parameters["x"] == pytest.approx(0.8, abs=0.1)
            found.append([candidate.violation for candidate in ranked])
        assert found[0] == pytest.approx(found[1], rel=1e-3)

    def test_all_feasible_without_constraints(self, make_study, make_trial):
        study = make_study(parameters={"x": DOUBLE}, constraints={})
        assert all(c.believed_feasible for c in rank(study, along(make_trial, GRID, bowl)))

    @pytest.mark.parametrize("probability", [None, 0.85])
    def test_noise_of_an_evaluation_counts_if_the_limit_is_on_single_runs(
        self, make_study, make_trial, probability
    ):
        """The expected worst case meets its limit by a hair, half of the evaluations would not."""
        limit = {"kind": "worst_case", "metric": "peak", "upper": 1.0}
        if probability:
            limit["probability"] = probability
        study = make_study(parameters={"x": DOUBLE}, constraints={"peak": limit})
        trials = [
            make_trial(k, {"x": float(x)}, noisy(bowl(x), k), worst=0.99, noise=0.2)
            for k, x in enumerate(GRID)
        ]
        believed = [candidate.believed_feasible for candidate in rank(study, trials)]
        assert any(believed) is (probability is None)

    def test_a_chance_constraint(self, make_study, make_trial):
        """The errors themselves stay below the limit by 0.96 where the cost is below 1.1."""
        constraint = {"kind": "chance", "metric": "error", "upper": 1.2, "probability": 0.96}
        study = make_study(parameters={"x": DOUBLE}, constraints={"error": constraint})
        for candidate in rank(study, along(make_trial, GRID, bowl)):
            # z = 1.75 standard deviations of 0.05 stay free below the limit.
            margin = 1.2 - 1.75 * NOISE - bowl(candidate.trial.parameters["x"])
            if abs(margin) > 0.05:
                assert candidate.believed_feasible == (margin > 0)


class TestFaults:
    def test_nothing_to_recommend(self, study, make_trial):
        assert rank(study, []) == []
        assert rank(study, [make_trial(k, {"x": k / 10}) for k in range(5)]) == []

    def test_failed_trials_are_not_ranked(self, study, make_trial):
        trials = along(make_trial, GRID, bowl)
        trials += [make_trial(11 + k, {"x": 0.4 + k / 50}) for k in range(3)]
        assert all(candidate.trial.number < 11 for candidate in rank(study, trials))

    def test_one_trial(self, study, make_trial):
        (only,) = rank(study, along(make_trial, [0.3], bowl))
        assert only.trial.number == 0
        assert np.isfinite([only.objective, only.violation, only.penalty, only.score]).all()

    def test_an_outlier_is_never_recommended(self, study, make_trial):
        """The model of the objective excludes outliers, so it predicts a low cost near them."""
        trials = along(make_trial, GRID, bowl)
        wild = make_trial(11, {"x": 0.42}, [300.0] * 5)
        ranked = rank(study, [*trials, wild])
        assert all(candidate.trial.number != 11 for candidate in ranked)
        assert ranked[0].trial.parameters["x"] == pytest.approx(0.4, abs=0.11)

    @pytest.mark.parametrize("value", [0.0, 1e-300, 1e6])
    def test_constant_values(self, study, make_trial, value):
        trials = [make_trial(k, {"x": float(x)}, [value] * 3, 0.5) for k, x in enumerate(GRID)]
        ranked = rank(study, trials)
        assert len(ranked) == len(GRID)
        assert all(candidate.believed_feasible for candidate in ranked)

    def test_the_same_trials_give_the_same_rank(self, study, make_trial):
        trials = along(make_trial, GRID, bowl)
        assert rank(study, trials) == rank(study, trials)


class TestFirst:
    """The first alone, which most of the others need not be asked for."""

    @pytest.mark.parametrize("pooled", [False, True])
    @pytest.mark.parametrize(
        "worst",
        [lambda x: 0.5, lambda x: 1.5 + (x - 0.8) ** 2, lambda x: 1.4 - x],
        ids=["all feasible", "none feasible", "some feasible"],
    )
    def test_is_that_of_the_ranking(self, study, make_trial, monkeypatch, worst, pooled):
        # Fewer in a block than trials, so that it has several to choose from.
        monkeypatch.setattr(ranking, "BLOCK", 3)
        points = np.random.default_rng(1).random(25)
        trials = [*along(make_trial, points, bowl, worst), make_trial(25, {"x": 0.4})]
        method = METHODS["boundary" if pooled else "IV"].ranking
        models = method.models(study, trials)
        self.compare(models, study, trials, method)
        ranked = method.ranked_by(models, study, trials)
        feasible = [c.objective for c in ranked if c.believed_feasible]
        lowest = method.lowest_cost(models, study, trials)
        assert lowest == (pytest.approx(min(feasible)) if feasible else None)

    def compare(self, models, study, trials, method=OF_TRIALS):
        found, (first, *_) = (f(models, study, trials) for f in (method.first_by, method.ranked_by))
        assert found.trial is first.trial
        # Other blocks round otherwise.
        for name in ("objective", "feasibility", "violation", "penalty", "score", "required"):
            assert getattr(found, name) == pytest.approx(getattr(first, name), abs=1e-9)

    def test_of_a_narrow_optimum(self, make_study, make_trial, monkeypatch):
        """The lowest cost has a penalty, so that it is not in the first block that the first is."""
        monkeypatch.setattr(ranking, "BLOCK", 1)
        study = make_study(parameters={"x": INTEGER})
        trials = along(make_trial, range(21), gorge, kind=int)
        models = OF_TRIALS.models(study, trials)
        self.compare(models, study, trials)

    def test_of_nothing(self, study, make_trial):
        trials = [make_trial(0, {"x": 0.4})]
        models = OF_TRIALS.models(study, trials)
        assert OF_TRIALS.first_by(models, study, trials) is None
        assert OF_TRIALS.lowest_cost(models, study, trials) is None

    @pytest.mark.parametrize("few", [1, ranking.FEW])
    def test_the_lowest_cost_has_no_penalty(self, make_study, make_trial, monkeypatch, few):
        monkeypatch.setattr(ranking, "FEW", few)
        study = make_study(parameters={"x": INTEGER})
        # Without the limit 1, x = 0 would be feasible, too.
        trials = along(make_trial, range(21), gorge, lambda x: 2.0 - x, kind=int)
        models = OF_TRIALS.models(study, trials)
        feasible = [c for c in rank(study, trials) if c.believed_feasible]
        costs = {c.trial.parameters["x"]: c.objective for c in feasible}
        assert min(costs, key=costs.get) == 4 != feasible[0].trial.parameters["x"]
        assert OF_TRIALS.lowest_cost(models, study, trials) == pytest.approx(costs[4])


class TestManyTrials:
    """Beyond some number of trials, hyperparameters are not fitted for each ranking."""

    @pytest.fixture
    def trials(self, make_trial):
        """So many that those with hyperparameters would be kept, but there are none."""
        points = np.random.default_rng(2).random(FITTED_EACH + 3)
        return along(make_trial, points, bowl, lambda x: 1.4 - x)

    def test_without_hyperparameters_on_record(self, study, trials):
        models = OF_TRIALS.models(study, trials)
        assert models.warm_starts == OF_TRIALS.models(study, trials).warm_starts
        x = np.linspace(0.05, 0.95, 19)
        # A few standard errors of the mean of a hundred trials.
        np.testing.assert_allclose(models.objective.predict_mean(x[:, None]), bowl(x), atol=NOISE)
        (limit,) = models.constraints.values()
        np.testing.assert_allclose(limit.predict_mean(x[:, None]), 1.4 - x, atol=NOISE)

    def test_those_of_another_fit_are_kept(self, study, trials):
        start = OF_TRIALS.models(study, trials[:50]).warm_starts
        found = OF_TRIALS.models(study, trials, start=start).warm_starts
        for name, values in start.items():
            np.testing.assert_allclose(found[name], values)


def rotated(x):
    """Return x (d,) turned, so that no function is separable."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(len(x), len(x))))[0]
    return turn @ x


def katsuura(x):
    powers = 2.0 ** np.arange(1, 33)
    rough = (np.abs(powers * x[:, None] - np.round(powers * x[:, None])) / powers).sum(axis=1)
    return np.prod(1.0 + np.arange(1, len(x) + 1) * rough) ** (10.0 / len(x) ** 1.2)


WEIGHTS = 10.0 ** np.array([0.0, 3.0, 6.0])

LANDSCAPES = {
    "sphere": lambda x: x @ x,
    "ellipsoid": lambda x: WEIGHTS @ rotated(x) ** 2,
    "discus": lambda x: 1e6 * rotated(x)[0] ** 2 + rotated(x)[1:] @ rotated(x)[1:],
    "bent cigar": lambda x: rotated(x)[0] ** 2 + 1e6 * rotated(x)[1:] @ rotated(x)[1:],
    "sharp ridge": lambda x: x[0] ** 2 + 100.0 * np.linalg.norm(x[1:]),
    "different powers": lambda x: np.sqrt((np.abs(rotated(x)) ** [2.0, 4.0, 6.0]).sum()),
    "Rosenbrock": lambda x: sum(100 * (x[:-1] ** 2 - x[1:]) ** 2 + (x[:-1] - 1) ** 2),
    "Rastrigin": lambda x: 10.0 * (3 - np.cos(2 * np.pi * x).sum()) + x @ x - 450.0,
    "Weierstrass": lambda x: sum(0.5**k * np.cos(2 * np.pi * 3**k * (x + 0.5)).sum() for k in R12),
    "Schaffer": lambda x: np.mean(pairs(x) + pairs(x) * np.sin(50.0 * pairs(x) ** 0.4) ** 2) ** 2,
    "linear slope": lambda x: [1.0, 10.0, 100.0] @ (5.0 - x),
    "Katsuura": katsuura,
    "step": lambda x: 0.1 * max(abs(rotated(x)[0]) / 1e4, (np.floor(0.5 + rotated(x)) ** 2).sum()),
    "a narrow hole": lambda x: 430.0 - 900.0 * np.exp(-50.0 * ((x - 0.7) ** 2).sum()),
}
"""Functions like those of BBOB (Hansen and others 2009), in three variables from -5 to 5."""

R12 = range(12)


def pairs(x):
    return np.sqrt(x[:-1] ** 2 + x[1:] ** 2) ** 0.5


class TestWithoutNoise:
    BOX = NODE | {"type": "double", "bounds": [-5.0, 5.0], "default": 0.0}
    NAMES = ("x", "y", "z")

    def study(self, make_study, **sections):
        parameters = dict.fromkeys(self.NAMES, self.BOX)
        return make_study(parameters=parameters, noise="none", **{"contexts": {}} | sections)

    def runs(self, study, make_trial, cost, peak=lambda x: 0.5):
        """One run at each point of a design, and one in the narrow hole."""
        space = study.search_space()
        cube = space.latin_hypercube(25, np.random.default_rng(3))
        sets = [*map(space.to_parameters, cube), dict.fromkeys(self.NAMES, 0.7)]
        points = [np.array(list(parameters.values())) for parameters in sets]
        trials = [
            make_trial(k, parameters, [float(cost(x))], peak(x))
            for k, (parameters, x) in enumerate(zip(sets, points, strict=True))
        ]
        return trials if study.contexts else [without_context(trial) for trial in trials]

    @pytest.mark.parametrize("method", ["boundary", "IV"])
    @pytest.mark.parametrize("cost", LANDSCAPES.values(), ids=LANDSCAPES)
    def test_the_first_is_the_best_run(self, make_study, make_trial, cost, method):
        study = self.study(make_study, constraints={})
        trials = self.runs(study, make_trial, cost)
        best = min(trials, key=lambda trial: trial.observations("error")[0])
        ranking = METHODS[method].ranking
        models = ranking.models(study, trials)
        first, *others = ranking.ranked_by(models, study, trials)
        assert first.trial.parameters == best.parameters
        assert first.objective == best.observations("error")[0]
        assert len(others) == len(trials) - 1
        assert ranking.first_by(models, study, trials).trial.parameters == best.parameters

    @pytest.mark.parametrize("kind", ["chance", "worst_case"])
    def test_the_first_is_the_best_of_the_runs_within_the_limit(self, make_study, make_trial, kind):
        """The metric alternates about the limit, finer than a model can tell."""
        limit = {"kind": kind, "metric": "peak", "upper": 1.0}
        limit |= {"probability": 0.9} if kind == "chance" else {}
        study = self.study(make_study, constraints={"peak": limit})
        trials = self.runs(
            study, make_trial, LANDSCAPES["sphere"], lambda x: 1.0 + np.sin(40.0 * x.sum())
        )
        kept = [t for t in trials if t.evaluations[0].outcome.metrics["peak"] <= 1.0]
        assert 5 < len(kept) < len(trials) - 5
        ranked = METHODS["boundary"].ranking.rank(study, trials)
        order = sorted(kept, key=lambda t: t.observations("error")[0])
        assert [c.trial.number for c in ranked[: len(kept)]] == [t.number for t in order]
        assert all(c.believed_feasible for c in ranked[: len(kept)])
        assert not any(c.believed_feasible for c in ranked[len(kept) :])

    @pytest.mark.parametrize("method", ["boundary", "IV", "V"])
    @pytest.mark.parametrize("cost", [LANDSCAPES["Rastrigin"], katsuura])
    def test_models_go_through_the_runs(self, make_study, make_trial, cost, method):
        """What is rough is no noise."""
        study = self.study(make_study, constraints={})
        trials = self.runs(study, make_trial, cost)
        model = METHODS[method].ranking.models(study, trials).objective
        x = study.search_space().cube_of(trial.parameters for trial in trials)
        values = [trial.observations("error")[0] for trial in trials]
        assert np.abs(model.predict_mean(x) - values).max() < 1e-3 * np.std(values)

    def test_a_run_beyond_a_limit_of_every_context_refutes_a_set(self, make_study, make_trial):
        """A single spike, beside which all is far within the limit."""
        contexts = {"load": NODE | {"distribution": "uniform", "bounds": [1.0, 2.0]}}
        study = self.study(make_study, contexts=contexts)
        trials = self.runs(study, make_trial, LANDSCAPES["sphere"], lambda x: 0.1)
        best = min(trials, key=lambda trial: trial.observations("error")[0])
        spiked = make_trial(best.number, best.parameters, best.observations("error"), 1.001)
        trials[best.number] = spiked
        ranking = METHODS["boundary"].ranking
        ranked = ranking.rank(study, trials)
        (found,) = [c for c in ranked if c.trial.number == best.number]
        assert (found.feasibility, found.believed_feasible) == (0.0, False)
        assert found.violation == pytest.approx(0.001)
        assert ranked[0].believed_feasible


def without_context(trial):
    evaluations = tuple(replace(e, context={}) for e in trial.evaluations)
    worst = {name: replace(case, context={}) for name, case in trial.worst_cases.items()}
    return replace(trial, evaluations=evaluations, worst_cases=worst)
