"""BoTorch's constrained noisy expected improvement (qLogNEI) on one Gaussian process per outcome.

Sources
    https://botorch.org/docs/tutorials/closed_loop_botorch_only (the loop and its settings: ten
    restarts, 512 raw samples), https://botorch.org/docs/constraints, Ament et al. 2023 (LogEI),
    Hvarfner et al. 2024 (the default priors of `SingleTaskGP`).
Noise
    Learned. ``train_Yvar`` is for a noise that is known; a standard error from the few evaluations
    of a trial, in contexts that are drawn stratified, is not.
Integers
    Rounded inside the model by the input transform `Round` with straight-through gradients
    (Daulton et al. 2022), between reverse and forward scaling as in its documentation; the
    candidate is rounded after the search.
Order of two parameters
    Linear inequality constraints of `optimize_acqf`, where both have the same scale.
Failed trials
    Learned: once there is one, one more process is fitted to labels, -1 for a trial that ended and
    +1 for a crash, as one more constraint (least-squares classification, Rasmussen and Williams
    2006, Sec. 6.5). https://botorch.org/docs/notebooks_community/clf_constrained_bo does the same
    with a variational classifier. The other models do not see them.
Too few trials
    Until two have ended there is nothing to fit: points of a scrambled Sobol sequence, as the
    tutorials start.
Recommendation
    Lowest posterior mean of the objective among the trials whose posterior means keep all limits.
"""

from collections.abc import Sequence

import numpy as np
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.fit import fit_gpytorch_mll
from botorch.models import ModelListGP, SingleTaskGP
from botorch.models.transforms.input import ChainedInputTransform, Log10, Normalize, Round
from botorch.optim import optimize_acqf
from botorch.sampling.normal import SobolQMCNormalSampler
from botorch.utils.sampling import manual_seed
from gpytorch.mlls import SumMarginalLogLikelihood
from torch import Tensor
from torch.quasirandom import SobolEngine

from bo_tuner.study.study import Study
from bo_tuner.trials import Value
from tuning_benchmark.peers.optimizer import Observation, best_observed, excesses, tuned

RESTARTS, RAW_SAMPLES, POSTERIOR_SAMPLES = 10, 512, 256
OPTIONS = {
    "maxiter": 200,
    "batch_limit": RESTARTS,
    # Both only save time: few large batches, and a random walk between the linear constraints that
    # gives starting points, which need not be as independent as by default.
    "init_batch_limit": RAW_SAMPLES,
    "n_burnin": 1000,
    "n_thinning": 4,
}
FEWEST = 2
"""So many trials must have ended before a model is fitted."""


