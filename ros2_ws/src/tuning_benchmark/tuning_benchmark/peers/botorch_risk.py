"""Risk-averse Bayesian optimization over contexts with BoTorch's risk measures.

Sources
    https://botorch.org/docs/tutorials/risk_averse_bo_with_environmental_variables: one process over
    parameters and context, the input transform `AppendFeatures` with a set of contexts, and a risk
    measure over them as the objective of the acquisition function; Cakmak et al. 2020. Daulton et
    al. 2022 extend it to several responses by the multivariate value at risk, `MVaR`. That is a
    set of trade-offs between objectives; a problem with one objective and one limit needs the value
    at risk of each response, `IndependentVaR` there: here the expected cost and the value at risk
    of the excess, at a level at which it is that of the worst context in the set.
Contexts in the set
    All corners, up to eight of them, and four drawn ones. The expectation is that over the drawn.
Next evaluation
    Parameters by qLogNEI of the expected cost with an exact penalty on the value at risk, since
    BoTorch's constraints do not go with an input transform that makes many points of one. Context:
    half of the time one of the set drawn at random, else the one with the highest mean plus two
    standard deviations of the excess.
Failed evaluations
    Count as the largest cost and excess so far.
Recommendation
    Lowest posterior mean of the expected cost among the evaluated parameter sets whose value at
    risk of the posterior mean keeps the limit; else the one that exceeds it least.
"""

from collections.abc import Mapping

import numpy as np
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.acquisition.risk_measures import VaR
from botorch.fit import fit_gpytorch_mll
from botorch.models import ModelListGP, SingleTaskGP
from botorch.models.transforms.input import AppendFeatures
from botorch.optim import optimize_acqf
from botorch.sampling.normal import SobolQMCNormalSampler
from botorch.utils.sampling import manual_seed
from gpytorch.mlls import ExactMarginalLogLikelihood
from torch import Tensor

from bo_tuner.study.study import Study
from bo_tuner.trials import Context, Value
from tuning_benchmark.peers.optimizer import tuned
from tuning_benchmark.peers.robust import Result, worst_case_constraint

CORNERS, DRAWN = 8, 4
BASELINE = 12
"""Most promising parameter sets as the baseline of the improvement; each counts as often as there
are contexts."""

SAMPLES, RESTARTS, RAW_SAMPLES = 32, 4, 64
REFIT = 5
PENALTY = 5.0
"""Cost of exceeding the limit by as much as its size, the same as for `confidence_bounds`."""

OPTIONS = {"maxiter": 50, "batch_limit": RESTARTS, "init_batch_limit": RAW_SAMPLES}


