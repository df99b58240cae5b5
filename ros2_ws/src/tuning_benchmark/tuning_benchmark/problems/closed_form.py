"""Robust problems in closed form with a known optimum, of any number of parameters and contexts.

Notation: u in [0, 1]^d are the parameters on the study's own scales, x = u + sin(2πu) / (4π) the
same warped, coordinate by coordinate and increasing, so that no surrogate has it easy; x° is the
optimum by construction and Δ = x - x°; w in [-1, 1]^m are the contexts, with E[w] = 0.

Cost
    C = B(x) (1 + κ·w) exp(σ_C n - σ_C² / 2), n standard normal, with
    B(x) = 1 + Σ_i a_i (x_i - t_i)² + b (1 - cos(2πf e·Δ)). So E[C] = B(x). The minimum of the
    quadratic is at t = x° + s D, where D is parallel to A⁻¹h and A = diag(a). The ripple, e ⟂ D,
    makes local minima; it is nowhere negative and vanishes on the line x° + r D.
Constrained metric
    g = L + q·Δ + Σ_j g_j(w_j, Δ) + σ(w) n, with contexts of three kinds in turn:
    *leaning*, w (r·Δ + z p) - p, worst at one end of the interval near the optimum and at the other
    end elsewhere (z = ±1, p > 0); *tied*, w r·Δ, where both ends are as bad at the optimum; and
    *interior*, -k (w - ω - ρ·Δ)², worst at w = ω + ρ·Δ, which never leaves the interval. All
    r ⟂ D, and q = h - Σ z r over the leaning ones.
Worst case
    max_w E[g] = L + q·Δ + Σ_leaning (|r·Δ + z p| - p) + Σ_tied |r·Δ|, convex in x.
Optimum
    Since |r·Δ + z p| ≥ z r·Δ + p and |r·Δ| ≥ 0, the worst case is at least L + h·Δ, and equal to it
    on the line x° + r D near x°. Under h·Δ ≤ -ε the least of the quadratic is where its gradient
    is parallel to h: on that line, at r = -ε / h·D. There the ripple vanishes and the worst case is
    L - ε, hence it is the least of B under a worst case of at most L - ε, too:

        F(L - ε) = 1 + Q (1 + ε / V)²,   V = s h·D,   Q = Σ_i a_i (s D_i)²   (ε ≥ -V).

    A limit on the mean binds at ε = 0. One on single runs, kept with probability P, binds at
    ε = σ̂ Φ⁻¹(P), with the noise σ̂ of the worst context: in no other context on the line are
    mean or noise larger.
Noise
    σ(w) is zero, constant, or grows with the leaning contexts towards their worst ends.
Steep
    Beyond the limit the mean is L + τ (exp(d / τ) - 1) instead of L + d, like a loop that becomes
    unstable, and the noise is larger by the slope exp(d / τ). This is increasing in d and the same
    within the limit, hence the optimum is the same, too.
Law
    n has mean 0 and standard deviation 1 under each law of `noise_laws`, so the worst case is the
    same under all of them. One on single runs binds at ε = σ̂ q, with q the quantile of the law for
    P. Under the lognormal law the metric is L exp(g / L - 1 - s² / 2) with g as above and the
    constant noise σ = L s, here `LOGARITHMIC`: as E exp(s n - s² / 2) = 1, its mean is L exp of
    that of g / L - 1, which is increasing and L at L, hence the optimum is the same. One on single
    runs binds at ε = σ q - L s² / 2.
Narrow
    All contexts are of a fourth kind, *narrow*, p' (exp(-(w - ω - ρ·Δ)² / (2 b²)) - 1), like a
    resonance: worst where the interior ones are, and far better elsewhere, so that no corner of the
    contexts shows how bad the worst one is. The worst case is L + h·Δ, and the optimum the same.
Crash
    An evaluation fails where h·Δ > `CRASH`, so the optimum lies at the edge of the crash region.
Crash at the default
    An evaluation fails where the root mean square of u - u' is below `CRASH_RADIUS`. The default u'
    is near the corner of the cube that is opposite to the optimum, which is outside.
Discrete
    Each context has the values -1, 0 and 1 only. Leaning and tied contexts are worst at an end of
    their interval, so with these alone worst case and optimum are the same.
Mixed
    Every third parameter is an integer, u = u* + n / `INTEGERS` with the optimum u* at n = 0: the
    best of the grid is the best of the cube. A further parameter is a choice that multiplies the
    cost by one of `CHOICES`, the least of which is 1: the optimum is that of the cube with it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from bo_tuner.codec import checks
from bo_tuner.errors import StudyError
from bo_tuner.numerics.arrays import Array
from bo_tuner.study.study import Study
from tuning_benchmark.problems.node import NODE, ParameterizedNode, problem_study
from tuning_benchmark.problems.noise_laws import LAWS, LOGNORMAL, NORMAL, NoiseLaw
from tuning_benchmark.problems.warp import unwarped, warped

NONE, CONSTANT, HETEROSCEDASTIC = "none", "constant", "heteroscedastic"

LIMIT = 1.0
"""L, of the constrained metric."""

STEP = 0.25
"""s, with max_i |D_i| = 1."""

VIOLATION, RISE = 0.5, 0.3
"""V and Q: excess over the limit where the cost is least, and the cost of keeping the limit."""

CRASH = 0.05

CRASH_RADIUS, CRASH_EDGE = 0.35, 0.05
"""Root mean square of the distance to the default, and the distance of the default to the faces."""

INTEGERS = 12
"""Integers along an edge of the cube."""

CHOICES: Mapping[str, float] = {"a": 1.15, "b": 1.0, "c": 1.3}
"""Factor of the cost by value of the choice."""

MODE = "mode"
"""Name of the choice."""

STEEPNESS = 0.15
"""τ."""

COST_NOISE = 0.1
"""σ_C."""

LOGARITHMIC = 0.3
"""Standard deviation s of the metric's logarithm under the lognormal law."""

