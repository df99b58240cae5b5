"""Sections on what answers are worth: certificates, safe searches, simulations, drift."""

import statistics

from sections.layout import Result

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
        "Answers of `boundary` from the recorded campaigns, certified by the study's default "
        "certificate, and beside each a parameter set that is just infeasible, found by bisection. "
        "The interval is that of Clopper and Pearson, 95 %. Of the answers, "
        f"{len(runs) - len(wrong)} are truly feasible, and {passed} of these pass{failed}. *Times "
        "the least*: the median number of evaluations as a multiple of the fewest that show all "
        "limits.",
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
        f"The context of a hidden axis, inferred from {result['runs']} of its runs. *Within*: the "
        "axis is within the bounds written. *Feasible*: a result tuned in these bounds, at the "
        "axis, beside that of a tuner that knows the axis; *objective*: its multiple of that "
        "tuner's.",
        markdown(
            ["plant", "within", "misfit said", "feasible", "feasible if known", "objective"], rows
        ),
        "Drift: the share of comparisons with 60 baseline runs in which it is found within 20 "
        "runs, at 5 % false alarms over all metrics, and the median number of runs. One metric is "
        "shifted, in standard deviations of a run; below, the axis becomes stiffer.",
        markdown(["metrics", "shift", "found", "runs"], found),
        markdown(["stiffness", "runs at most", "found", "runs"], stiffer),
    ]
