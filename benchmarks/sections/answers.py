"""Sections on what answers are worth: certificates, ablations, bands, and effects."""

import statistics

from sections.layout import Result, origin

from tuning_benchmark.pages.tables import markdown


def certificates(result: Result) -> list[str]:
    """How often a certificate passes what is feasible, and what is just not."""
    rows = [
        [
            case["title"],
            "answers" if which == "answer" else "just infeasible",
            f"{found['passed']} of {found['certified']}",
            "{:.0%} to {:.0%}".format(*found["interval"]),
            f"{found['median_evaluations']:g}",
            found["most_evaluations"],
            f"{found['median_of_least']:.1f}" if which == "answer" else "",
        ]
        for case in result["cases"].values()
        for which in ("answer", "infeasible")
        if (found := case[which])
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
    return [
        "Answers that `boundary` called feasible in the recorded campaigns, certified "
        "by the study's default certificate, and beside each a parameter set that is truly "
        "infeasible by as little as bisection finds. The interval is that of Clopper and "
        f"Pearson, 95 %. Of the answers, {len(runs) - len(wrong)} are truly feasible, and "
        f"{passed} of these pass{failed}. *Times the least*: the median "
        "number of evaluations as a multiple of the fewest that show all limits: none beyond, no "
        "search, one worst context. Of a limit on a mean these are five.",
        markdown(
            [
                "problem",
                "parameter sets",
                "PASS",
                "interval",
                "evaluations, median",
                "largest",
                "times the least",
            ],
            rows,
        ),
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


def ablations(result: Result) -> list[str]:
    """Say what each choice of `boundary` is worth."""
    parts = [
        "Each variant with the same seeds as the algorithm as shipped. *Only*: seeds with a truly "
        "feasible answer in the variant only, and as shipped only, with the exact test of McNemar. "
        "The difference is that of the true objective in pairs where both are feasible, with its "
        "95 % interval.",
    ]
    header = [
        "variant",
        "truly feasible",
        "objective",
        "evaluations",
        "failed trials",
        "only",
        "difference",
    ]
    for case in result["cases"].values():
        rows = []
        for title, found in case["variants"].items():
            pairs = f"{found['only']} : {found['only_shipped']} (p = {found['mcnemar']:.2g})"
            difference = found["difference"]
            shown = "{:+.4f} ({:+.4f} to {:+.4f})".format(*difference) if difference else "none"
            objective = found["objective"]
            rows.append(
                [
                    title,
                    f"{found['feasible']} of {found['runs']}",
                    "none" if objective is None else f"{objective:.4f}",
                    f"{found['evaluations']:.0f}",
                    f"{found['failed']:.1f}",
                    *(("", "") if title == "as shipped" else (pairs, shown)),
                ]
            )
        parts += [f"### {case['title']}", origin(case), markdown(header, rows)]
    return parts


def windows(result: Result) -> list[str]:
    """Say what a window of several trials costs in quality."""
    rows = []
    for case in result["cases"].values():
        for window, found in case["windows"].items():
            low, high = found["interval"]
            regret = found["objective"]
            apart = found["difference"]
            rows.append(
                [
                    case["title"],
                    window,
                    f"{found['feasible']} of {found['runs']} ({low:.0%} to {high:.0%})",
                    "none" if regret is None else f"{regret:.1%}",
                    f"{found['evaluations']:.0f}",
                    *(
                        ("", "")
                        if window == "1"
                        else (
                            f"{found['only']} : {found['only_shipped']} "
                            f"(p = {found['mcnemar']:.2g})",
                            "{:+.1%} ({:+.1%} to {:+.1%})".format(*apart) if apart else "none",
                        )
                    ),
                ]
            )
    return [
        "Answers of `boundary` with equally many evaluations where 4 or 8 trials are planned at "
        "once (`--window`), beside one by one with the same seeds. *Regret*: the true objective "
        "beyond that of the optimum, on average over the truly feasible answers. *Only*: seeds "
        "with a truly feasible answer with this window only, and one by one only, with the exact "
        "test of McNemar. The difference of the regret is that of pairs in which both are "
        "feasible, with its 95 % interval; so has the share, by Clopper and Pearson.",
        markdown(
            ["problem", "window", "truly feasible", "regret", "evaluations", "only", "difference"],
            rows,
        ),
    ]


def cut_short(result: Result) -> list[str]:
    """Say what time of the runs is saved by cutting them short, and what answers are worth then."""
    rows = []
    for system, kinds in result["systems"].items():
        alone = statistics.fmean(run["in_all"] for run in kinds["whole"])
        for kind, runs in kinds.items():
            seconds = statistics.fmean(run["in_all"] for run in runs)
            objectives = [run["objective"] for run in runs if run["feasible"]]
            share = sum(run["cut_short"] for run in runs) / sum(run["trials"] for run in runs)
            rows.append(
                [
                    f"{system}, {kind}",
                    f"{share:.0%}",
                    f"{seconds:.1f}",
                    "" if runs is kinds["whole"] else f"{1.0 - seconds / alone:.0%}",
                    f"{len(objectives)} of {len(runs)}",
                    f"{statistics.median(objectives):.4f}" if objectives else "none",
                    f"{statistics.fmean(objectives):.4f}" if objectives else "none",
                ]
            )
    return [
        "The same seeds with whole runs and with runs that are cut short (`budget.cut_short`), in "
        "simulated time: trials that were cut short, time of all runs of the trials and of the "
        "search for the answer, and true objectives of the truly feasible answers. The motor is "
        "that of `wide_ranges.py`, with 20 trials: a parameter set that is believed to keep its "
        "limit, from which on runs are cut short, is known late.",
        markdown(
            ["runs", "cut short", "time [s]", "saved", "truly feasible", "median", "mean"], rows
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
        "A plain search (`boundary`) and a safe one with twice as many trials, both from the same "
        "parameter set, which keeps all limits and is far from the best: trials of which a run "
        "broke a limit or failed; in how many seeds the safe search became as good as the plain "
        "one at its end, within 5 %, and for how many times as many runs, in the median of these.",
        markdown(["case", "plain: broken", "safe: broken", "as good", "times as many runs"], rows),
    ]


def coverage(result: Result) -> list[str]:
    """Lay out how often the bands and bounds of a certificate hold the truth."""
    summary = result["summary"]
    bands = [
        [name, _share(b), _interval(b), _width(name, b)] for name, b in summary["bands"].items()
    ]
    names = {
        "mean": "bound behind a PASS: worst mean",
        "violation": "bound behind a PASS: probability of a violation",
    }
    bounds = [[names[name], _share(b), _interval(b)] for name, b in summary["bounds"].items()]
    passed = [
        [f"PASS of one that {name} its limit", _share(p), _interval(p)]
        for name, p in summary["passed"].items()
    ]
    return [
        f"{result['cases']} random metrics of one to three context variables with known "
        "truth: samples of stationary processes, polynomials, kinks, resonances and "
        "saturation, half of them with noise that depends on the context. How often a 90 % "
        "band holds the truth, from all evaluations of a certificate and from few (25 draws "
        "and 10 of the search), with 95 % intervals by Clopper and Pearson as if all bands of "
        "a metric were independent, and the median width of the band in standard deviations of "
        "a single run, of a drift as a part of the range:",
        markdown(["90 % band", "holds the truth", "interval", "width"], bands),
        "The verdicts, with 95 % confidence and limits that are kept or violated by 0.3 to 3 "
        "standard deviations of a single run. The bounds are those of the contexts that the "
        "search found; what they miss is a worse one that it did not find:",
        markdown(["", "share", "interval"], [*bounds, *passed]),
    ]


def _width(name: str, band: Result) -> str:
    if name.startswith("drift"):
        return f"{band['median_width']:.0%}"
    return f"{band['median_width_in_noise']:.2g}"


def _share(count: Result) -> str:
    return f"{count['held']} of {count['of']}"


def _interval(count: Result) -> str:
    return f"{count['low']:.1%} … {count['high']:.1%}"


def effects(result: Result) -> list[str]:
    """Lay out how often it is wrong which parameters were seen to move a metric."""
    trials = [
        [
            case["problem"],
            case["trials"],
            f"{case['noise']:g}",
            f"{case['false alarms of a run']:.1%}",
            f"{case['smallest effect seen']:.1%}",
        ]
        for case in result["trials"]
    ]
    check = [
        [
            case["design"],
            case["runs"],
            f"{case['false alarms of a test']:.2%} at a level of {case['level']:.2%}",
            f"{case['smallest effect seen']:.1%}",
            f"{case['smallest effect in noise']:.1f}",
        ]
        for case in result["check"]
    ]
    return [
        f"Closed forms, {result['seeds']} seeds each, with a parameter that does nothing: how "
        f"often it is said to move something, at most {result['error']:.0%} being meant for all "
        "parameters of a run together, and how often the smallest effect that *would have been "
        f"seen* is seen, {result['power']:.0%} being meant. From the trials of a run, of an "
        "imitation of an optimizer:",
        markdown(["problem", "trials", "noise", "false alarms", "smallest effect seen"], trials),
        "In the runs of `check`, and that effect in standard deviations of a run:",
        markdown(["design", "runs", "false alarms", "seen", "effect"], check),
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
        "a simulation over the whole box of contexts as prior knowledge; by further runs of the "
        "result: whether it keeps all limits, its objective (median and range over the seeds), and "
        "the trials of which a run broke a limit or failed.",
        markdown(["axis", "tuned", "feasible", "objective", "range", "trials broken"], rows),
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
    found = [[*row[:2], f"{row[2]:.1%}", f"{row[3]:g}"] for row in result["drift"]]
    stiffer = [[*row[:2], f"{row[2]:.1%}", f"{row[3]:g}"] for row in result["stiffness"]]
    return [
        f"The context of a hidden axis by {result['runs']} of its runs, inferred in "
        "a box wider than the certified one. *Within*: the axis is within the bounds written. "
        "*Feasible*: the result that is tuned in these bounds, at the hidden axis, beside that of "
        "a tuner that knows the axis, and its objective as a multiple of that tuner's.",
        markdown(
            ["plant", "within", "misfit said", "feasible", "feasible if known", "objective"], rows
        ),
        "Drift: the share of comparisons with 60 baseline runs in which it is found within 20, at "
        "5 % false alarms over all metrics, and the median number of runs. One metric is shifted, "
        "in standard deviations of a run; below, the axis becomes stiffer, in all its metrics.",
        markdown(["metrics", "shift", "found", "runs"], found),
        markdown(["stiffness", "runs at most", "found", "runs"], stiffer),
    ]
