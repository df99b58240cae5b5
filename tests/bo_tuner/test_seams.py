"""From outside: an acquisition, surrogates, a search, a method, a metric source, a limit."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import yaml
from offering import offer
from report_runs import axis_study, run_study

from bo_tuner.acquisition.acquisition import Acquisition
from bo_tuner.cli import validate
from bo_tuner.cli.report import run
from bo_tuner.evidence.words.limit_kinds import OfMean, words_of_kind
from bo_tuner.interruption import Interruption
from bo_tuner.methods.protocol import AnswerSearch, Method
from bo_tuner.methods.recommendation import Recommendation
from bo_tuner.methods.registry import METHODS
from bo_tuner.methods.searches import SearchRule, searches_of
from bo_tuner.metrics.source import MissingMetricError
from bo_tuner.models.compression import NO_COMPRESSION
from bo_tuner.models.pooled_models import PooledModels
from bo_tuner.optimizers.base import ACQUISITION, SPACE_FILLING, DesignedOptimizer, Proposal
from bo_tuner.optimizers.ranking import Ranking
from bo_tuner.report.analysis import Analysis
from bo_tuner.storage.record import read_run
from bo_tuner.study.limit_kinds.on_mean import OnMean
from bo_tuner.study.limit_kinds.registry import KINDS
from bo_tuner.trials import Stage
from bo_tuner.tuning.driver import Driver
from bo_tuner.tuning.loop import Tuning
from bo_tuner.tuning.summary import choose_answer
from tuning_benchmark.paper.reinterpolation_search import ReinterpolationSearch
from tuning_benchmark.paper.searches import Joint
from tuning_benchmark.paper.trial_models import TrialModels, over_contexts


def valley(gain, load, seed):
    return {"error": 1.0 + (gain - 0.3) ** 2, "peak": 0.5}


def tune(study, backend, algorithm):
    return list(Tuning(study, Driver(backend), algorithm))


def towards(surrogates, incumbent, *, avoid, reinterpolate):
    """Towards one point, whatever the models say: no improvement is expected anywhere."""
    return Acquisition(lambda x: -1e3 * np.abs(x[:, 0] - 0.8125), expected=False)


def optimistic(surrogates, incumbent, *, avoid, reinterpolate):
    """The lower confidence bound of the cost, where the limits are probably kept."""

    def bound(x):
        mean, variance = surrogates.objective.predict(x)
        return np.sqrt(variance) - mean

    limits = tuple(limit.log_probability for limit in surrogates.constraints.values())
    return Acquisition(bound, limits, expected=False)


class TestAcquisition:
    @pytest.mark.parametrize("name", ["IV", "boundary"])
    def test_it_decides_where_to_go(self, make_study, function_backend, name):
        method = replace(METHODS[name], acquisition=towards)
        study = make_study().replace(trials=4)
        trials = tune(study, function_backend(study, valley), method)
        assert trials[3].origin == ACQUISITION
        assert trials[3].parameters["gain"] == pytest.approx(0.8125, abs=1e-3)

    @pytest.mark.parametrize("name", ["IV", "boundary"])
    def test_one_that_is_no_expected_improvement_finds_the_optimum(
        self, make_study, function_backend, name
    ):
        """Its values are below any improvement, and no trial is called a refinement for that."""
        method = replace(METHODS[name], acquisition=optimistic)
        study = make_study().replace(trials=8)
        trials = tune(study, function_backend(study, valley), method)
        # What was tried already is not proposed again, and a point far from all takes its place.
        origins = {trial.origin for trial in trials[3:]}
        assert ACQUISITION in origins
        assert origins <= {ACQUISITION, SPACE_FILLING}
        assert min(abs(t.parameters["gain"] - 0.3) for t in trials[3:]) < 0.05
        # Nor does it tell when to stop.
        assert METHODS[name].outlook(study, trials) is not None
        assert method.outlook(study, trials) is None


@dataclass
class NearestMean:
    """Predicts the mean of the nearest point; a model that knows nothing of Gaussian processes."""

    points: np.ndarray
    counts: np.ndarray
    means: np.ndarray
    scale: float
    warnings = ()
    warm_start = ()
    noise_variance = 0.01

    @classmethod
    def fit(cls, x, y, *, rng, **_):
        points, inverse, counts = np.unique(
            np.asarray(x), axis=0, return_inverse=True, return_counts=True
        )
        means = np.bincount(inverse.ravel(), weights=y) / counts
        cls.fitted += 1
        return cls(points, counts, means, float(np.std(y)) or 1.0)

    fitted = 0
    compression = NO_COMPRESSION

    @property
    def length_scales(self):
        return np.full(self.points.shape[1], 0.5)

    def predict(self, x):
        distance = np.abs(np.asarray(x)[:, None, :] - self.points).max(axis=2)
        return self.means[distance.argmin(axis=1)], distance.min(axis=1) ** 2

    def predict_mean(self, x):
        return self.predict(x)[0]

    def predict_reinterpolated(self, x):
        return self.predict(x)


class TestSurrogate:
    @pytest.mark.parametrize("part", [{}, {"worst_case": over_contexts}], ids=["trials", "joint"])
    def test_it_stands_for_every_response(self, make_study, function_backend, part):
        # The joint search of Algorithm V fits a Gaussian process of its own.
        models = TrialModels(NearestMean.fit, reject_outliers=False, **part)
        algorithm = replace(METHODS["IV"], models=models)
        NearestMean.fitted = 0
        study = make_study().replace(trials=6)
        trials = tune(study, function_backend(study, valley), algorithm)
        assert NearestMean.fitted >= 2 * 3
        assert [t.origin for t in trials[3:]] == [ACQUISITION] * 3
        assert not any(t.warnings for t in trials)


class Averages:
    """A process over parameter set and context: the mean of the runs nearby, with equal noise."""

    warm_start, warnings, scale, noise_variance = (), (), 1.0, 1e-4

    def __init__(self, x, c, y):
        self.x, self.c, self.y = x, c, y
        self.points, self.counts = np.unique(x, axis=0, return_counts=True)
        self.range = float(y.min()), float(y.max())
        self.length_scales = np.full(x.shape[1] + c.shape[1], 0.5)

    def means(self, x, contexts):
        apart = np.abs(x[:, None] - self.x).sum(axis=2)[:, None]
        apart = apart + np.abs(contexts[:, None] - self.c).sum(axis=2)
        weights = np.exp(-apart / 0.05)
        return (weights @ self.y) / weights.sum(axis=2)

    def variances(self, x, contexts, which):
        return np.abs(x[:, None] - self.points).sum(axis=2).min(axis=1) ** 2 + 1e-6

    def variance_of_mean(self, x, contexts):
        return self.variances(x, contexts, None)

    def variance_of_weighted(self, x, contexts, weights):
        return self.variances(x, contexts, None)

    def noise(self, x, contexts, which):
        return np.full(len(x), self.noise_variance), np.full(len(x), 10.0)

    def noise_everywhere(self, x, contexts):
        shape = len(x), len(contexts)
        return np.full(shape, self.noise_variance), np.full(shape, 10.0)

    def noise_deviations(self, z, sign):
        return z


class AveragesKind:
    """Makes them, and counts how many."""

    made = 0

    def fit(self, x, c, y, **_):
        self.made += 1
        return Averages(x, c, y)

    def condition(self, hyperparameters, x, c, y, **_):
        return self.fit(x, c, y)


class TestSurrogateOfBoundary:
    def test_it_stands_for_objective_and_limits_in_both_stages(self, make_study, function_backend):
        """Peak 0.5 + gain * load / 2 of a load up to 2 exceeds the limit 1 for a gain above 0.5."""

        def slope(gain, load, seed):
            return {"error": 2.0 - gain, "peak": 0.5 + 0.5 * gain * load}

        kind = AveragesKind()
        method = replace(METHODS["boundary"], models=PooledModels(kind))
        study = make_study().replace(trials=14, initial_trials=8)
        backend = function_backend(study, slope)
        trials = tune(study, backend, method)
        assert not any(t.warnings for t in trials)
        assert {t.origin for t in trials[8:]} == {ACQUISITION}
        # In each proposal, and in each search for the worst context.
        assert kind.made > 2 * 6 + 14
        answer = choose_answer(study, Driver(backend), method, trials).candidate.trial
        # The cost falls up to a gain of 1. Averages over 0.05 know the limit as well as that.
        assert answer.parameters["gain"] == pytest.approx(0.5, abs=0.1)
        assert answer.worst_cases["peak"].context["load"] == pytest.approx(2.0, abs=0.3)


class Difference:
    """A metric that is the difference of two figures of a node."""

    def value(self, results):
        figures = results["axis"]
        try:
            return figures["peak"] - figures["error"]
        except KeyError as error:
            raise MissingMetricError(f"axis: no {error}") from None


class TestMetricSource:
    def test_it_takes_the_place_of_a_figure(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, valley, {"peak": Difference()})
        (trial, *_) = tune(study, backend, METHODS["I"])
        gain = trial.parameters["gain"]
        (evaluation,) = trial.evaluations
        assert evaluation.outcome.metrics["peak"] == pytest.approx(-0.5 - (gain - 0.3) ** 2)

    def test_what_it_lacks_fails_the_evaluation(self, make_study, function_backend):
        study = make_study()
        backend = function_backend(study, lambda **_: {"peak": 1.0}, {"error": Difference()})
        (trial, *_) = tune(study, backend, METHODS["I"])
        assert trial.reason == "axis: no 'error'"


class Corners(SearchRule):
    """Looks at the largest load alone."""

    def __call__(self, study, constraint, proposal, trials, evaluations):
        class Search(ReinterpolationSearch):
            def ask(self, rng):
                self._asked += 1
                return {"load": 2.0}

        return Search(study.context_space(), constraint.upper, 2)


class TestWorstCaseSearch:
    @pytest.mark.parametrize("name", ["IV", "boundary"])
    def test_a_method_takes_another_one(self, make_study, function_backend, name):
        study = make_study().replace(trials=2)
        method = replace(METHODS[name], search=Corners())
        trials = tune(study, function_backend(study, valley), method)
        searched = [e.context for t in trials for e in t.evaluations if e.stage == "search"]
        assert searched == [{"load": 2.0}] * 4

    def test_one_that_knows_the_joint_model_is_no_search_of_each_trial(self):
        assert "searches for it in each trial" in Corners().refusal(["peak"])
        assert Joint().refusal(["peak"]) == ""


class Nothing(AnswerSearch):
    """Asks for no more runs."""

    def __init__(self, answer):
        self.answer = answer

    def ask(self, pending):
        return None

    def tell(self, task):
        raise AssertionError(task)


class Halving(DesignedOptimizer):
    """Halves the gain from trial to trial."""

    def ask(self, pending=()):
        gain = self.trials[-1].parameters["gain"] / 2.0 if self.trials else 1.0
        return Proposal({"gain": gain}, "halved")


class Halves(Method):
    """A method of one's own, which answers with its last parameter set."""

    ranking = Ranking(TrialModels(reject_outliers=False))

    def optimizer(self, study):
        return Halving(study)

    def first_contexts(self, study, number, proposal):
        return [(Stage.DRAWN, {"load": 1.5})]

    def worst_case_searches(self, study, proposal, trials):
        return searches_of(Corners(), study, proposal, trials, 1)

    def answer_search(self, study, trials, most=None):
        ranked = self.ranking.rank(study, trials)
        last = max(ranked, key=lambda candidate: candidate.trial.number)
        return Nothing(Recommendation(last, True, (), tuple(ranked)))

    def most_evaluations(self, study):
        return 2 * study.budget.trials


