"""What a study may not say, and with which words it is refused."""

import math

import pytest
from drive_text import mapping, put, refusal

NUMBERS_REFUSED = [
    ("3", "found text '3'"),
    (True, "found true"),
    (None, "found nothing"),
    ([3], "found a list of 1"),
    ({"x": 3}, "found a mapping"),
]


class TestLabels:
    @pytest.mark.parametrize("path", [("parameters", "gains.kp"), ("metrics", "peak")])
    @pytest.mark.parametrize(
        ("label", "found"),
        [
            (3, "text, found 3"),
            ("x" * 61, "at most 60 printable characters"),
            ("solve\ntime", "at most 60 printable characters"),
            (" solve time", "at most 60 printable characters"),
        ],
    )
    def test_one_that_does_not_fit_into_a_line(self, path, label, found):
        message = refusal(put(label, *path, "label"))
        assert message.startswith(f"{'.'.join(path)}.label: expected {found}")

    @pytest.mark.parametrize(
        ("section", "one", "other"),
        [("parameters", "gains.kp", "window"), ("metrics", "error", "peak")],
    )
    def test_one_that_says_another(self, section, one, other):
        """What a reader takes for the value of one must not be that of another."""
        changed = put("the other", section, one, "label")
        changed[section][other]["label"] = "the other"
        said = f"label: expected a label of its own, found what {other} is called"
        assert refusal(changed) == f"{section}.{one}.{said}"
        assert refusal(put(other, section, one, "label")) == f"{section}.{one}.{said}"


class TestRefusedTypes:
    @pytest.mark.parametrize(("value", "found"), [(3.0, "found 3.0"), *NUMBERS_REFUSED[:2]])
    @pytest.mark.parametrize("key", ["default", "fixed"])
    def test_integer_parameter(self, key, value, found):
        changed = put({"node": "drive", "type": "integer", key: value}, "parameters", "window")
        if key == "default":
            changed["parameters"]["window"]["bounds"] = [1, 9]
        assert refusal(changed) == f"parameters.window.{key}: expected an integer, {found}"

    @pytest.mark.parametrize(("value", "found"), [(3.0, "found 3.0"), *NUMBERS_REFUSED])
    def test_integer_setting(self, value, found):
        message = refusal(put(value, "budget", "trials"))
        assert message == f"budget.trials: expected an integer, {found}"

    @pytest.mark.parametrize(
        ("value", "found"),
        [
            # A limit that is nothing is none: one of two may be left out.
            *(item for item in NUMBERS_REFUSED if item[0] is not None),
            (math.nan, "found nan"),
            (math.inf, "found inf"),
            (-math.inf, "found -inf"),
        ],
    )
    def test_double_setting(self, value, found):
        message = refusal(put(value, "constraints", "worst", "upper"))
        assert message.startswith("constraints.worst.upper: expected a ")
        assert message.endswith(found)

    @pytest.mark.parametrize("value", [math.nan, math.inf])
    @pytest.mark.parametrize(
        "path",
        [
            ("parameters", "gains.kp", "default"),
            ("parameters", "offset", "fixed"),
            ("contexts", "load", "nominal"),
            ("trigger", "timeout"),
        ],
    )
    def test_double_that_is_not_finite(self, path, value):
        assert refusal(put(value, *path)).startswith(
            f"{'.'.join(path)}: expected a finite number, found"
        )

    @pytest.mark.parametrize("value", [None, 3, "text", [1]])
    @pytest.mark.parametrize("section", ["nodes", "parameters", "contexts", "metrics", "budget"])
    def test_section_that_is_no_mapping(self, section, value):
        assert refusal(put(value, section)).startswith(f"{section}: expected a mapping")

    def test_integers_beyond_64_bits(self):
        assert "64-bit" in refusal(put(2**63, "seed"))
        assert "64-bit" in refusal(put(10**5000, "parameters", "gains.kp", "default"))


