"""The models of stage one: the data of each, and the constraints on them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from bo_tuner.models.fitting import fitted_after
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.run_notes import Notes, Unusable
from bo_tuner.trials import Evaluation, EvaluationState, Outcome, Stage, TrialState
from tuning_benchmark.paper.trial_models import TrialModels, over_contexts

COMPLETE = TrialState.COMPLETE
NODE = {"node": "axis"}
DOUBLE = NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5}
GRID = np.linspace(0.0, 1.0, 9)


@pytest.fixture
def study(make_study):
    return make_study(
        parameters={"x": DOUBLE},
        constraints={
            "slow": {"kind": "chance", "metric": "error", "upper": 1.5, "probability": 0.9},
            "peak": {"kind": "worst_case", "metric": "peak", "upper": 1.0},
        },
    )


OF_TRIALS = TrialModels()


def fit(study, trials, models=OF_TRIALS):
    return models(study, trials, rng=np.random.default_rng(0))


def sloped(make_trial, noise=0.0):
    return [
        make_trial(k, {"x": float(x)}, [1.0 + x, 1.0 + x + 0.01], worst=2.0 * x, noise=noise)
        for k, x in enumerate(GRID)
    ]


def test_models_predict_their_responses(study, make_trial):
    models = fit(study, sloped(make_trial))
    x = np.array([[0.3], [0.8]])
    assert models.objective.predict(x)[0] == pytest.approx([1.305, 1.805], abs=0.02)
    assert models.constraints["peak"].predict(x)[0] == pytest.approx([0.6, 1.6], abs=0.02)
    assert models.outliers == frozenset()


@pytest.mark.parametrize(
    ("given", "probability"),
    [({}, 0.5), ({"probability": 0.5}, 0.5), ({"probability": 0.99}, 0.99)],
)
def test_the_noise_of_an_evaluation_keeps_a_distance_from_the_worst_case(
    make_study, make_trial, given, probability
):
    worst = {"kind": "worst_case", "metric": "peak", "upper": 1.0} | given
    study = make_study(parameters={"x": DOUBLE}, constraints={"peak": worst})
    noise = 0.1
    (without,) = fit(study, sloped(make_trial)).constraints.values()
    (with_noise,) = fit(study, sloped(make_trial, noise)).constraints.values()
    x = np.array([[0.5]])
    distance = with_noise.predict(x)[0] - without.predict(x)[0]
    assert distance == pytest.approx(norm.ppf(probability) * noise, abs=0.01)


def test_feasibility_is_the_product_of_the_constraints(study, make_trial):
    models = fit(study, sloped(make_trial))
    x = np.array([[0.1], [0.45], [0.9]])
    product = sum(c.log_probability(x) for c in models.constraints.values())
    assert models.log_feasibility(x) == pytest.approx(product)
    probability = np.exp(models.log_feasibility(x))
    assert probability[0] > 0.95
    assert probability[2] < 0.05


def test_an_outlier_leaves_all_models(study, make_trial):
    trials = [*sloped(make_trial), make_trial(9, {"x": 0.55}, [40.0, 41.0], worst=0.0)]
    models = fit(study, trials)
    assert models.outliers == {9}
    x = np.array([[0.55]])
    assert models.objective.predict(x)[0] == pytest.approx([1.555], abs=0.05)
    assert models.constraints["peak"].predict(x)[0] == pytest.approx([1.1], abs=0.05)
    p_out = models.outlying.probability(np.array([[0.56], [0.05]]))
    assert p_out[0] > 0.5 > p_out[1]
    assert fit(study, trials, TrialModels(reject_outliers=False)).objective.predict(x)[0][0] > 5.0


def test_a_failed_trial_speaks_through_its_classifier_only(study, make_trial):
    trials = sloped(make_trial)
    models = fit(study, [*trials, make_trial(9, {"x": 0.97})])
    assert len(models.objective.data.x) == len(trials)
    p_fail = models.failures.probability(np.array([[0.96], [0.1]]))
    assert p_fail[0] > 0.5 > p_fail[1]


@pytest.mark.parametrize(
    ("models", "outcome", "learnt"),
    [
        (OF_TRIALS, {"state": EvaluationState.LOST}, True),
        (OF_TRIALS, {"notes": Notes(Unusable.DISTURBED)}, False),
        (PooledModels(), {"state": EvaluationState.LOST}, False),
        (PooledModels(), {"notes": Notes(Unusable.DISTURBED)}, False),
    ],
    ids=["trials, lost", "trials, disturbed", "pooled, lost", "pooled, disturbed"],
)
def test_what_is_no_failure_of_its_parameters_is_not_learnt_as_one(
    study, make_trial, models, outcome, learnt
):
    unusable = make_trial(9, {"x": 0.97})
    (evaluation,) = unusable.evaluations
    told = replace(evaluation.outcome, **outcome)
    unusable = replace(unusable, evaluations=(replace(evaluation, outcome=told),))
    # A crash elsewhere, without which nothing is learnt of crashes at all.
    trials = [*sloped(make_trial), make_trial(8, {"x": 0.0})]
    x = np.array([[0.965]])
    (before,) = fit(study, trials, models).failures.probability(x)
    (after,) = fit(study, [*trials, unusable], models).failures.probability(x)
    assert (after > before + 0.3) if learnt else (after == before)


def test_nothing_but_failures(study, make_trial):
    models = fit(study, [make_trial(k, {"x": float(x)}) for k, x in enumerate(GRID)])
    assert models.objective is None
    assert models.log_feasibility(np.array([[0.5]])) == pytest.approx([0.0])


def test_the_joint_model_uses_every_evaluation(study, make_trial):
    """The metric is 2 x load, known from search evaluations alone; the worst load is 2."""
    trials = []
    for trial in sloped(make_trial):
        x = trial.parameters["x"]
        evaluations = tuple(
            Evaluation(
                trial.number, k, Stage.SEARCH, trial.parameters, {"load": load}, k,
                Outcome(EvaluationState.COMPLETE, {"error": 1.0 + x, "peak": x * load}),
            )
            for k, load in enumerate((1.0, 1.4, 1.7, 2.0))
        )  # fmt: skip
        drawn = tuple(
            replace(
                evaluation,
                outcome=Outcome(EvaluationState.COMPLETE, {"error": 1 + x, "peak": 1.5 * x}),
            )
            for evaluation in trial.evaluations
        )
        trials.append(replace(trial, evaluations=drawn + evaluations))
    constraint = fit(study, trials, TrialModels(worst_case=over_contexts)).constraints["peak"]
    mean, _ = constraint.predict(np.array([[0.25], [0.75]]))
    assert mean == pytest.approx([0.5, 1.5], abs=0.05)


@pytest.mark.parametrize(
    "models",
    [OF_TRIALS, TrialModels(worst_case=over_contexts), PooledModels()],
    ids=["trials", "joint", "pooled"],
)
@pytest.mark.parametrize("sign", ["upper", "lower"])
def test_the_mean_of_a_limited_response_alone_is_the_predicted_one(
    make_study, make_trial, models, sign
):
    limits = {
        "mean": {"kind": "chance", "metric": "error", sign: 1.5, "probability": 0.9},
        "peak": {"kind": "worst_case", "metric": "peak", sign: 1.0, "probability": 0.9},
    }
    study = make_study(parameters={"x": DOUBLE}, constraints=limits)
    found = fit(study, sloped(make_trial, noise=0.1), models)
    x = np.linspace(0.0, 1.0, 7)[:, None]
    assert len(found.constraints) == 2
    for constraint in found.constraints.values():
        mean, low, high = constraint.band(x, 2.0)
        np.testing.assert_allclose(constraint.predict_mean(x), mean, rtol=1e-9)
        assert (low < mean).all()
        assert (mean < high).all()


def test_warm_start_gives_the_same_models(study, make_trial):
    trials = sloped(make_trial)
    first = fit(study, trials)
    again = TrialModels()(study, trials, rng=np.random.default_rng(1), start=first.warm_starts)
    x = np.array([[0.33]])
    assert again.objective.predict(x)[0] == pytest.approx(first.objective.predict(x)[0], abs=1e-3)


class TestManyTrials:
    """Beyond a hundred trials, hyperparameters are fitted when a tenth has been added."""

    def test_fits_grow_with_the_logarithm_of_the_trials(self):
        assert all(fitted_after(n) for n in range(1, 101))
        due = [n for n in range(101, 100_001) if fitted_after(n)]
        assert len(due) == int(np.log(1000.0) / np.log(1.1))
        assert np.diff(np.log([100, *due])) == pytest.approx(np.log(1.1), abs=0.01)

    @pytest.mark.parametrize("pooled", [False, True])
    def test_between_them_the_hyperparameters_are_kept(self, study, make_trial, pooled):
        due = next(n for n in range(101, 200) if fitted_after(n))
        x = np.random.default_rng(0).random(due)
        # A third has failed: their process keeps what it found, too.
        trials = [
            make_trial(k, {"x": v}, [1.0 + v**2, 1.01 + v**2] if v < 0.7 else [], worst=2.0 * v)
            for k, v in enumerate(x.tolist())
        ]
        models = PooledModels() if pooled else TrialModels()
        earlier = fit(study, trials[:100], models).warm_starts
        assert ("failures" in earlier) is pooled
        first, last = (
            models(study, trials[:n], rng=np.random.default_rng(0), start=earlier)
            for n in (due - 1, due)
        )
        assert all(first.warm_starts[name] == pytest.approx(earlier[name]) for name in earlier)
        assert all(last.warm_starts[name] != earlier[name] for name in earlier)
        # They are conditioned on the trials since the fit all the same.
        assert len(first.objective.points) == sum(t.state is COMPLETE for t in trials[: due - 1])
