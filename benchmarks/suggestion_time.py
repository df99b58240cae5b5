"""Time of a whole proposal, side by side with BoTorch and Optuna, and its growth with the trials.

The data are trials of the four-parameter study: half of them a Latin hypercube, half around a good
point, as a run leaves them; each with five replicates of objective and return time and one worst
overshoot. All contenders are asked for the next parameter set in one process with one thread, in
turn, several times; the ratios of each turn are what counts, not the seconds. The time is that of
the processor, which other load on the machine disturbs less than the clock's. The others are asked
with up to `RIVALS_UP_TO` trials only.

boundary, IV
    The whole proposal of the algorithm: surrogates of objective, return time and worst case on all
    data, the Student-t process that finds outliers, crashes, acquisition by particle swarm; of
    `boundary` one of its second part, with the ranking of all parameter sets. Its models have every
    evaluation as their data; it makes about three a trial, so it has two of the replicates and the
    worst overshoot of each. Both start from the hyperparameters of the trial before, as in a
    run. Beyond a hundred trials these are fitted again only now and then: the time is the mean over
    the trials between two fits, and that of a proposal with a fit is listed, too. `boundary` also
    without a warm start.
BoTorch
    Two `SingleTaskGP` (objective, worst case) on the means of the replicates, fitted by
    `fit_gpytorch_mll`; `qLogNoisyExpectedImprovement` with one constraint, by `optimize_acqf` with
    10 restarts and 512 raw samples. It neither models the return time, nor rounds integers, nor
    searches outliers: all that would add to its time.
Optuna
    `GPSampler` with one constraint, on the means too; it has suggested once before, so that it
    starts from its earlier kernels.
BoTorch, Optuna, every evaluation
    The same with the data that `boundary` has: every evaluation is a trial of theirs.

Needs requirements/benchmarks.txt, in an environment of its own:

  python -m venv /tmp/compare && /tmp/compare/bin/pip install -r requirements/runtime.txt \
      -r requirements/benchmarks.txt ros2_ws/src/*
"""

import os
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from unittest.mock import patch

# Before the libraries that read them.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import botorch
import numpy as np
import optuna
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.fit import fit_gpytorch_mll
from botorch.models import ModelListGP, SingleTaskGP
from botorch.optim import optimize_acqf
from botorch.sampling.normal import SobolQMCNormalSampler
from common import OTHER_PACKAGES, opened, provenance, result_parser, table, write_result
from gpytorch.mlls import SumMarginalLogLikelihood

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.methods.registry import METHODS
from bo_tuner.models import fitting, surrogates
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import (
    Context,
    Evaluation,
    EvaluationState,
    Stage,
    Trial,
    TrialState,
    Value,
    WorstCase,
)
from bo_tuner.tuning.driver import Driver
from tuning_benchmark.peers.optuna_samplers import distribution

SEED = 20_201_116
REPLICATES = 5
OF_BOUNDARY = 2
"""Replicates of a trial that `boundary` has; with the worst case that is three evaluations.

In the published campaigns of this study it makes 3.2 a trial on average.
"""

GOOD_POINT = {"control_horizon": 8, "prediction_horizon": 8, "lambda_mpc": -0.8, "lambda_kf": -1.0}
SPREAD = 0.12
"""Standard deviation in the unit cube around the good point."""

WORST_CONTEXT = {"stiffness_factor": 1.3, "damping_factor": 0.7}

FITTED = " with a fit"
OURS = ("boundary", f"boundary{FITTED}", "boundary without warm start", "IV", f"IV{FITTED}")
EVERY = ", every evaluation"
OTHERS = ("BoTorch", f"BoTorch{EVERY}", "Optuna", f"Optuna{EVERY}")
RIVALS_UP_TO = 300
"""Trials; an exact process with more takes too long to ask it several times."""


def make_trials(study: Study, count: int) -> list[Trial]:
    """Evaluate `count` parameter sets; what failed is left out, for all have the same data."""
    rng = np.random.default_rng(SEED)
    space, contexts = study.search_space(), study.context_space()
    design = space.latin_hypercube(count, rng)
    around = space.to_cube(GOOD_POINT) + rng.normal(0.0, SPREAD, (count, space.dimension))
    points = np.where((np.arange(count) % 2 == 0)[:, None], design, space.repair(around))
    trials: list[Trial] = []
    with opened(InProcessBackend(study)) as backend:
        for point in points:
            parameters = space.to_parameters(point)
            drawn = contexts.draw_stratified(REPLICATES, rng)
            chosen: list[Context] = [*map(contexts.to_dict, drawn), WORST_CONTEXT]
            evaluations = []
            for index, context in enumerate(chosen):
                seed = int(rng.integers(2**31))
                stage = Stage.DRAWN if index < REPLICATES else Stage.SEARCH
                planned = Evaluation(len(trials), index, stage, parameters, context, seed)
                evaluations.append(Driver(backend).evaluate(planned))
            if any(
                evaluation.outcome.state is not EvaluationState.COMPLETE
                for evaluation in evaluations
            ):
                continue
            worst = evaluations[-1].outcome.metrics["overshoot"]
            trials.append(
                Trial(
                    number=len(trials),
                    parameters=parameters,
                    origin="initial",
                    state=TrialState.COMPLETE,
                    evaluations=tuple(evaluations),
                    worst_cases={"overshoot": WorstCase(worst, WORST_CONTEXT, worst, 0.01)},
                )
            )
    return trials