class TestRefusedValues:
    @pytest.mark.parametrize(
        ("path", "value", "problem"),
        [
            (
                "parameters/gains.kp/bounds",
                [5, -5],
                "lower bound 5.0 is not below upper bound -5.0",
            ),
            ("parameters/window/bounds", [3, 3], "both bounds are 3; use fixed: 3"),
            (
                "parameters/gains.kp/bounds",
                [0, 1, 2],
                "expected bounds [lower, upper], found a list of 3",
            ),
            (
                "parameters/window/bounds",
                None,
                "missing; expected [lower, upper] (or choices, tied_to or fixed instead)",
            ),
            ("parameters/window/default", None, "missing; expected the hand-tuned value"),
            ("parameters/window/default", 10, "10 lies outside the bounds [1, 9]"),
            ("parameters/window/bounds", [1, 2**60], "expected bounds of at most 2^53 in size"),
            (
                "parameters/window/type",
                "float",
                "unknown 'float'; expected one of double, integer, boolean, string, double_array, "
                "integer_array, boolean_array, string_array",
            ),
            (
                "parameters/window/minimum_correlation",
                1.0,
                "expected a number between 0 and 1, both excluded, found 1.0",
            ),
            (
                "parameters/gains.kp/minimum_correlation",
                0.1,
                "applies to integers only; leave it out",
            ),
            ("parameters/offset/bounds", [1, 2], "a fixed parameter has no bounds; leave it out"),
            ("parameters/offset/default", 3, "3 differs from the fixed value 2.0; leave it out"),
            ("parameters/echo/bounds", [1, 2], "a tied parameter has no bounds; leave it out"),
            (
                "parameters/echo/tied_to",
                "windw",
                "there is no other parameter 'windw'; did you mean 'window'?",
            ),
            ("metrics/peak/node", "drve", "there is no node 'drve'; did you mean 'drive'?"),
            ("seed_parameter/node", "drve", "there is no node 'drve'; did you mean 'drive'?"),
            ("trigger/node", ["drive"], "expected text, found a list of 1"),
            ("objective/metric", "eror", "there is no metric 'eror'; did you mean 'error'?"),
            (
                "constraints/worst/metric",
                "speed",
                "there is no metric 'speed'; expected one of error, peak",
            ),
            (
                "constraints/current/kind",
                "worst-case",
                "unknown 'worst-case'; did you mean 'worst_case'?",
            ),
            ("constraints/current/probability", "96 %", "expected a number, found text '96 %'"),
            (
                "constraints/current/probability",
                96,
                "expected a number between 0 and 1, both excluded, found 96",
            ),
            (
                "constraints/worst/probability",
                0.4,
                "expected at least 0.5 of a worst_case constraint, found 0.4",
            ),
            ("trigger/timeout", 0, "expected a number above 0 and at most 86400 s, found 0"),
            ("budget/search_evaluations", -1, "expected an integer of at least 0, found -1"),
            ("metrics", {}, "expected at least one"),
            (
                "name",
                "two words",
                "expected a name of letters, digits, _ and -, found text 'two words'",
            ),
            (
                "name",
                "../evil",
                "expected a name of letters, digits, _ and -, found text '../evil'",
            ),
            (
                "nodes/drive/node",
                "drive/",
                "expected a node name such as axis or /arm/axis, found text 'drive/'",
            ),
            (
                "nodes/drive/result",
                "a b",
                "expected a topic name such as ~/cut_result, found text 'a b'",
            ),
            (
                "nodes/drive/object",
                "drives.Drive",
                "expected module:name such as axis.simulation:Axis, found text 'drives.Drive'",
            ),
            (
                "contexts/load/distribution",
                "normal",
                "unknown 'normal'; did you mean 'truncated_normal'?",
            ),
            (
                "contexts/load/mean",
                1.0,
                "unknown key; expected one of node, distribution, type, unit, parameter, bounds, "
                "nominal",
            ),
        ],
    )
    def test_problem_at_the_value(self, path, value, problem):
        keys = path.split("/")
        assert refusal(put(value, *keys)) == f"{'.'.join(keys)}: {problem}"

    @pytest.mark.parametrize(
        ("path", "value", "message"),
        [
            (
                "constraints/current",
                {"kind": "chance", "metric": "peak", "upper": 3},
                "constraints.current.probability: missing; a chance constraint needs one, such as "
                "0.96",
            ),
            (
                "order",
                [["span", "window"]],
                "order[0]: expected 'span' <= 'window', found the defaults 4 and 3",
            ),
            (
                "order",
                [["window", "spam"]],
                "order[0][1]: there is no parameter 'spam'; did you mean 'span'?",
            ),
            (
                "order",
                [["window"]],
                "order[0]: expected [smaller, larger], two names of parameters, found a list of 1",
            ),
            (
                "nodes/drive/unwatched",
                "count",
                "nodes.drive.unwatched: expected a list of names or patterns such as STAT_*, found "
                "text 'count'",
            ),
            (
                "nodes/drive/unwatched",
                ["count", ""],
                "nodes.drive.unwatched[1]: expected a list of names or patterns such as STAT_*",
            ),
            (
                "nodes/drive/unwatched",
                ["count", "win*"],
                "nodes.drive.unwatched: 'win*' is also 'window', which the study sets; what is set "
                "is watched",
            ),
            (
                "parameters/window/parameter",
                "a\tb",
                "parameters.window.parameter: expected the name of a ROS parameter, up to 255 "
                "printable characters, found text 'a\\tb'",
            ),
            (
                "nodes/drive/package",
                "drives",
                "nodes.drive.executable: missing; package alone does not start a node",
            ),
            (
                "nodes/drive/parameters",
                {"x": None},
                "nodes.drive.parameters.x: expected a number, text, true, false or a list of "
                "these, found nothing",
            ),
            (
                "nodes/drive/parameters",
                {"x": math.nan},
                "nodes.drive.parameters.x: expected a finite number, found nan",
            ),
            (
                "nodes/drive/parameters",
                {"x": [1, 2.0]},
                "nodes.drive.parameters.x: expected a list of values of one type, at least one",
            ),
            (
                "nodes/drive/parameters",
                {"window": 3},
                "parameters.window: parameter 'window' of node 'drive' is already set by "
                "nodes.drive",
            ),
            (
                "seed_parameter/parameter",
                "window",
                "seed_parameter: parameter 'window' of node 'drive' is already set by "
                "parameters.window",
            ),
            *(
                (
                    f"constraints/{name}",
                    {"kind": "worst_case", "metric": "peak", "upper": 3},
                    f"constraints.{name}: the models call another one '{name}'; choose another "
                    "name",
                )
                for name in ("objective", "outliers", "failures")
            ),
            (
                "nodes/second",
                {"node": "drive", "object": "drives:Drive"},
                "nodes.second.node: 'drive' is already nodes.drive",
            ),
            (
                "certificate",
                {"draws": 200_000},
                "certificate.draws: expected an integer of at most 100000, found 200000",
            ),
            (
                "contexts/load",
                {"node": "drive"},
                "contexts.load.distribution: missing; expected one of truncated_normal, "
                "uniform, beta, triangular, discrete",
            ),
        ],
    )
    def test_problem_elsewhere(self, path, value, message):
        assert refusal(put(value, *path.split("/"))) == message

    @pytest.mark.parametrize("name", ["1st", "a b", "a..b", ".a", "a.", "", "\u00e4", "a\nb"])
    def test_names_that_a_study_does_not_take(self, name):
        changed = put(mapping()["parameters"]["gains.kp"], "parameters", name)
        assert "expected a parameter name such as gains.kp" in refusal(changed)

    @pytest.mark.parametrize(
        ("path", "suggestion"),
        [
            (("trials",), "expected one of name, nodes"),
            (("objectiv",), "did you mean 'objective'?"),
            (("parameters", "window", "bound"), "did you mean 'bounds'?"),
            (("parameters", "window", "name"), "expected one of node, type"),
            (("contexts", "load", "distributon"), "did you mean 'distribution'?"),
            (("budget", "trails"), "did you mean 'trials'?"),
        ],
    )
    def test_unknown_key(self, path, suggestion):
        message = refusal(put(1, *path))
        assert message.startswith(f"{'.'.join(path)}: unknown key; {suggestion}")

    @pytest.mark.parametrize("key", ["name", "nodes", "metrics", "objective", "budget"])
    def test_missing_section(self, key):
        changed = mapping()
        del changed[key]
        assert refusal(changed) == f"{key}: missing"

    @pytest.mark.parametrize("key", [1, None, True, ("a",)])
    def test_key_that_is_no_text(self, key):
        assert "expected text as a key" in refusal(put(1, key))
        assert "expected a name" in refusal(put({}, "metrics", key))