class RiskAverse:
    """qLogNEI of the expected cost with a penalty on the value at risk."""

    def __init__(self, study: Study, seed: int) -> None:
        self._study = study
        self._space = study.search_space()
        self._contexts = study.context_space()
        self._seed = seed
        self._results: list[Result] = []
        self._states: list[dict[str, Tensor]] = []
        self._fitted = 0
        rng = np.random.default_rng(seed)
        corners = self._contexts.corners()
        chosen = rng.permutation(len(corners))[:CORNERS]
        drawn = self._contexts.to_cube(self._contexts.draw_stratified(DRAWN, rng))
        self._set = torch.tensor(np.vstack([drawn, corners[chosen]]))
        count = len(self._set)
        self._risk = VaR(alpha=1.0 - 0.5 / count, n_w=count)

    def tell(self, result: Result) -> None:
        """Keep a result."""
        self._results.append(result)

    def ask(self) -> tuple[Mapping[str, Value], Context]:
        """Maximize the acquisition function, then choose the context."""
        seed = int(np.random.SeedSequence((self._seed, len(self._results))).generate_state(1)[0])
        rng = np.random.default_rng(seed)
        with manual_seed(seed):
            model = self._model()
            cube = self._maximize(model, seed).numpy()
        parameters = tuned(self._space, self._space.to_parameters(self._space.repair(cube)[0]))
        row = int(rng.integers(len(self._set)))
        if rng.random() < 0.5:
            point = torch.tensor(self._space.to_cube(parameters))[None]
            with torch.no_grad():
                posterior = model.posterior(point)
                upper = posterior.mean[..., 1] + 2.0 * posterior.variance[..., 1].sqrt()
            row = int(upper.argmax())
        context = self._contexts.to_contexts(self._set[row : row + 1].numpy())[0]
        return parameters, self._contexts.to_dict(context)

    def recommend(self) -> Mapping[str, Value] | None:
        """Return the best evaluated parameters by the posterior mean."""
        if not self._results:
            return None
        with manual_seed(self._seed):
            cost, worst = self._means(self._model(), self._evaluated())
        kept = worst <= 0.0
        best = torch.where(kept, cost, torch.inf).argmin() if kept.any() else worst.argmin()
        return self._results[int(best)].parameters

    def _evaluated(self) -> Tensor:
        return torch.tensor(self._space.cube_of(r.parameters for r in self._results))

    def _model(self) -> ModelListGP:
        """Return processes of cost and excess over parameters and context, for the whole set."""
        names = list(self._study.contexts)
        rows = np.array([[r.context[name] for name in names] for r in self._results])
        X = torch.hstack([self._evaluated(), torch.tensor(self._contexts.to_cube(rows))])
        costs = _filled([r.cost for r in self._results])
        excesses = _filled([r.excess for r in self._results])
        again = self._fitted == 0 or len(self._results) >= self._fitted + REFIT
        models = []
        for index, y in enumerate((costs, excesses)):
            model = SingleTaskGP(X, y, input_transform=AppendFeatures(feature_set=self._set))
            if self._states:
                # Outcomes are standardized anew, so only the process is taken over.
                model.covar_module.load_state_dict(
                    {k: v for k, v in self._states[index].items() if k in _covariance(model)}
                )
            if again:
                fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
            models.append(model.eval())
        if again:
            self._fitted = len(self._results)
            self._states = [dict(m.covar_module.state_dict()) for m in models]
        return ModelListGP(*models)

    def _maximize(self, model: ModelListGP, seed: int) -> Tensor:
        count, risk = len(self._set), self._risk
        margin = self._margin(model)
        evaluated = torch.unique(self._evaluated(), dim=0)
        cost, worst = self._means(model, evaluated)
        baseline = evaluated[(cost + worst.clamp(min=0.0)).argsort()[:BASELINE]]

        def penalized(samples: Tensor, X: Tensor | None = None) -> Tensor:
            drawn = samples[..., 0].unflatten(-1, (-1, count))[..., :DRAWN]
            # Risk measures are of what is maximized.
            at_risk = -risk(-samples[..., 1:]) + margin
            return -drawn.mean(dim=-1) - PENALTY * at_risk.clamp(min=0.0)

        acquisition = qLogNoisyExpectedImprovement(
            model=model,
            X_baseline=baseline,
            sampler=SobolQMCNormalSampler(torch.Size([SAMPLES]), seed=seed),
            objective=GenericMCObjective(penalized),
            prune_baseline=False,
        )
        dimension = self._space.dimension
        bounds = torch.stack([torch.zeros(dimension), torch.ones(dimension)]).double()
        candidates, _ = optimize_acqf(
            acquisition,
            bounds,
            q=1,
            num_restarts=RESTARTS,
            raw_samples=RAW_SAMPLES,
            options=OPTIONS,
        )
        return candidates

    def _means(self, model: ModelListGP, X: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior means (n,) of expected cost and of the excess at risk, at points (n, d)."""
        with torch.no_grad():
            mean = model.posterior(X[:, None, :]).mean
        return mean[..., :DRAWN, 0].mean(dim=-1), mean[..., 1].amax(dim=-1) + self._margin(model)

    def _margin(self, model: ModelListGP) -> float:
        """Margin of a limit on single runs, from the noise of the excess."""
        constraint = worst_case_constraint(self._study)
        excess = model.models[1]
        scale = float(excess.outcome_transform.stdvs.squeeze())
        return constraint.deviations * float(excess.likelihood.noise.sqrt()) * scale


def _covariance(model: SingleTaskGP) -> set[str]:
    return set(model.covar_module.state_dict())


def _filled(values: list[float | None]) -> Tensor:
    """Column of values, with the largest for those that are missing."""
    largest = max((v for v in values if v is not None), default=0.0)
    column = [[largest if v is None else v] for v in values]
    return torch.tensor(column, dtype=torch.double)