HALVES = Halves()


class MeanOverContexts(OnMean):
    """The mean over contexts and noise keeps the limit."""

    in_every_context = False

    def check(self):
        pass

    def response(self, models):
        # The median of runs stands for their mean.
        return models.over_contexts(self.limited, 0.5)


@words_of_kind.register(MeanOverContexts)
class OverContexts(OfMean):
    """Its words, where they are not those of another mean."""

    def asked(self, *, everywhere):
        return "by the mean over contexts and noise"


class TestLimit:
    """The peak is twice the gain times a load between 1 and 2, and the best gain is 0.3."""

    @pytest.mark.parametrize("algorithm", ["IV", "boundary"])
    def test_a_kind_is_tuned_judged_certified_and_shown(
        self, tmp_path, monkeypatch, capsys, algorithm
    ):
        monkeypatch.setitem(KINDS, "mean", MeanOverContexts)
        peak = {"kind": "mean", "metric": "peak", "upper": 1.0}
        budget = {"trials": 12, "initial_trials": 6, "drawn_contexts": 2, "validation_draws": 20}
        text = yaml.safe_dump(axis_study(constraints={"peak": peak}, budget=budget))
        record = read_run(run_study(tmp_path, text, "--algorithm", algorithm))
        # In every context it would be 0.25 at most, over all of them 1/3.
        gain = record.result.parameters["gain"]
        assert 0.26 < gain < 0.33
        monkeypatch.syspath_prepend(tmp_path)
        capsys.readouterr()
        assert validate.run([str(record.path)], Interruption()) == 0
        told = capsys.readouterr().out
        assert "; the limit shown with an assumption" in told
        assert "shown, if no rare runs are far beyond" in told
        assert "of the others: mean over contexts and noise at most 0.9" in told
        page = Analysis(record)
        assert page.verdict.certificate == page.certificate.verdict == "PASS"
        assert run([str(record.path)], Interruption()) == 0
        assert "by the mean over contexts and noise" in (record.path / "report.html").read_text()
        beyond = next(t.number for t in record.trials if t.parameters["gain"] > 0.5)
        assert validate.run([str(record.path), "--trial", str(beyond)], Interruption()) == 3
        assert "peak: NOT proven" in capsys.readouterr().out


