"""How much each tuned parameter matters for each metric, over the whole search space."""

from collections.abc import Mapping, Sequence
from math import isinf

import numpy as np

from bo_tuner.evidence.effects import amount
from bo_tuner.figures.figure import Axis, Bars, Color, Figure, Panel
from bo_tuner.models.categories import Coding, coded_fit
from bo_tuner.models.gaussian_process import GaussianProcess
from bo_tuner.numerics.arrays import Array
from bo_tuner.numerics.linear_effects import POWER
from bo_tuner.numerics.seeds import Stream, generator
from bo_tuner.numerics.sobol_indices import total_indices
from bo_tuner.report.analysis import OF_VALUE, Analysis
from bo_tuner.report.content import Section, Table
from bo_tuner.trials import Trial, pooled
from bo_tuner.tuning.effects import ERROR, ParameterEffects

FEWEST_FOR_EACH = 5
"""Trials for each parameter, below which a model over all of them says nothing."""
MOST_TRIALS = 200
"""Trials that the models are fitted to, evenly chosen: a fit takes time with their cube."""


def influence(analysis: Analysis) -> Section | None:
    """Show the total Sobol' indices of each metric; None for one parameter or few trials."""
    space = analysis.study.search_space()
    chosen = [
        trial
        # A repetition in the worst context alone has no mean of its own.
        for trial in pooled(analysis.trials)
        if analysis.outcome(trial) in OF_VALUE
    ]
    if space.dimension < 2 or len(chosen) < FEWEST_FOR_EACH * space.dimension:
        return None
    chosen = chosen[:: -(-len(chosen) // MOST_TRIALS)]
    responses = _responses(analysis, chosen)
    found = {name: _indices(analysis, chosen, y) for name, _, y in responses}
    if all(np.isnan(totals).any() for totals in found.values()):
        return None
    names, effects = space.names, analysis.verdict.effects
    moved = {e.metric for item in effects for e in item.effects if e.seen}
    # Of a response that none was seen to move, the model has explained noise.
    still = {name for name, mean_of, _ in responses if effects and mean_of not in {None, *moved}}
    lead = [
        f"{response}: no effect was seen."
        if response in still
        else f"{response}: most by {names[int(np.argmax(totals))]}."
        for response, totals in found.items()
        if not np.isnan(totals).any()
    ]
    return Section(
        name="influence",
        title="Influence of each parameter",
        lead=" ".join([*lead, *analysis.verdict.of_parameters]),
        figures=[_figure(names, found)],
        tables=[
            Table(
                caption="Total Sobol' indices",
                header=["response", *names],
                rows=[[response, *map(_shown, totals)] for response, totals in found.items()],
                numeric=list(range(1, 1 + len(names))),
                folded=True,
            ),
            *([_effects(effects)] if effects else []),
        ],
        notes=[
            "Total index (Homma and Saltelli 1996): the share of the variance over the search "
            "space that remains as long as this parameter is free, its interactions with others "
            "included; the indices of a response can therefore add up to more than 1.",
            f"Of the posterior means of Gaussian processes, fitted to the means of {len(chosen)} "
            "trials without failures and outliers: far from all trials they are unreliable. "
            "Parameters are taken as independent and uniform on the scale of the study; sets in "
            "the wrong order count as the permitted ones nearest to them.",
        ],
    )


def _responses(analysis: Analysis, trials: list[Trial]) -> list[tuple[str, str | None, Array]]:
    """Return each response: its name, the metric that it is the mean of, and its values (N,).

    A worst case is the mean of none.
    """
    study = analysis.study
    found: list[tuple[str, str | None, Array]] = [
        (f"mean {name}", name, np.array([np.mean(trial.observations(name)) for trial in trials]))
        for name in study.metrics
    ]
    worst: list[tuple[str, str | None, Array]] = [
        (
            f"{item.extreme} {item.metric} in the worst context",
            None,
            np.array([trial.worst_cases[item.name].value for trial in trials]),
        )
        for item in study.worst_case_constraints
        if all(item.name in trial.worst_cases for trial in trials)
    ]
    return worst + found


def _indices(analysis: Analysis, trials: list[Trial], values: Array) -> Array:
    """Return the total index (d,) of each parameter; NaN if the response does not vary."""
    space = analysis.study.search_space()
    if np.ptp(values) == 0.0:
        return np.full(space.dimension, np.nan)
    points = space.cube_of(trial.parameters for trial in trials)
    fit = coded_fit(GaussianProcess.fit, Coding(space.levels))
    rng = generator(analysis.study.seed, Stream.ACQUISITION, 2**31, len(trials))
    model = fit(points, values, rng=rng, minimum_length_scales=space.minimum_length_scales())
    return total_indices(lambda cube: model.predict_mean(space.repair(cube)), space.dimension)


def _effects(found: Sequence[ParameterEffects]) -> Table:
    """Show which effects were seen, and which ones would have been."""
    return Table(
        caption=f"Effects that were seen: a parameter that does nothing is among them with a "
        f"probability of {100.0 * ERROR:g} % at most, and one of the smallest size is not with "
        f"{100.0 * (1.0 - POWER):g} %",
        header=["parameter", "metric", "seen", "largest difference", "smallest to be seen"],
        rows=[
            [
                item.parameter,
                effect.metric,
                "yes" if effect.seen else "no",
                amount(abs(effect.change), effect),
                "–" if isinf(effect.visible) else amount(effect.visible, effect),
            ]
            for item in found
            for effect in item.effects
        ],
        numeric=[3, 4],
        folded=True,
    )


def _figure(names: tuple[str, ...], found: Mapping[str, Array]) -> Figure:
    places = np.arange(len(names), dtype=float)
    ticks = list(zip(places.tolist(), names, strict=True))
    return Figure(
        name="influence",
        title="Share of each response's variance that depends on a parameter",
        caption="Total Sobol' index: near 0, the parameter could be left at any value; near 1, "
        "hardly anything else matters.",
        alternative="; ".join(
            f"{response}: "
            + ", ".join(f"{n} {_shown(v)}" for n, v in zip(names, totals, strict=True))
            for response, totals in found.items()
        ),
        panels=[
            Panel(
                title=response,
                x=Axis(label="", ticks=ticks),
                y=Axis(label="total index", limits=(0.0, max(1.05, 1.05 * float(totals.max())))),
                elements=[
                    Bars(
                        x=places,
                        y=totals,
                        base=np.zeros(len(names)),
                        name="total index",
                        color=Color.BLUE,
                        hover=[f"{n}: {_shown(v)}" for n, v in zip(names, totals, strict=True)],
                    )
                ],
            )
            for response, totals in found.items()
            if not np.isnan(totals).any()
        ],
        columns=min(3, max(1, len(found))),
        panel_height=260,
    )


def _shown(value: float) -> str:
    return "–" if np.isnan(value) else f"{max(value, 0.0):.2f}"
