"""Sections on what answers are worth: certificates, safe searches, simulations, drift."""

import statistics
from collections.abc import Iterable, Sequence

from plain_problem import summary
from sections.layout import Result

from tuning_benchmark.pages.tables import markdown

SAVED = "13daafaf5a"
"""Commit with certificates that saved runs by rules that did not keep the level."""


def certificates(result: Result) -> list[str]:
    """How often a certificate passes what is feasible, and what is just not."""
    rows = [
        [
            case["title"],
            *(f"{found['passed']} of {found['certified']}" for found in (answer, infeasible)),
            *(f"{answer['median_evaluations']:g}", answer["most_evaluations"]),
            f"{answer['median_of_least']:.1f}",
            case.get("commit", result["provenance"]["commit"])[:10],
        ]
        for case in result["cases"].values()
        for answer, infeasible in [(case["answer"], case["infeasible"])]
    ]
    runs = [r for case in result["cases"].values() for r in case["runs"] if "answer" in r]
    wrong = [run for run in runs if not run["feasible"]]
    passed = sum(run["answer"]["passed"] for run in runs if run["feasible"])
    failed = (
        f"; of the {len(wrong)} truly infeasible, "
        f"{sum(run['answer']['passed'] for run in wrong)} pass"
        if wrong
        else "; none is truly infeasible"
    )
    commits = {row[-1] for row in rows}
    saved = f" Certificates of {SAVED} saved runs by rules that are gone." * (SAVED in commits)
    return [
        "Answers of `boundary` from the recorded campaigns, certified by the study's default "
        "certificate, and beside each a parameter set that is just infeasible, found by bisection. "
        f"Of the answers, {len(runs) - len(wrong)} are truly feasible, and {passed} of these "
        f"pass{failed}. Evaluations are those of the answers; *times the least*: their median as a "
        f"multiple of the fewest that show all limits.{saved}",
        markdown(
            [
                "problem",
                "PASS of answers",
                "PASS of just infeasible",
                "evaluations, median",
                "largest",
                "times the least",
                "commit",
            ],
            rows,
        ),
    ]


def example_certificates(result: Result) -> list[str]:
    """Tell what the certificates of the third-party examples take."""
    rows = [
        [
            example,
            run["seed"],
            "PASS" if run["passed"] else "FAIL",
            run["evaluations"],
            f"{run['evaluations'] / run['least']:.1f}",
        ]
        for example, runs in result["examples"].items()
        for run in runs
    ]
    return [
        "Results of the [third-party systems](examples.md) that were tuned over ROS, certified in "
        "process: their flights are those of the example's own judge, and nothing is known of "
        "their worst contexts.",
        markdown(["example", "seed", "verdict", "flights", "times the least"], rows),
    ]


def false_passes(result: Result) -> list[str]:
    """Tell how often parameter sets that break a limit pass, and after how many runs."""
    rows = []
    for case in result["cases"].values():
        runs = case["runs"]
        passed = [run["passed"] for run in runs]
        rows.append(
            [
                case["title"],
                f"{passed.count(1)} of {len(runs)}",
                f"{len(runs) - passed.count(None)} of {len(runs)}",
                statistics.median(run["first"] for run in runs),
            ]
        )
    return [
        "Parameter sets that break their worst-case limit, certified up to five times until they "
        "pass; stated are 4 % at first and 5 % in five attempts. *Runs*: the median of the first "
        "certificate. A mean without a range is not proven by a PASS, but shown with an *if*.",
        markdown(["case", "PASS at first", "in five attempts", "runs"], rows),
    ]


def single_run_limits(result: Result) -> list[str]:
    """Tell how often a promise is kept, and what the answer costs, beside random sampling."""
    rows = []
    for case in result["cases"].values():
        row = [case["title"]]
        for found in (case["runs"], [run["random"] for run in case["runs"]]):
            shown = [run for run in found if run.get("shown")]
            above = [run["above"] for run in found if run.get("keeps")]
            row += [
                f"{sum(run['keeps'] for run in shown)} of {len(shown)}",
                f"{len(above)} of {len(found)}",
                f"{100.0 * statistics.median(above):.0f}" if above else "",
                f"{statistics.median(run['runs'] for run in found):g}",
            ]
        rows.append(row)
    return [
        "Answers under a limit that a run must keep with a probability P, over the contexts "
        "(*drawn*) or in each (*worst*), by the truth: how many keep it of those that are said to, "
        "and of all, and the median of the cost above the optimum of those that do. Beside them "
        "random sampling (II) with about as many runs.",
        markdown(
            [
                "case",
                *("kept of feasible", "of all", "above [%]", "runs"),
                *("random: kept of feasible", "of all", "above [%]", "runs"),
            ],
            rows,
        ),
    ]