class TestMethod:
    def test_what_it_must_say_is_asked_for_when_it_is_made(self):
        class Silent(Method):
            pass

        with pytest.raises(TypeError, match=r"abstract.*answer_search.*optimizer.*ranking"):
            Silent()

    def test_an_earlier_run_over_other_contexts_is_no_data_unless_it_says_so(self, make_study):
        study = make_study()
        assert Halves().refusal(study, study, [], []) == ""
        assert Halves().refusal(study, study, ["load"], ["peak"]).startswith("contexts.load")
        assert "constraints.peak" in Halves().refusal(study, study, [], ["peak"])

    def test_it_is_run_from_the_first_trial_to_the_report(self, tmp_path, monkeypatch, capsys):
        """By the commands, once a package offers it."""
        offer(tmp_path / "site", "half_methods", halves=f"{__name__}:HALVES")
        monkeypatch.syspath_prepend(tmp_path / "site")
        budget = {"trials": 4, "initial_trials": 1, "validation_draws": 4}
        text = yaml.safe_dump(axis_study(budget=budget))
        record = read_run(run_study(tmp_path, text, "--algorithm", "halves"))
        assert [t.parameters["gain"] for t in record.trials] == [1.0, 0.5, 0.25, 0.125]
        # The peak is twice the gain times the load; a search ends when it exceeds 1.
        assert [len(t.evaluations) for t in record.trials] == [1, 1, 2, 2]
        assert record.result.number == 3
        page = Analysis(record)
        assert page.answer == record.result
        assert [t.number for t in page.comparable] == [0, 1, 2, 3]
        assert run([str(record.path)], Interruption()) == 0
        assert (record.path / "report.html").exists()