class Problem:
    """The same trials in the form that each contender takes, ready to be asked."""

    def __init__(self, study: Study, trials: list[Trial], seed: int) -> None:
        self._space = study.search_space()
        self._limit = study.constraints["overshoot"].upper
        self._study = study.replace(seed=seed)
        self._seed = seed
        names = self._space.names
        self._trials = trials
        self._tuned = [{n: t.parameters[n] for n in names} for t in trials]
        metric = study.objective.metric
        means = [np.mean(t.observations(metric)) for t in trials]
        self._cost = np.log(np.array(means))
        worst = [t.worst_cases["overshoot"].value for t in trials]
        self._excess = np.array(worst) - self._limit

    def ours(self, contender: str) -> Callable[[], object]:
        """Make ready our stage one; with a warm start it has proposed one trial before."""
        name, _, cold = contender.partition(" ")
        stage_one = METHODS[name].optimizer(self._study)
        trials = self._trials
        if name == "boundary":
            trials = self._of_boundary()
        for trial in trials[:-1]:
            stage_one.tell(trial)
        last = trials[-1]
        if not cold:
            # A run's warm start travels with the trial that was proposed.
            earlier = stage_one.ask().hyperparameters
            if not earlier:
                raise RuntimeError("the proposal before has no hyperparameters to start from")
            last = replace(last, hyperparameters=earlier)
        stage_one.tell(last)
        return lambda: stage_one.ask().parameters

    def _of_boundary(self) -> list[Trial]:
        """Return the trials with as many evaluations as `boundary` makes."""
        return [
            replace(t, evaluations=t.evaluations[:OF_BOUNDARY] + t.evaluations[REPLICATES:])
            for t in self._trials
        ]

    def _data(self, every: bool) -> list[tuple[dict[str, Value], float, float]]:
        """Return parameters, cost and excess over the limit: of means, or of all evaluations."""
        if not every:
            return list(zip(self._tuned, self._cost, self._excess, strict=True))
        metric = self._study.objective.metric
        return [
            (tuned, np.log(found[metric]), found["overshoot"] - self._limit)
            for tuned, trial in zip(self._tuned, self._of_boundary(), strict=True)
            for found in (evaluation.outcome.metrics for evaluation in trial.evaluations)
        ]

    def botorch(self, every: bool) -> Callable[[], object]:
        """Make ready BoTorch's data, of means or of all evaluations."""
        tuned, cost, excess = zip(*self._data(every), strict=True)
        X = torch.tensor(np.array([self._space.to_cube(t) for t in tuned]))
        Y = torch.tensor(np.column_stack([-np.array(cost), excess]))
        torch.manual_seed(self._seed)

        def suggest() -> object:
            model = ModelListGP(SingleTaskGP(X, Y[:, :1]), SingleTaskGP(X, Y[:, 1:]))
            fit_gpytorch_mll(SumMarginalLogLikelihood(model.likelihood, model))
            acquisition = qLogNoisyExpectedImprovement(
                model=model,
                X_baseline=X,
                sampler=SobolQMCNormalSampler(torch.Size([128]), seed=self._seed),
                objective=GenericMCObjective(lambda samples, X=None: samples[..., 0]),
                constraints=[lambda samples: samples[..., 1]],
                prune_baseline=True,
            )
            bounds = torch.stack([torch.zeros(X.shape[1]), torch.ones(X.shape[1])]).double()
            return optimize_acqf(acquisition, bounds, q=1, num_restarts=10, raw_samples=512)

        return suggest

    def optuna(self, every: bool) -> Callable[[], object]:
        """Make ready an Optuna study, of means or of all evaluations, that has suggested before."""
        distributions = {
            name: distribution(self._study.parameters[name]) for name in self._space.names
        }
        study = optuna.create_study(
            sampler=optuna.samplers.GPSampler(seed=self._seed, n_startup_trials=1)
        )
        latest = OF_BOUNDARY + 1 if every else 1
        rows = [
            optuna.trial.create_trial(
                params=tuned,
                distributions=distributions,
                value=float(cost),
                constraints={"overshoot": float(excess)},
            )
            for tuned, cost, excess in self._data(every)
        ]
        study.add_trials(rows[:-latest])
        pending = study.ask(distributions)
        study.tell(pending, state=optuna.trial.TrialState.FAIL)
        study.add_trials(rows[-latest:])
        return lambda: study.ask(distributions).params

    def ready(self, contender: str) -> Callable[[], object]:
        """Make a contender ready to suggest."""
        every = contender.endswith(EVERY)
        if contender.startswith("BoTorch"):
            return self.botorch(every)
        if contender.startswith("Optuna"):
            return self.optuna(every)
        return self.ours(contender)