class TestObjectives:
    @pytest.mark.parametrize(
        ("further", "expected"),
        [
            ({"metric": "far"}, "further_objectives: expected a list of objectives, found"),
            ([3], "further_objectives[0]: expected a mapping, found 3"),
            ([{"scale": "log"}], "further_objectives[0].metric: missing"),
            ([{"metric": "nowhere"}], "further_objectives[0].metric: there is no metric 'nowhere'"),
            ([{"metric": "error", "weight": 2}], "further_objectives[0].weight: unknown key"),
            (
                ["objective"],
                "further_objectives[0].metric: expected another metric, found '{0}' again",
            ),
            (
                ["other", "other"],
                "further_objectives[1].metric: expected another metric, found '{1}' again",
            ),
            (
                ["other"] * 3,
                "further_objectives: expected at most 3 objectives in all, found 4",
            ),
        ],
    )
    def test_further_ones(self, further, expected):
        study = mapping()
        first = study["objective"]["metric"]
        other = next(name for name in study["metrics"] if name != first)
        names = {"objective": first, "other": other}
        if isinstance(further, list):
            further = [{"metric": names[i]} if isinstance(i, str) else i for i in further]
        message = refusal(put(further, "further_objectives"))
        assert message.startswith(expected.format(first, other))


@pytest.mark.parametrize("bounds", [[-1.0, 10.0], [-10.0, 0.0]])
def test_a_symlog_scale_needs_bounds_from_0_on(bounds):
    kd = {"node": "drive", "type": "double", "bounds": bounds, "default": 0.0, "scale": "symlog"}
    assert refusal(put(kd, "parameters", "kd")) == (
        "parameters.kd.scale: the symlog scale needs bounds from 0 on, found lower bound "
        f"{bounds[0]}; leave it out"
    )


class TestSafeSearch:
    @pytest.mark.parametrize(
        ("section", "message"),
        [
            *(
                (
                    {"risk": risk},
                    f"safe_search.risk: expected a number above 0 and at most 0.2, found {risk}",
                )
                for risk in (0.0, 0.5)
            ),
            (
                {"travel": 1.0},
                "safe_search.travel: expected a number between 0 and 1, both excluded, found 1.0",
            ),
            (
                "yes",
                "safe_search: expected true, false, or a mapping of the search; found text 'yes'",
            ),
        ],
    )
    def test_section(self, section, message):
        assert refusal(put(section, "safe_search")) == message

    def test_travel_of_a_parameter(self):
        message = refusal(put(0.0, "parameters", "gains.kp", "travel"))
        assert message.startswith("parameters.gains.kp.travel: expected a number between 0 and 1")

    def test_travel_of_one_that_is_no_number(self):
        changed = put(
            {"node": "drive", "type": "boolean", "default": True, "travel": 0.1},
            "parameters",
            "window",
        )
        message = refusal(changed)
        assert message == "parameters.window.travel: a boolean has no travel; leave it out"