QUIET, LOUD = 0.02, 0.08
"""Least and largest standard deviation of the constrained metric; if constant, their mean."""

LEAN, INSIDE, CURVATURE = 0.15, 0.3, 0.5
"""p, ω and k."""

DEPTH, WIDTH = 0.5, 0.2
"""p' and b."""

LEANING, TIED, INTERIOR, NARROW = 0, 1, 2, 3
"""Kinds of contexts: the first three by their index modulo three, unless all are narrow."""

KINDS = ("crash_at_default", "discrete", "mixed")
"""Names of what makes another kind of study of a problem."""

INSIDE_KINDS = (INTERIOR, NARROW)
"""Whose worst value is inside the interval."""

RIPPLE_FREQUENCY, RIPPLE_CURVATURE = 2.0, 1.5
"""f, and the ripple's largest curvature relative to that of the mean quadratic term."""

SPREAD = 0.4
"""Standard deviation of the normal distribution of each context before truncation."""

QUANTILES = 2000
"""Runs that stand for the noise in the worst context."""


@dataclass(frozen=True, kw_only=True)
class ClosedForm:
    """A problem; its constants are drawn from a generator seeded by the two numbers.

    Attributes
    ----------
    parameters
        d ≥ 2.
    contexts
        m ≥ 1.
    noise
        ``none``, ``constant`` or ``heteroscedastic``.
    crash
        Whether there is a crash region.
    steep
        Whether the constrained metric grows exponentially beyond its limit.
    narrow
        Whether the worst value of every context is a narrow peak inside its interval.
    probability
        With which a single run must keep the limit in every context; on the mean if None.
    law
        Of the noise of the constrained metric, a key of `LAWS`.
    crash_at_default
        Whether evaluations fail around the default, which is tried first.
    discrete
        Whether the contexts have three values each.
    mixed
        Whether some parameters are integers, and a further one is a choice.

    Raises
    ------
    StudyError
        If a value is out of range, `steep` together with a `probability`, `narrow` with
        heteroscedastic noise, which grows with the leaning contexts, the lognormal law with
        another noise than the constant one, or with `steep`, or `discrete` with contexts that are
        worst inside.
    """

    parameters: int
    contexts: int
    noise: str = NONE
    crash: bool = False
    steep: bool = False
    narrow: bool = False
    probability: float | None = None
    law: str = NORMAL
    crash_at_default: bool = False
    discrete: bool = False
    mixed: bool = False

    def __post_init__(self) -> None:
        checks.integer(self.parameters, "parameters", at_least=2)
        checks.integer(self.contexts, "contexts", at_least=1)
        checks.choice(self.noise, (NONE, CONSTANT, HETEROSCEDASTIC), "noise")
        checks.boolean(self.crash, "crash")
        checks.boolean(self.steep, "steep")
        checks.boolean(self.narrow, "narrow")
        for name in KINDS:
            checks.boolean(getattr(self, name), name)
        if self.discrete and np.isin(self.kinds, INSIDE_KINDS).any():
            raise StudyError("expected contexts that are worst at an end", ("discrete",))
        if self.steep and self.probability is not None:
            raise StudyError("expected false with a limit on single runs", ("steep",))
        if self.narrow and self.noise == HETEROSCEDASTIC:
            raise StudyError("expected false with heteroscedastic noise", ("narrow",))
        checks.choice(self.law, tuple(LAWS), "law")
        if self.law != NORMAL and self.noise == NONE:
            raise StudyError("expected noise with a law", ("noise",))
        if self.law == LOGNORMAL and (self.noise != CONSTANT or self.steep):
            raise StudyError("expected constant noise and no steep with lognormal", ("law",))

    @property
    def name(self) -> str:
        """Name of the study."""
        parts = [f"closed_form_{self.parameters}_{self.contexts}", self.noise]
        parts += [name for name in ("crash", "steep", "narrow", *KINDS) if getattr(self, name)]
        parts += [self.law] if self.law != NORMAL else []
        return "_".join(parts + (["single"] if self.probability is not None else []))

    @cached_property
    def constants(self) -> "Constants":
        """The constants of the problem."""
        return _draw(self.parameters, self.kinds)

    @cached_property
    def kinds(self) -> NDArray[np.intp]:
        """The kind (m,) of each context."""
        if self.narrow:
            return np.full(self.contexts, NARROW)
        return np.arange(self.contexts) % 3

    @cached_property
    def optimum(self) -> Array:
        """Unit-cube coordinates (d,) of the optimum."""
        c, margin = self.constants, 0.0
        if self.probability is not None:
            margin = self._largest_noise * float(self._law.of_normal(ndtri(self.probability)))
            margin -= self._lowering
        return unwarped(c.x + -margin / VIOLATION * STEP * c.D)

    @property
    def best(self) -> float:
        """Expected cost at the optimum."""
        return float(self.cost(self.optimum))

    def frontier(self, worst: ArrayLike) -> Array:
        """Least expected cost under a worst case of at most `worst`, shape (...).

        Exact as long as the line x° + r D stays in the cube, a lower bound beyond.
        """
        beyond = np.asarray(worst, dtype=np.float64) - LIMIT
        if self.law == LOGNORMAL:
            beyond = LIMIT * np.log(np.maximum(beyond / LIMIT + 1.0, np.finfo(np.float64).tiny))
        if self.steep:
            beyond = np.minimum(beyond, STEEPNESS * np.log1p(np.maximum(beyond, 0.0) / STEEPNESS))
        result: Array = 1.0 + RISE * np.maximum(1.0 - beyond / VIOLATION, 0.0) ** 2
        return result

    def cost(self, u: Array) -> Array:
        """Return the expected cost B of points (..., d) of the cube, shape (...)."""
        c, x = self.constants, warped(u)
        ripple = c.b * (1.0 - np.cos(2.0 * np.pi * RIPPLE_FREQUENCY * ((x - c.x) @ c.e)))
        result: Array = 1.0 + ((x - c.t) ** 2) @ c.a + ripple
        return result

    def metric(self, u: Array, w: Array) -> Array:
        """Mean over noise of the constrained metric of points (..., d) in contexts (..., m)."""
        mean = self._gentle(u, w)
        if self.law == LOGNORMAL:
            return LIMIT * np.exp(mean / LIMIT - 1.0)
        if self.steep:
            growth = STEEPNESS * np.expm1((mean - LIMIT) / STEEPNESS)
            mean = np.where(mean > LIMIT, LIMIT + growth, mean)
        return mean

    def deviation(self, u: Array, w: Array) -> Array:
        """Return the standard deviation of the metric of points (..., d) in contexts (..., m)."""
        result = self._noise(w)
        if self.law == LOGNORMAL:
            return self.metric(u, w) * np.sqrt(np.expm1((result / LIMIT) ** 2))
        if self.steep:
            beyond = np.maximum(self._gentle(u, w) - LIMIT, 0.0)
            result = result * np.exp(beyond / STEEPNESS)
        return result

    def observed(self, u: Array, w: Array, z: Array) -> Array:
        """Return the metric of runs, points (..., d) in contexts (..., m), with normal draws z."""
        if self.law == LOGNORMAL:
            location = self._gentle(u, w) - self._lowering + self._noise(w) * z
            return LIMIT * np.exp(location / LIMIT - 1.0)
        return self.metric(u, w) + self.deviation(u, w) * self._law.of_normal(z)

    def _gentle(self, u: Array, w: Array) -> Array:
        """Return `metric` if it is not steep."""
        c = self.constants
        delta = warped(u) - c.x
        slopes = delta @ c.r.T
        kind = self.kinds
        lean = w * (slopes + c.z * LEAN) - LEAN
        apart = (w - INSIDE - slopes) ** 2
        parts = np.choose(
            kind,
            [
                lean,
                w * slopes,
                -CURVATURE * apart,
                DEPTH * np.expm1(-apart / (2.0 * WIDTH**2)),
            ],
        )
        result: Array = LIMIT + delta @ c.q + parts.sum(axis=-1)
        return result

    def _noise(self, w: Array) -> Array:
        """Return the standard deviation of the metric within its limit, in contexts (..., m)."""
        if self.noise == NONE:
            return np.zeros(np.shape(w)[:-1])
        if self.noise == CONSTANT:
            return np.full(np.shape(w)[:-1], self._largest_noise)
        leaning = self.kinds == LEANING
        towards = (1.0 + (w * self.constants.z)[..., leaning].mean(axis=-1)) / 2.0
        result: Array = QUIET + (LOUD - QUIET) * towards
        return result

    def worst_contexts(self, u: Array) -> Array:
        """Contexts (c, m) among which both mean and probability are worst for a point (d,).

        Every end of the leaning and the tied intervals, with the interior contexts at their worst
        values. The mean is linear in the others, and so is the noise, which does not depend on the
        interior ones: a quotient of both is monotonic in each, hence extreme at an end.
        """
        slopes = self.constants.r @ (warped(u) - self.constants.x)
        ends = [
            (INSIDE + slope,) if kind in INSIDE_KINDS else (-1.0, 1.0)
            for kind, slope in zip(self.kinds, slopes, strict=True)
        ]
        return np.array(list(product(*ends)))

    def worst(self, u: Array) -> tuple[float, Array]:
        """Largest mean over noise of the constrained metric at a point (d,), and its context."""
        contexts = self.worst_contexts(u)
        values = self.metric(u, contexts)
        index = int(np.argmax(values))
        return float(values[index]), contexts[index]

    def kept(self, u: Array) -> float:
        """Least probability over all contexts that a run at a point (d,) keeps the limit."""
        return float(self._law.kept(self._ratio(u)[0]))

    def crashes(self, u: Array) -> bool:
        """Whether an evaluation at a point (d,) fails."""
        if self.crash_at_default and np.sqrt(((u - self.default) ** 2).mean()) < CRASH_RADIUS:
            return True
        return self.crash and float((warped(u) - self.constants.x) @ self.constants.h) > CRASH

    @property
    def default(self) -> Array:
        """Unit-cube coordinates (d,) of the default, as far as it is no integer."""
        if not self.crash_at_default:
            return np.full(self.parameters, 0.5)
        return np.where(self.optimum < 0.5, 1.0 - CRASH_EDGE, CRASH_EDGE)

    def is_integer(self, index: int) -> bool:
        """Whether a parameter is an integer."""
        return self.mixed and index % 3 == 2

    def runs(self, u: Array) -> Array:
        """Constrained metric of runs in the context where least keep the limit.

        Its quantiles at equal steps of probability, shape (`QUANTILES`,).
        """
        context = self._ratio(u)[1]
        levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
        return self.observed(u, np.tile(context, (QUANTILES, 1)), ndtri(levels))

    def bounds(self, index: int) -> tuple[float, float, str]:
        """Return bounds and scale of a parameter; every other one is logarithmic."""
        return (-5.0, 5.0, "linear") if index % 2 == 0 else (0.01, 100.0, "log")

    def study(self) -> Study:
        """Return the study, which runs in process."""
        parameters: dict[str, Any] = {
            f"p{i + 1}": NODE | self._parameter(i) for i in range(self.parameters)
        }
        if self.mixed:
            parameters[MODE] = NODE | {
                "type": "string", "choices": list(CHOICES), "default": next(iter(CHOICES)),
            }  # fmt: skip
        context = NODE | {
            "distribution": "truncated_normal", "mean": 0.0, "standard_deviation": SPREAD,
            "bounds": [-1.0, 1.0],
        }  # fmt: skip
        if self.discrete:
            context = NODE | {"distribution": "discrete", "values": [-1.0, 0.0, 1.0]}
        limit: dict[str, Any] = {"kind": "worst_case", "metric": "stress", "upper": LIMIT}
        if self.probability is not None:
            limit["probability"] = self.probability
        settings = {
            "parameters": self.parameters, "contexts": self.contexts, "noise": self.noise,
            "crash": self.crash,
            **{name: True for name in ("steep", "narrow", *KINDS) if getattr(self, name)},
            # Where integers and default are depends on the optimum.
            **({"probability": self.probability} if self._is_placed else {}),
            **({"law": self.law} if self.law != NORMAL else {}),
        }  # fmt: skip
        return problem_study(
            f"{__name__}:Node",
            settings,
            name=self.name,
            parameters=parameters,
            contexts={f"w{j + 1}": context for j in range(self.contexts)},
            metrics={"cost": NODE, "stress": NODE},
            objective={"metric": "cost", "scale": "log"},
            constraints={"stress": limit},
            **({"start": ["default"]} if self.crash_at_default else {}),
        )

    @property
    def _is_placed(self) -> bool:
        """Whether the study depends on where the optimum is, with its probability."""
        return self.probability is not None and (self.mixed or self.crash_at_default)

    def _parameter(self, index: int) -> dict[str, Any]:
        """Return the keys of a parameter in the study."""
        place = float(self.default[index])
        if self.is_integer(index):
            low, high = self._integers(index)
            nearest = round((place - self.optimum[index]) * INTEGERS)
            default = min(max(nearest, low), high)
            return {"type": "integer", "bounds": [low, high], "default": default}
        lower, upper, scale = self.bounds(index)
        default = lower + (upper - lower) * place
        if scale == "log":
            default = float(np.exp(np.log(lower) + (np.log(upper) - np.log(lower)) * place))
        return {"type": "double", "bounds": [lower, upper], "scale": scale, "default": default}

    def _integers(self, index: int) -> tuple[int, int]:
        """Return the least and the largest integer whose place is in the cube."""
        u = float(self.optimum[index])
        return -int(u * INTEGERS), int((1.0 - u) * INTEGERS)

    def factor(self, values: Mapping[str, Any]) -> float:
        """Return the factor of the cost by the choice."""
        return CHOICES[values[MODE]] if self.mixed else 1.0

    def point(self, values: Mapping[str, Any]) -> Array:
        """Unit-cube coordinates (d,) of the parameters ``p1`` to ``pd``."""
        u = np.empty(self.parameters)
        for i in range(self.parameters):
            value = values[f"p{i + 1}"]
            if self.is_integer(i):
                u[i] = self.optimum[i] + value / INTEGERS
                continue
            lower, upper, scale = self.bounds(i)
            if scale == "log":
                lower, upper, value = np.log(lower), np.log(upper), np.log(value)
            u[i] = (value - lower) / (upper - lower)
        return u

    @property
    def _law(self) -> NoiseLaw:
        return LAWS[self.law]

    @property
    def _largest_noise(self) -> float:
        """Largest σ: of g, under the lognormal law, too."""
        if self.law == LOGNORMAL:
            return LIMIT * LOGARITHMIC
        return {NONE: 0.0, CONSTANT: (QUIET + LOUD) / 2.0, HETEROSCEDASTIC: LOUD}[self.noise]

    @property
    def _lowering(self) -> float:
        """By how much g is lowered so that noise does not raise the metric's mean, L s² / 2."""
        return self._largest_noise**2 / (2.0 * LIMIT) if self.law == LOGNORMAL else 0.0

    def _ratio(self, u: Array) -> tuple[float, Array]:
        """Least distance to the limit in standard deviations, and its context."""
        contexts = self.worst_contexts(u)
        if self.law == LOGNORMAL:
            left = LIMIT - self._gentle(u, contexts) + self._lowering
            deviation = self._noise(contexts)
        else:
            left = LIMIT - self.metric(u, contexts)
            deviation = self.deviation(u, contexts)
        certain = np.where(left >= 0.0, np.inf, -np.inf)
        ratio = np.divide(left, deviation, out=certain, where=deviation > 0.0)
        # Without noise all that exceed the limit are alike; of these the worst counts.
        index = int(np.lexsort((left, ratio))[0])
        return float(ratio[index]), contexts[index]