def measure(study: Study, trials: list[Trial], count: int, repeats: int) -> dict[str, list[float]]:
    """Processor seconds of each contender's proposal, `repeats` times in turn."""
    contenders = OURS + (OTHERS if count <= RIVALS_UP_TO else ())
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    rng = np.random.default_rng((SEED, count))
    for repeat in range(-1, repeats):
        chosen = [trials[i] for i in rng.permutation(len(trials))[:count]]
        numbered = [replace(trial, number=number) for number, trial in enumerate(chosen)]
        problem = Problem(study, numbered, seed=repeat + 2)
        # In another order every time, lest one always follows the same other.
        for index in range(len(contenders)):
            contender = contenders[(index + repeat) % len(contenders)]
            suggest = problem.ready(contender)
            with patch.object(surrogates, "fitted_after", lambda _, f=FITTED in contender: f):
                begin = time.process_time()
                suggest()
                if repeat >= 0:  # The first turn only warms up imports and caches.
                    seconds[contender].append(time.process_time() - begin)
    share = 1.0
    if count > fitting.FITTED_EACH:
        share = np.log1p(1.0 / count) / np.log1p(fitting.GROWTH)
    for name in ("boundary", "IV"):
        pairs = zip(seconds[name], seconds[name + FITTED], strict=True)
        seconds[name] = [share * fitted + (1.0 - share) * kept for kept, fitted in pairs]
    return seconds


def summarize(seconds: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    """Median seconds, and ratios to `boundary` and to IV of the same turn: median and range."""
    summary = {}
    for contender, values in seconds.items():
        numbers = {"median_seconds": float(np.median(values))}
        for base in ("boundary", "IV"):
            ratios = np.array(values) / np.array(seconds[base])
            numbers |= {
                f"median_to_{base}": float(np.median(ratios)),
                f"lowest_to_{base}": float(ratios.min()),
                f"highest_to_{base}": float(ratios.max()),
            }
        summary[contender] = numbers
    return summary


def growth(summaries: dict[int, dict[str, dict[str, float]]]) -> dict[str, float]:
    """Return by contender k of the least-squares fit of median time ~ trials^k."""
    found = {}
    for contender in OURS:
        seconds = [summary[contender]["median_seconds"] for summary in summaries.values()]
        found[contender] = float(np.polyfit(np.log(list(summaries)), np.log(seconds), 1)[0])
    return found


def main() -> None:
    """Run the command."""
    parser = result_parser(__doc__, "suggestion_time.json")
    parser.add_argument("--counts", type=int, nargs="+", default=[50, 150, 300, 1000])
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.simplefilter("ignore")
    about = provenance((*OTHER_PACKAGES, "torch", "botorch", "gpytorch", "optuna"))
    largest = max(arguments.counts)
    study = load_study("full")
    # A few more than needed: those that fail are left out.
    trials = make_trials(study, largest + largest // 5 + 10)
    # The last trial of a run is asked for: `boundary` has searched by then.
    every = {
        count: measure(
            study.replace(trials=count + 1, initial_trials=1), trials, count, arguments.repeats
        )
        for count in arguments.counts
    }
    summaries = {count: summarize(seconds) for count, seconds in every.items()}
    exponents = growth(summaries)
    result = {
        "provenance": about | {"seed": SEED},
        "counts": {
            str(count): {"seconds": every[count], "summary": summary}
            for count, summary in summaries.items()
        },
        "growth": exponents,
    }
    write_result(arguments.result, result)
    rows = [
        [count, name, item["median_seconds"], item["median_to_boundary"], item["median_to_IV"]]
        for count, summary in summaries.items()
        for name, item in summary.items()
    ]
    print(f"BoTorch {botorch.__version__}, Optuna {optuna.__version__}, one thread")
    print(table(["trials", "contender", "median [s]", "to boundary", "to IV"], rows))
    print(", ".join(f"{name} grows as trials^{k:.2f}" for name, k in exponents.items()))


if __name__ == "__main__":
    main()