def safety(result: Result) -> list[str]:
    """Say how often a safe search breaks a limit, beside a plain one, and what it costs."""
    rows = []
    for case, found in result["cases"].items():
        summary = found["summary"]
        shares = [
            f"{summary[which]['broken']} of {summary[which]['trials']}"
            for which in ("plain", "safe")
        ]
        ratio = "none" if summary["ratio"] is None else f"{summary['ratio']:.2f}"
        rows.append([case, *shares, f"{summary['reached']} of {len(summary['runs'])}", ratio])
    return [
        "A plain search and a safe one with twice as many trials, from the same parameter set that "
        "keeps all limits: trials of which a run broke a limit or failed, in how many seeds the "
        "safe search became as good as the plain one, within 5 %, and for how many times as many "
        "runs, in the median.",
        markdown(["case", "plain: broken", "safe: broken", "as good", "times as many runs"], rows),
    ]


def simulation_prior(result: Result) -> list[str]:
    """Say what results on hidden machines are worth, with and without their simulation."""
    rows = []
    for plant in dict.fromkeys(row["plant"] for row in result["rows"]):
        for knowing, title in ((False, "alone"), (True, "with the simulation")):
            own = [r for r in result["rows"] if (r["plant"], r["knowing"]) == (plant, knowing)]
            objectives = [row["objective"] for row in own]
            trials = len(own) * result["trials"]
            rows.append(
                [
                    plant,
                    title,
                    f"{sum(row['feasible'] for row in own)} of {len(own)}",
                    f"{statistics.median(objectives):.3f}",
                    f"{min(objectives):.3f} to {max(objectives):.3f}",
                    f"{sum(row['broken'] for row in own)} of {trials}",
                ]
            )
    return [
        f"A hidden axis is tuned with {result['trials']} trials, without and with the 30 trials of "
        "a simulation as prior knowledge: whether the result keeps all limits, its objective "
        "(median and range over the seeds), and the trials of which a run broke a limit or failed.",
        markdown(["axis", "tuned", "feasible", "objective", "range", "trials broken"], rows),
    ]


def estimators(result: Result) -> list[str]:
    """Tell what a filter that is tuned on a few drives is worth on others."""
    runs = result["runs"]
    rows = []
    for key, title in (
        ("default", "default"),
        ("tpe", "Optuna's TPE, on the mean error"),
        ("tuner", "`boundary`"),
        ("optimum", "optimum of the mean error"),
    ):
        errors = [run["errors"][key] for run in runs]
        kept = 100.0 * statistics.mean(run["kept"][key] for run in runs)
        rows.append([title, f"{statistics.mean(errors):.3f}", f"{max(errors):.3f}", f"{kept:.0f}"])
    passed = [run for run in runs if run["passed"]]
    hold = sum(run["kept"]["tuner"] >= result["asked"] for run in passed)
    return [
        f"The filter of the example, tuned on {result['used']} drives of {result['seconds']:g} s "
        f"({statistics.median(run['runs'] for run in runs):g} runs, the median), then run on "
        f"{result['fresh']} drives that were not used; {len(runs)} seeds, each with other drives. "
        f"The consistency is to be {result['least']:g} at least, which the tuner alone is told.",
        markdown(
            ["", "error on other drives [m]", "in the worst seed", "drives within the limit [%]"],
            rows,
        ),
        f"Of {len(runs)} statements by {result['unused']} further drives {len(passed)} are a PASS, "
        f"for {100.0 * result['asked']:g} % of all drives; {hold} of these hold on the "
        f"{result['fresh']}.",
    ]