class BoTorch:
    """Constrained qLogNEI."""

    def __init__(self, study: Study, seed: int) -> None:
        self._study = study
        self._space = study.search_space()
        self._seed = seed
        self._observations: list[Observation] = []
        self._points: list[np.ndarray[tuple[int], np.dtype[np.float64]]] = []
        logarithmic = np.array([study.parameters[n].scale == "log" for n in self._space.names])
        bounds = np.array([self._space.lower, self._space.upper])
        # On the scale on which the cube is linear.
        self._bounds = np.where(logarithmic, np.log10(np.where(logarithmic, bounds, 1.0)), bounds)
        self._logarithmic = logarithmic

    def ask(self) -> dict[str, Value]:
        """Maximize the acquisition function."""
        seed = self._stream()
        if sum(not o.failed for o in self._observations) < FEWEST:
            engine = SobolEngine(self._space.dimension, scramble=True, seed=self._seed)
            point = engine.draw(len(self._points) + 1, dtype=torch.double)[-1]
        else:
            with manual_seed(seed):
                point = self._maximize(seed)
        return tuned(self._space, self._space.to_parameters(point.numpy()))

    def tell(self, observation: Observation) -> None:
        """Keep an observation."""
        self._observations.append(observation)
        self._points.append(self._space.to_cube(observation.parameters))

    def recommend(self) -> int | None:
        """Best posterior mean among the feasible ones."""
        ended = [i for i, o in enumerate(self._observations) if not o.failed]
        if len(ended) < FEWEST:
            return best_observed(self._observations)
        # A fit that is tried again draws its start.
        with manual_seed(self._stream()):
            model = self._fit()
        with torch.no_grad():
            mean = model.posterior(self._inputs(ended)).mean.numpy()
        feasible = np.all(mean[:, 1:] <= 0.0, axis=1)
        if not feasible.any():
            return None
        return ended[int(np.argmax(np.where(feasible, mean[:, 0], -np.inf)))]

    def _stream(self) -> int:
        """Seed of what is random now, which depends on the number of trials alone."""
        return int(np.random.SeedSequence((self._seed, len(self._points))).generate_state(1)[0])

    def _inputs(self, indices: Sequence[int]) -> Tensor:
        return torch.tensor(np.array([self._points[i] for i in indices]))

    def _fit(self) -> ModelListGP:
        """Fit the models: objective (to be maximized), constraints, and crash if there was one."""
        ended = [o for o in self._observations if not o.failed]
        X = self._inputs([i for i, o in enumerate(self._observations) if not o.failed])
        cost = [[-float(o.objective or 0.0)] for o in ended]
        models = [self._model(X, cost)]
        rows = [excesses(self._study, o) for o in ended]
        models += [self._model(X, [[row[name]] for row in rows]) for name in rows[0]]
        if len(ended) < len(self._observations):
            labels = [[1.0 if o.failed else -1.0] for o in self._observations]
            models.append(self._model(self._inputs(range(len(labels))), labels))
        model = ModelListGP(*models)
        fit_gpytorch_mll(SumMarginalLogLikelihood(model.likelihood, model))
        return model

    def _model(self, X: Tensor, y: list[list[float]]) -> SingleTaskGP:
        Y = torch.tensor(y, dtype=torch.double)
        return SingleTaskGP(X, Y, input_transform=self._rounding())

    def _rounding(self) -> ChainedInputTransform | None:
        """From the cube to own units, round the integers, and back to the cube."""
        integers = np.flatnonzero(self._space.integer).tolist()
        if not integers:
            return None
        logarithmic = np.flatnonzero(self._logarithmic & self._space.integer).tolist()
        scaling = {"d": self._space.dimension, "bounds": torch.tensor(self._bounds)}
        return ChainedInputTransform(
            unscale=Normalize(**scaling, reverse=True),
            power=Log10(logarithmic, reverse=True),
            round=Round(integers),
            log=Log10(logarithmic),
            scale=Normalize(**scaling),
        )

    def _maximize(self, seed: int) -> Tensor:
        """Point of the cube, shape (d,), with the largest acquisition."""
        model = self._fit()
        ended = [i for i, o in enumerate(self._observations) if not o.failed]
        acquisition = qLogNoisyExpectedImprovement(
            model=model,
            X_baseline=self._inputs(ended),
            sampler=SobolQMCNormalSampler(torch.Size([POSTERIOR_SAMPLES]), seed=seed),
            objective=GenericMCObjective(lambda samples, X=None: samples[..., 0]),
            constraints=[lambda samples, k=k: samples[..., k] for k in range(1, model.num_outputs)]
            or None,
            prune_baseline=True,
        )
        candidate, _ = optimize_acqf(
            acquisition,
            bounds=torch.tensor([[0.0], [1.0]], dtype=torch.double).repeat(1, len(self._bounds[0])),
            q=1,
            num_restarts=RESTARTS,
            raw_samples=RAW_SAMPLES,
            options=OPTIONS,
            inequality_constraints=self._order() or None,
        )
        return candidate[0]

    def _order(self) -> list[tuple[Tensor, Tensor, float]]:
        """Order constraints a <= b in the cube, as sums that are at least their last number."""
        names, (lower, upper) = self._space.names, self._bounds
        constraints = []
        for smaller, larger in self._space.order:
            if smaller in names and larger in names:
                i, j = names.index(smaller), names.index(larger)
                if self._logarithmic[i] == self._logarithmic[j]:
                    weights = torch.tensor([lower[i] - upper[i], upper[j] - lower[j]])
                    constraints.append((torch.tensor([i, j]), weights, float(lower[i] - lower[j])))
        return constraints