@dataclass(frozen=True)
class Constants:
    """Constants of a problem; the names are those of the module's text."""

    x: Array
    D: Array
    h: Array
    a: Array
    t: Array
    e: Array
    b: float
    r: Array
    z: Array
    q: Array
    kappa: Array = field(repr=False)


class Node(ParameterizedNode):
    """A node that evaluates a problem; its parameters are the problem's, and the point."""

    def evaluate(self) -> dict[str, object]:
        """Evaluate cost and stress once."""
        values = self.values
        problem = problem_of(values)
        u = problem.point(values)
        if problem.crashes(u):
            return {"status": "error", "reason": "crashed"}
        w = np.array([values[f"w{j + 1}"] for j in range(problem.contexts)])
        noise = np.random.default_rng(int(values["seed"])).standard_normal(2)
        sigma = 0.0 if problem.noise == NONE else COST_NOISE
        cost = problem.cost(u) * problem.factor(values) * (1.0 + problem.constants.kappa @ w)
        cost *= np.exp(sigma * noise[0] - sigma**2 / 2.0)
        stress = problem.observed(u, w, noise[1])
        return {"status": "ok", "reason": "", "cost": float(cost), "stress": float(stress)}


def problem_of(settings: Mapping[str, Any]) -> ClosedForm:
    """Return the problem that parameters of the node describe."""
    return ClosedForm(
        parameters=int(settings["parameters"]),
        contexts=int(settings["contexts"]),
        noise=str(settings["noise"]),
        crash=bool(settings["crash"]),
        steep=bool(settings.get("steep", False)),
        narrow=bool(settings.get("narrow", False)),
        law=str(settings.get("law", NORMAL)),
        probability=settings.get("probability"),
        **{name: bool(settings.get(name, False)) for name in KINDS},
    )