def identification(result: Result) -> list[str]:
    """Say where hidden plants were taken to be, which misfits were said, and which drift found."""
    rows = []
    for where in dict.fromkeys(item["where"] for item in result["plants"]):
        plants = [item for item in result["plants"] if item["where"] == where]
        within = sum(item["within"] for item in plants)
        tuned = [item for item in plants if "known" in item]
        feasible = sum(item["narrower"]["feasible"] for item in tuned)
        known = sum(item["known"]["feasible"] for item in tuned)
        ratios = [
            item["narrower"]["objective"] / item["known"]["objective"]
            for item in tuned
            if item["narrower"]["feasible"] and item["known"]["feasible"]
        ]
        rows.append(
            [
                where,
                f"{within} of {len(plants)}",
                f"{sum(bool(item['misfits']) for item in plants)} of {len(plants)}",
                f"{feasible} of {len(tuned)}" if tuned else "",
                f"{known} of {len(tuned)}" if tuned else "",
                f"{min(ratios):.3f} to {max(ratios):.3f}" if ratios else "",
            ]
        )
    return [
        f"The context of a hidden axis, inferred from {result['runs']} of its runs. *Within*: the "
        "axis is within the bounds written. *Feasible*: a result tuned in these bounds, at the "
        "axis, beside that of a tuner that knows the axis; *objective*: its multiple of that "
        "tuner's.",
        markdown(
            ["plant", "within", "misfit said", "feasible", "feasible if known", "objective"], rows
        ),
        "Drift: the share of comparisons with 60 baseline runs in which it is found, at 5 % false "
        "alarms over all metrics, and the median number of runs. One metric is shifted, in "
        "standard deviations of a run, with 20 runs at most; below, the axis becomes stiffer.",
        markdown(
            ["shift", "found with 1 metric", "with 3 metrics"],
            _shares((shift, metrics, *found) for metrics, shift, *found in result["drift"]),
        ),
        markdown(
            ["stiffness", "found by 20 runs at most", "by 40 at most"], _shares(result["stiffness"])
        ),
    ]


def _shares(cases: Iterable[Sequence[float]]) -> list[list[str]]:
    """Return a row for each change, with the share found and the runs in each of its cases."""
    rows: dict[float, list[str]] = {}
    for change, _, share, runs in cases:
        rows.setdefault(change, [f"{change:g}"]).append(f"{share:.1%}, {runs:g} runs")
    return list(rows.values())


SECOND = 2.0

DOZEN = {
    "f1": "sphere",
    "f2": "ellipsoid",
    "f3": "Rastrigin",
    "f6": "attractive sector",
    "f7": "step ellipsoid",
    "f8": "Rosenbrock",
    "f11": "discus",
    "f12": "bent cigar",
    "f13": "sharp ridge",
    "f14": "different powers",
    "f17": "Schaffers",
    "f21": "Gallagher",
}
FUNCTIONS = {
    "plain": DOZEN,
    "noisy": DOZEN,
    "with limits": {"f2": "sphere", "f8": "ellipsoid", "f26": "discus", "f44": "Rastrigin"},
}
"""Names of the functions of `plain_problem`, by kind."""


def plain_problem(result: Result) -> list[str]:
    """Ranks on functions without contexts, beside other optimizers."""
    groups = summary(result["runs"])
    names = list(dict.fromkeys(name for entry in groups.values() for name in entry["optimizers"]))

    def row(group: str, key: str) -> list[object]:
        of_each = groups[group]["optimizers"]
        return [f"{of_each[name][key]:.1f}" if name in of_each else "" for name in names]

    ranks = [
        [
            group,
            entry["problems"],
            *row(group, "mean rank"),
            f"{entry['optimizers']['boundary']['median rank']:g}",
            entry["optimizers"]["boundary"]["first"],
        ]
        for group, entry in groups.items()
    ]
    behind = []
    for group, entry in groups.items():
        titles = FUNCTIONS[group.partition(",")[0]]
        lost = [
            f"{titles[number]} {ranks_there['boundary']:.2g}"
            for number, ranks_there in entry["functions"].items()
            if ranks_there["boundary"] > SECOND
        ]
        behind.append(f"{group}: {', '.join(lost) or 'nowhere'}")
    commits = ", ".join(sorted({each["commit"][:10] for each in result["runs"]}))
    return [
        "BBOB functions without contexts, by dimension and evaluations, begun with the same "
        "design. A problem is a function and an instance; on each the optimizers are ranked. "
        "Without noise, `boundary` and Optuna's GPSampler are told so, and the lowest value seen "
        "within all limits counts; with noise it is the value, free of it, of what is recommended. "
        "Mean ranks, the median of `boundary`, and on how many problems it is first:",
        markdown(["", "problems", *names, "median", "first"], ranks),
        f"Where its mean rank is beyond second: {'; '.join(behind)}. Once what is left to gain is "
        "lost in noise, up to a quarter of its trials look for another basin, which these "
        "functions do not reward; and kinks, as of the sharp ridge, shorten the length scales of "
        "its kernel until the whole cube is searched. With limits, a run of BoTorch's qLogNEI "
        "takes more than eight minutes, and SMAC knows them as a penalty alone: both are left out "
        "there.",
        "Time of the processor for all proposals of a run [s], the median, one thread:",
        markdown(["", *names], [[group, *row(group, "seconds")] for group in groups]),
        f"Results are of commits {commits}; of other optimizers they depend on the commit by the "
        "initial design alone.",
    ]
