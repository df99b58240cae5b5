"""Optuna's own tests of samplers, on the one that carries out a run."""

import copy

import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.testing import pytest_samplers as suite
from optuna.trial import FixedTrial, TrialState

import bo_tuner as bt
from bo_tuner.bridges.optuna import BoTunerSampler

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning"),
]

NOT_SERVED = {
    "test_conditional_sample_independent": "a study has the same parameters in all trials",
    "test_conditional_parameter_objective": "a study has the same parameters in all trials",
    "test_dynamic_range_objective[0-5]": "bounds of a study stay",
    "test_dynamic_range_objective[20-30]": "bounds of a study stay",
    "test_partial_fixed_sampling": "a run has the values that it was asked for with",
    "test_sample_single_distribution": "a study has something to tune",
    "test_trial_relative_params[2]": "one job at a time",
}
"""What is refused, and why; each raises a `StudyError` or an `UnknownRunError`."""
SPACES = {
    "test_raise_error_for_samplers_during_multi_objectives": {"x": FloatDistribution(0, 1)},
    "test_nan_objective_value": {"x": FloatDistribution(0.1, 0.2)},
    "test_partial_fixed_sampling": {
        "x": FloatDistribution(-1, 1), "y": IntDistribution(-1, 1), "z": FloatDistribution(-1, 1)
    },
    "test_sample_single_distribution": {"b": IntDistribution(1, 1)},
    "test_conditional_sample_independent": {"category": CategoricalDistribution(["x", "y"])},
    "test_conditional_parameter_objective": {"x": CategoricalDistribution([True, False])},
    "test_dynamic_range_objective": {"x": FloatDistribution(0, 10), "y": IntDistribution(0, 10)},
    "test_sample_relative_categorical": {
        "x": CategoricalDistribution([1, 10, 100]), "y": CategoricalDistribution([-1, -10, -100])
    },
    "test_sample_relative_mixed": {"y": CategoricalDistribution([-1, -10, -100])},
    "test_trial_relative_params": {
        "x": FloatDistribution(-10, 10), "y": FloatDistribution(-10, 10)
    },
}  # fmt: skip
"""What tests suggest that do not have it as arguments."""


def space(name, arguments):
    """What a test suggests, by name."""
    found = dict(SPACES.get(name, {}))
    for key, value in arguments.items():
        if key == "choices":
            found["x"] = CategoricalDistribution(value)
        elif key.startswith("suggest_method_"):
            variable = key.removeprefix("suggest_method_")
            trial = FixedTrial({variable: 1})
            value(trial)
            found[variable] = trial.distributions[variable]
        elif key.endswith("distribution"):
            found[key[0] if key[1] == "_" else "x"] = value
    return found


def parameter(distribution):
    """The parameter of a study that has the values of a distribution."""
    if isinstance(distribution, CategoricalDistribution):
        texts = [str(choice) for choice in distribution.choices]
        return bt.Choice(texts, default=texts[0])
    low, high = distribution.low, distribution.high
    scale, step = "log" if distribution.log else "linear", distribution.step
    if isinstance(distribution, IntDistribution):
        return bt.Integer(low, high, default=low, scale=scale, step=step if step > 1 else None)
    return bt.Double(low, high, default=low, scale=scale, step=step)


class Told(optuna.samplers.BaseSampler):
    """The sampler; trials that a test only begins are told when the next one begins."""

    def __init__(self, distributions, directions):
        names = [f"value_{k}" for k in range(len(directions))]
        objectives = [
            {"metric": name, "direction": direction}
            for name, direction in zip(names, directions, strict=True)
        ]
        self._values = [0.0] * len(names)
        self._sampler = BoTunerSampler(
            bt.Study(
                name="suite",
                parameters={name: parameter(d) for name, d in distributions.items()},
                metrics=names,
                objective=objectives[0],
                # With it no value is by chance what a test fixes it to.
                seed=5,
                budget=bt.Budget(trials=120, initial_trials=120, drawn_contexts=1),
                **({"further_objectives": objectives[1:]} if objectives[1:] else {}),
            )
        )
        self._begun = None

    def infer_relative_search_space(self, study, trial):
        return self._sampler.infer_relative_search_space(study, trial)

    def sample_relative(self, study, trial, search_space):
        self._begin(study, trial)
        return self._sampler.sample_relative(study, trial, search_space)

    def sample_independent(self, study, trial, name, distribution):
        self._begin(study, trial)
        value = self._sampler.sample_independent(study, trial, name, distribution)
        self._begun.params = self._begun.params | {name: value}
        self._begun.distributions = self._begun.distributions | {name: distribution}
        return value

    def before_trial(self, study, trial):
        self._begun = copy.deepcopy(trial)
        self._sampler.before_trial(study, trial)

    def after_trial(self, study, trial, state, values):
        self._begun = None
        self._sampler.after_trial(study, trial, state, values)

    def _begin(self, study, trial):
        if self._begun is not None and self._begun.number == trial.number:
            return
        if self._begun is not None and self._begun.params:
            self.after_trial(study, self._begun, TrialState.COMPLETE, self._values)
        self.before_trial(study, trial)


class Served:
    """The sampler of each test of a class, and what is not served."""

    directions = ("minimize",)

    @pytest.fixture
    def sampler(self, request):
        test, name = request.node.originalname, request.node.name
        if (reason := NOT_SERVED.get(name, NOT_SERVED.get(test))) is not None:
            refused = (bt.StudyError, bt.UnknownRunError)
            request.applymarker(pytest.mark.xfail(reason=reason, raises=refused, strict=True))
        arguments = getattr(request.node, "callspec", None)
        suggested = space(test, arguments.params if arguments else {})
        return lambda: Told(suggested, self.directions)


class TestBasic(Served, suite.BasicSamplerTestCase):
    pass


class TestRelative(Served, suite.RelativeSamplerTestCase):
    pass


class TestSeveralObjectives(Served, suite.MultiObjectiveSamplerTestCase):
    directions = ("minimize", "maximize")


class TestOneObjective(Served, suite.SingleOnlySamplerTestCase):
    pass