def problem_of_study(study: Study) -> ClosedForm:
    """Return the problem of a study that was made by `ClosedForm.study`."""
    (node,) = study.nodes.values()
    (limit,) = study.worst_case_constraints
    return replace(problem_of(node.parameters), probability=limit.probability)


def _draw(parameters: int, kind: NDArray[np.intp]) -> Constants:
    """Draw the constants; each scale follows from what the module's text asks for.

    Parameters
    ----------
    parameters
        d.
    kind : ndarray, shape (m,)
        Kinds of the contexts.
    """
    contexts = len(kind)
    rng = np.random.default_rng((20_201_115, parameters, contexts))
    x = warped(rng.uniform(0.35, 0.65, parameters))
    a = np.exp(rng.uniform(np.log(0.3), np.log(3.0), parameters))
    h = rng.uniform(0.5, 1.5, parameters) * rng.choice([-1.0, 1.0], parameters)
    D = h / a
    D /= np.abs(D).max()
    h *= VIOLATION / (STEP * (h @ D))
    a *= RISE / (STEP**2 * (a @ D**2))
    across = rng.standard_normal((contexts + 1, parameters))
    across -= np.outer(across @ D, D) / (D @ D)
    across /= np.linalg.norm(across, axis=1)[:, None]
    e, r = across[0], across[1:]
    # An interior worst context stays in its interval: |ω| + |ρ|₁ max|Δ| < 1.
    size = np.where(kind == LEANING, 0.6, np.where(kind == TIED, 1.0, 0.0))
    inside = np.isin(kind, INSIDE_KINDS)
    largest = np.maximum(x, 1.0 - x).max()
    r = np.where(
        inside[:, None],
        r * 0.6 / (np.abs(r).sum(axis=1)[:, None] * largest),
        r * size[:, None],
    )
    z = rng.choice([-1.0, 1.0], contexts)
    leaning: NDArray[np.bool_] = kind == LEANING
    return Constants(
        x=x,
        D=D,
        h=h,
        a=a,
        t=x + STEP * D,
        e=e,
        b=float(RIPPLE_CURVATURE * 2.0 * a.mean() / (2.0 * np.pi * RIPPLE_FREQUENCY) ** 2),
        r=r,
        z=z,
        q=h - (z[leaning, None] * r[leaning]).sum(axis=0),
        kappa=rng.choice([-1.0, 1.0], contexts) * 0.3 / contexts,
    )
