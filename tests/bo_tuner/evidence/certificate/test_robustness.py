"""Robustness: drifts against responses whose breaking point is known, and narrow optima."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenario_table import NAMES, TABLE
from scipy import stats

from bo_tuner.evidence.certificate.context_tolerance import (
    CREDIBLE,
    MOST_CONTEXTS,
    context_tolerances,
)
from bo_tuner.evidence.certificate.parameter_sensitivity import (
    Neighbour,
    ParameterSensitivity,
    parameter_sensitivity,
)
from bo_tuner.evidence.words.certificate import of_narrow, of_step
from bo_tuner.methods.registry import METHODS
from bo_tuner.models.narrowness import TOLERABLE
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import (
    Evaluation,
    EvaluationState,
    Outcome,
    Stage,
    Trial,
    TrialState,
    WorstCase,
)
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from tuning_benchmark.paper.trial_models import TrialModels

LIMIT = 1.0
NODE = {"node": "axis"}
UNIFORM = NODE | {"distribution": "uniform"}


def plane(make_study, **contexts):
    variables = {"load": UNIFORM | {"bounds": [0.0, 2.0]}, "wear": UNIFORM | {"bounds": [0.0, 1.0]}}
    return make_study(contexts=variables | contexts)


def evaluations_of(study, function, count=40, noise=0.0, seed=0):
    """Evaluations all over the box, whose peak is a function of the context plus noise."""
    rng = np.random.default_rng(seed)
    space = study.context_space()
    evaluations = []
    for row in space.to_contexts(rng.random((count, space.dimension))):
        context = space.to_dict(row)
        peak = float(function(**context) + noise * rng.standard_normal())
        outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": peak})
        evaluations.append(Evaluation(0, 0, Stage.SEARCH, {}, context, 0, outcome))
    return evaluations


def tolerance_of(study, evaluations):
    """Of the only worst-case constraint; None if it is not known."""
    found = context_tolerances(study, evaluations)
    assert len(found) <= 1
    return found[0] if found else None


def by_name(tolerance):
    return {variable.name: variable for variable in tolerance.variables}


class TestDrift:
    """Nominal is the middle of the box, (1, 0.5)."""

    def test_a_line(self, make_study):
        """0.5 + 0.4 (load - 1) + 0.6 (wear - 0.5) breaks at load 2.25, and wear 1.33 alone."""
        study = plane(make_study, load=UNIFORM | {"bounds": [-1.0, 3.0]})
        found = tolerance_of(
            study,
            evaluations_of(study, lambda load, wear: 0.5 + 0.4 * (load - 1) + 0.6 * (wear - 0.5)),
        )
        assert found.limit == LIMIT
        assert found.worst_context == {"load": pytest.approx(3.0), "wear": pytest.approx(1.0)}
        assert found.nominal.median == pytest.approx(0.5, abs=0.01)
        assert found.worst.median == pytest.approx(1.6, abs=0.02)
        load, wear = (by_name(found)[name] for name in ("load", "wear"))
        assert found.variables == (load, wear)
        assert load.relief.median == pytest.approx(0.8, abs=0.02)
        assert wear.relief.median == pytest.approx(0.3, abs=0.02)
        assert load.up.limit.median == pytest.approx(2.25, abs=0.03)
        assert load.up.breaks == 1.0
        # With wear at its worst, 0.8 + 0.4 (load - 1) breaks at 1.5.
        assert load.worst_up.limit.median == pytest.approx(1.5, abs=0.03)
        # With load at its worst, 1.3 + 0.6 (wear - 0.5), the limit is broken where it starts.
        assert wear.worst_up.limit.median == wear.nominal == 0.5
        assert wear.worst_down.limit.high == 0.5
        # Alone, wear never breaks it, and neither does a smaller load.
        for drift, bound in ((wear.up, 1.0), (wear.down, 0.0), (load.down, -1.0)):
            assert drift.breaks == 0.0
            assert (drift.bound, drift.limit.low, drift.limit.high) == (bound, bound, bound)

    @pytest.mark.parametrize("level", [0.85, 0.95])
    def test_a_limit_on_single_runs_breaks_where_their_quantile_does(self, make_study, level):
        """0.6 + 0.8 (load - 1) + z 0.1 at 1, with z the normal quantile."""
        limit = {"kind": "worst_case", "metric": "peak", "upper": LIMIT, "probability": level}
        constraints = make_study(constraints={"peak": limit}).constraints
        study = replace(plane(make_study), constraints=constraints)
        evaluations = evaluations_of(
            study, lambda load, wear: 0.6 + 0.8 * (load - 1), 150, 0.1, seed=4
        )
        found = by_name(tolerance_of(study, evaluations))["load"].up.limit
        breaks = 1.0 + (0.4 - 0.1 * stats.norm.ppf(level)) / 0.8
        assert found.median == pytest.approx(breaks, abs=0.04)

    def test_a_curve_downwards(self, make_study):
        """0.2 + 2 (wear - 0.5)^2 + 1.2 (1 - load)^2 below 1: load may fall to 1 - sqrt(2/3)."""
        study = plane(make_study)
        found = tolerance_of(
            study,
            evaluations_of(
                study, lambda load, wear: 0.2 + 2 * (wear - 0.5) ** 2 + 1.2 * (1 - load) ** 2, 60
            ),
        )
        load = by_name(found)["load"]
        assert load.down.limit.median == pytest.approx(1 - math.sqrt(2 / 3), abs=0.02)
        assert load.up.limit.median == pytest.approx(1 + math.sqrt(2 / 3), abs=0.02)
        assert found.variables[0] is load

    @pytest.mark.slow
    def test_how_often_the_band_holds_the_truth(self, make_study):
        """The band should hold it in 90 % of data sets."""
        study = plane(make_study)
        held, runs = 0, 50
        for seed in range(runs):
            evaluations = evaluations_of(
                study, lambda load, wear: 0.6 + 0.8 * (load - 1), 25, 0.1, seed
            )
            band = by_name(tolerance_of(study, evaluations))["load"].up.limit
            held += band.low <= 1.5 <= band.high
        # Fewer would come about by chance once in a thousand times.
        assert held >= stats.binom.ppf(1e-3, runs, CREDIBLE)

    def test_the_band_of_the_worst_mean_allows_for_where_it_is(self, make_study):
        """Where all contexts are alike, the one that looks worst has had bad luck."""
        study = plane(make_study)
        held, runs = 0, 25
        for seed in range(runs):
            found = tolerance_of(
                study, evaluations_of(study, lambda load, wear: 0.7, 25, 0.1, 100 + seed)
            )
            held += found.worst.low <= 0.7 <= found.worst.high
            assert found.worst.low <= found.worst.median <= found.worst.high
        assert held >= stats.binom.ppf(1e-3, runs, CREDIBLE)

    def test_a_lower_limit_is_the_mirror_image(self, make_study):
        upper = plane(make_study)
        limit = {"kind": "worst_case", "metric": "peak", "lower": -LIMIT}
        lower = plane(partial(make_study, constraints={"peak": limit}))

        def function(load, wear):
            return 0.6 + 0.8 * (load - 1)

        found = tolerance_of(upper, evaluations_of(upper, function, 25, 0.1))
        mirrored = tolerance_of(
            lower,
            evaluations_of(lower, lambda **context: -function(**context), 25, -0.1),
        )
        for one, other in ((found.worst, mirrored.worst), (found.nominal, mirrored.nominal)):
            assert (one.low, one.median, one.high) == pytest.approx(
                (-other.high, -other.median, -other.low)
            )

    def test_repetitions_count_however_many(self, make_study):
        """Two thousand in ten contexts, then more contexts than a model takes."""
        study = plane(make_study)
        few = evaluations_of(study, lambda load, wear: 0.7, 10)
        many = evaluations_of(study, lambda load, wear: 0.7, MOST_CONTEXTS, seed=1)
        found = tolerance_of(study, [*few * 200, *many])
        assert found.evaluations == 2000 + MOST_CONTEXTS - 10

    def test_more_evaluations_make_a_narrower_band(self, make_study):
        study = plane(make_study)
        widths = []
        for count in (12, 150):
            evaluations = evaluations_of(
                study, lambda load, wear: 0.6 + 0.8 * (load - 1), count, 0.1
            )
            band = by_name(tolerance_of(study, evaluations))["load"].up.limit
            widths.append(band.high - band.low)
        assert widths[1] < 0.6 * widths[0]

    def test_noise_alone_breaks_nothing(self, make_study):
        """The limit is on the expectation: single evaluations beyond it are noise."""
        study = plane(make_study)
        evaluations = evaluations_of(study, lambda load, wear: 0.7, 200, 0.2)
        assert max(evaluation.outcome.metrics["peak"] for evaluation in evaluations) > LIMIT
        found = tolerance_of(study, evaluations)
        assert all(v.up.breaks < 0.05 and v.down.breaks < 0.05 for v in found.variables)

    def test_a_metric_that_never_changes(self, make_study):
        found = tolerance_of(
            plane(make_study), evaluations_of(plane(make_study), lambda load, wear: 0.0)
        )
        assert found.worst.median == pytest.approx(0.0, abs=1e-3)
        assert all(v.up.breaks == v.worst_down.breaks == 0.0 for v in found.variables)

    def test_a_discrete_variable_stays_at_its_values(self, make_study):
        """Tools 1, 2, 5 and 8, nominal 2: the limit breaks between 5 and 8."""
        tool = NODE | {
            "distribution": "discrete",
            "values": [1.0, 2.0, 5.0, 8.0],
            "probabilities": [0.2, 0.4, 0.2, 0.2],
        }
        study = plane(make_study, load=tool)
        found = tolerance_of(study, evaluations_of(study, lambda load, wear: 0.15 * load))
        up = by_name(found)["load"].up
        assert (up.bound, up.limit.low, up.limit.median, up.limit.high) == (8.0, 5.0, 5.0, 5.0)
        assert by_name(found)["load"].down.limit.median == 1.0

    def test_a_nominal_value_at_its_bound(self, make_study):
        study = plane(make_study, wear=UNIFORM | {"bounds": [0.0, 1.0], "nominal": 0.0})
        found = tolerance_of(study, evaluations_of(study, lambda load, wear: 0.5 + wear))
        wear = by_name(found)["wear"]
        assert wear.down.limit.median == wear.down.bound == 0.0
        assert wear.down.breaks == 0.0
        assert wear.up.limit.median == pytest.approx(0.5, abs=0.02)

    def test_nothing_to_tell(self, make_study):
        study = plane(make_study)
        assert tolerance_of(study, []) is None
        assert tolerance_of(study, evaluations_of(study, lambda load, wear: load, 4)) is None
        assert (
            tolerance_of(make_study(contexts={}), [make_evaluation({}) for _ in range(9)]) is None
        )
        free = make_study(contexts=None, constraints={})
        assert tolerance_of(free, [make_evaluation({}) for _ in range(9)]) is None

    def test_failed_evaluations_are_left_out(self, make_study):
        study = plane(make_study)
        evaluations = evaluations_of(study, lambda load, wear: 0.6 + 0.8 * (load - 1))
        failed = [
            Evaluation(0, 0, Stage.SEARCH, {}, evaluation.context, 0) for evaluation in evaluations
        ]
        assert tolerance_of(study, [*failed, *evaluations]) == tolerance_of(study, evaluations)


def make_evaluation(context):
    outcome = Outcome(EvaluationState.COMPLETE, {"error": 1.0, "peak": 0.5})
    return Evaluation(0, 0, Stage.SEARCH, {}, context, 0, outcome)


def trial(number, parameters, objective, worst):
    """A trial with five equal evaluations, and its worst case."""
    outcome = Outcome(
        EvaluationState.COMPLETE,
        {"tracking_error": objective, "overshoot": worst, "return_time": 0.001},
    )
    context = {"stiffness_factor": 1.0, "damping_factor": 1.0}
    evaluations = tuple(
        Evaluation(number, k, Stage.DRAWN, {}, context, k, outcome) for k in range(5)
    )
    return Trial(
        number, parameters, "", TrialState.COMPLETE, evaluations=evaluations,
        worst_cases={"overshoot": WorstCase(worst, context, worst)},
    )  # fmt: skip


class TestNeighbourhood:
    def test_the_narrow_optimum_of_the_paper(self):
        """Around (1, 4, -3.9, 2) each step of a horizon costs a lot (Table 3)."""
        study = load_study("full")
        points = [dict(zip(NAMES, key, strict=True)) for key in TABLE]
        trials = [
            trial(k, point, *figures[:2])
            for k, (point, figures) in enumerate(zip(points, TABLE.values(), strict=True))
        ]
        models = TrialModels()(study, trials, rng=np.random.default_rng(0))
        narrow = parameter_sensitivity(study, points[0], models)
        assert narrow.score > 0.0
        changed = [set(n.changed.items()) for n in narrow.narrow]
        assert {("prediction_horizon", 3)} in changed
        assert {("control_horizon", 2)} in changed
        said = of_narrow(study, narrow)
        assert said.startswith("narrow optimum: ")
        assert "prediction_horizon 3" in said
        # What the table has there.
        (three,) = [n for n in narrow.neighbours if n.changed == {"prediction_horizon": 3}]
        assert three.excess == pytest.approx(0.125 / 0.09 - 1.0, abs=0.15)
        assert three.loss == pytest.approx(math.log(0.140 / 0.165), abs=0.15)

    @pytest.mark.parametrize(
        ("sections", "optimum", "change"),
        [
            ({}, 2.0, "+50.0 %"),
            # A percentage of it would have the wrong sign.
            ({}, -2.0, "+1"),
            # Of a compromise: relative to the spread of its cost, whatever that cost is.
            ({"further_objectives": [{"metric": "peak"}]}, 2.0, "+30.0 %"),
            ({"further_objectives": [{"metric": "peak"}]}, -2.0, "+30.0 %"),
        ],
    )
    def test_the_sentence_has_the_change_that_the_table_has(
        self, make_study, sections, optimum, change
    ):
        study = make_study(**sections)
        best, beside = (
            Neighbour({"gain": gain}, {"gain": gain}, objective, 0.9, loss, -0.5)
            for gain, objective, loss in ((0.5, optimum, 0.0), (0.6, optimum + 1.0, 0.3))
        )
        assert of_step(study, best, beside) == change
        around = ParameterSensitivity(best, (beside,), 0.2)
        assert f"gain 0.6 (objective {change})" in of_narrow(study, around)

    def test_a_calm_one(self, make_study, make_trial):
        study = make_study(objective={"metric": "error", "scale": "log"})
        trials = [
            make_trial(k, {"gain": g}, [1.0 + (g - 0.5) ** 2], worst=0.5 + 0.2 * g)
            for k, g in enumerate(np.linspace(0.0, 1.0, 12).tolist())
        ]
        models = TrialModels()(study, trials, rng=np.random.default_rng(0))
        around = parameter_sensitivity(study, {"gain": 0.5}, models)
        assert (around.score, around.narrow) == (0.0, ())
        assert [n.changed["gain"] for n in around.neighbours] == pytest.approx([0.45, 0.55])
        assert around.optimum.loss == 0.0
        assert around.optimum.excess == pytest.approx(0.6 - 1.0, abs=0.02)
        assert around.optimum.objective == pytest.approx(1.0, rel=0.02)
        assert around.optimum.feasibility == pytest.approx(1.0, abs=0.01)

    def test_a_step_beyond_a_limit_is_not_tolerable(self, make_study, make_trial):
        """By 3 %, where the optimum keeps it by 2 %."""
        study = make_study()
        trials = [
            make_trial(k, {"gain": g}, [1.0], worst=0.98 + g - 0.5)
            for k, g in enumerate(np.linspace(0.0, 1.0, 12).tolist())
        ]
        models = TrialModels()(study, trials, rng=np.random.default_rng(0))
        around = parameter_sensitivity(study, {"gain": 0.5}, models)
        assert [n.changed["gain"] for n in around.narrow] == pytest.approx([0.55])
        assert "% over a limit" in of_narrow(study, around)

    @pytest.mark.parametrize("slope", [1.0, 2.0, 8.0])
    def test_the_score_of_a_slope(self, make_study, make_trial, slope):
        """A step of 0.05 on the logarithm costs exp(0.05 slope) - 1, relative to the optimum."""
        study = make_study(objective={"metric": "error", "scale": "log"}, constraints={})
        trials = [
            make_trial(k, {"gain": g}, [math.exp(slope * g)])
            for k, g in enumerate(np.linspace(0.0, 1.0, 15).tolist())
        ]
        models = TrialModels()(study, trials, rng=np.random.default_rng(0))
        around = parameter_sensitivity(study, {"gain": 0.5}, models)
        down, up = around.neighbours
        loss = math.expm1(0.05 * slope)
        assert up.loss == pytest.approx(loss, rel=0.05)
        assert down.loss == pytest.approx(math.expm1(-0.05 * slope), rel=0.05)
        assert around.score == pytest.approx(max(loss - TOLERABLE, 0.0) / 2, abs=0.02)
        assert bool(around.narrow) is (loss > TOLERABLE)

    @pytest.mark.parametrize(("direction", "sign"), [("minimize", 1.0), ("maximize", -1.0)])
    def test_a_loss_is_relative_to_the_objective_not_to_its_spread(
        self, make_study, make_trial, direction, sign
    ):
        """Of 10 + 4 gain at a gain of 0.5, a step of 0.05 changes 0.2 of 12, not of 1.2."""
        study = make_study(objective={"metric": "error", "direction": direction}, constraints={})
        trials = [
            make_trial(k, {"gain": g}, [10.0 + 4.0 * g])
            for k, g in enumerate(np.linspace(0.0, 1.0, 15).tolist())
        ]
        models = TrialModels()(study, trials, rng=np.random.default_rng(0))
        around = parameter_sensitivity(study, {"gain": 0.5}, models)
        losses = [neighbour.loss for neighbour in around.neighbours]
        assert losses == pytest.approx([-sign * 0.2 / 12.0, sign * 0.2 / 12.0], rel=0.05)
        changes = [n.objective / around.optimum.objective - 1.0 for n in around.neighbours]
        assert losses == pytest.approx([sign * change for change in changes])

    def test_it_is_believed_feasible_as_in_the_ranking(self, make_study, function_backend, failed):
        """Where runs fail, not to fail is one of the limits."""

        def axis(gain, load, seed):
            if gain * load > 0.6:
                return failed("stalled")
            return {"error": 1.0 + (gain - 1.0) ** 2, "peak": 0.5}

        study = make_study().replace(trials=12)
        method = METHODS["boundary"]
        trials = list(Tuning(study, Driver(function_backend(study, axis)), method))
        models = method.ranking.models(study, trials)
        ranked = method.ranking.ranked_by(models, study, trials)
        assert min(found.feasibility for found in ranked) < 0.995
        for found in ranked:
            around = parameter_sensitivity(study, found.trial.parameters, models)
            assert around.optimum.feasibility == pytest.approx(found.feasibility)

    def test_no_model(self, make_study, make_trial):
        study = make_study()
        models = TrialModels()(study, [make_trial(0, {"gain": 0.5})], rng=np.random.default_rng(0))
        assert parameter_sensitivity(study, {"gain": 0.5}, models) is None
