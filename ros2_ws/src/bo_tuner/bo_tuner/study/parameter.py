"""A parameter of a study: tuned, tied to another one, or fixed."""

import contextlib
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any

from bo_tuner import maxima
from bo_tuner.codec import checks
from bo_tuner.codec.findings import under
from bo_tuner.codec.reading import read
from bo_tuner.codec.rules import FRACTION, KEY, LATER, AtMost, Expected, OneOf, Written
from bo_tuner.errors import StudyError
from bo_tuner.study.parameter_scale import LINEAR, LOG, SCALES, SYMLOG, factor_in
from bo_tuner.study.prior import Prior
from bo_tuner.study.titles import Label, Titled
from bo_tuner.trials import Value

Number = int | float

CHOICES = "a list of two or more different values (or tied_to or fixed instead)"
TYPES = ("double", "integer", "boolean", "string")
LISTS = tuple(f"{kind}_array" for kind in TYPES)
_TUNED_ONLY = ("bounds", "step", "choices", "ordered", "minimum_correlation", "travel", "prior")
Bounds = Annotated[tuple[Number, Number], Expected("bounds [lower, upper]")]
_CHECKS: dict[str, Callable[..., Any]] = {
    "integer": checks.integer,
    "double": checks.number,
    "boolean": checks.boolean,
    "string": checks.text,
    **dict.fromkeys(LISTS, checks.text),
}
LIST = Written(tuple[Value, ...])
"""What may stand in place of a single value."""
WHEN = "when"
# Larger integers have no exact double, and the unit cube is computed in doubles.
LARGEST_BOUND = 2**53


@dataclass(frozen=True, kw_only=True)
class Parameter(Titled):
    """A parameter of the study: of a node, or a value in steps of `run` or what starts a node.

    A tuned one has `bounds` (a number), `choices` (a string, a list, or a number that takes a few
    values) or only a default (a boolean); any other has `tied_to` or `fixed`.

    Attributes
    ----------
    name : str
        Name in the study.
    node : str
        Node of the study that has the parameter. One without a node stands in the steps of `run`,
        or in the `command`, `launch` or `env` of a node, by its name in braces: `request: {kp:
        "{kp}"}`, `kp:={kp}`.
    type : str
        `double`, `integer`, `boolean` or `string`, as ROS calls the type; with ``_array`` that of
        a list.
    bounds : tuple of two numbers, optional
        Smallest and largest value of a tuned number.
    step : int, float or str, optional
        A tuned number is the lower bound plus a multiple of this; 1 for an integer unless given.
        With a factor such as ``2x`` it is the lower bound times a power of it: short for these
        `choices`.
    choices : tuple of bool, int, float or str, optional
        The values of a tuned text or list, or of a number that takes only these. A list is one
        value, as in ``[[1.0, 2.0], [0.5, 4.0]]``; trials and screens have it as text.
    ordered : bool, optional
        Whether `choices` have the order in which they are listed, so that neighbours are alike.
        Numbers that increase or decrease have it unless told otherwise; others, and texts, have
        none, and lists cannot have it.
    tied_to : str, optional
        Tuned or fixed parameter that this one takes its value from, or an expression of several,
        such as ``0.1 * kp``; then `bounds` are what every parameter set keeps.
    fixed : bool, int, float or str, optional
        Value in every trial.
    default : bool, int, float or str, optional
        Hand-tuned value, the baseline of every comparison. Required for a tuned parameter; a fixed
        one has its value, and a tied one that of the parameter it follows.
    scale : str
        `linear`, or `log` for a positive parameter of which ratios matter rather than
        differences. `symlog` is for bounds that begin at 0, or near it: the logarithm down to a
        thousandth of the upper bound, and linear from there to 0.
    label : str
        What screens call it in place of its name, such as ``gain of the position loop``.
    unit : str
        Unit, for display only.
    minimum_correlation : float, optional
        Lower bound of the surrogates' correlation between neighbouring integers.
    travel : float, optional
        Largest distance, in a safe search, from a parameter set that was tried and has kept its
        limits, as a share of the range on the scale; that of `safe_search` unless given.
    prior : Prior, optional
        Where the best value is believed to be, such as ``{around: 2.0, within: 1.5x}``. The search
        of `boundary` begins there, and believes it less with each trial.
    when : str or mapping, optional
        Condition under which there is this parameter: ``horizon > 20``, or values of others as
        ``{planner: mppi}``, of which a list permits several. Without it a node keeps what it has,
        and a function is not given the parameter.
    parameter : str
        Name of the parameter in the node, whatever ROS takes, such as ``gains.ur5e/wrist-1.p``; the
        name of this entry unless given. ``covariance[7]`` is an item of the array `covariance`,
        counted from 0.
    """

    name: Annotated[str, KEY, checks.parameter_or_item]
    node: str = ""
    type: Annotated[str, OneOf((*TYPES, *LISTS))]
    bounds: Bounds | None = None
    step: Annotated[Number | None, Written(str)] = None
    choices: (
        Annotated[tuple[Annotated[Value, LIST], ...], Expected(CHOICES), AtMost(maxima.CHOICES)]
        | None
    ) = None
    ordered: bool | None = None
    tied_to: str | None = None
    fixed: Annotated[Value | None, LATER, LIST] = None
    default: Annotated[Value | None, LATER, LIST] = None
    scale: Annotated[str, OneOf(SCALES)] = LINEAR
    label: Label = ""
    unit: str = ""
    minimum_correlation: Annotated[float, FRACTION] | None = None
    travel: Annotated[float, FRACTION] | None = None
    prior: Prior | None = None
    when: Annotated[str, Written(Mapping[str, object])] = ""
    parameter: Annotated[str, checks.name_in_node] = ""

    def __post_init__(self) -> None:
        """Check the fields; references to other parts of a study are checked there."""
        if isinstance(self.step, str):
            self._write_powers_out(self.step)
        self._write_lists_as_text()
        if not isinstance(self.when, str):
            object.__setattr__(self, "when", _condition(self.when))
        super().__post_init__()
        if not self.node and self.parameter:
            raise StudyError("without a node there is no parameter; add node", ("parameter",))
        if not self.node and array_and_item(self.name)[0]:
            raise StudyError("missing; expected the node that has the array", ("node",))
        if self.node and self.parameter == "":
            object.__setattr__(self, "parameter", self.name)
        if self.fixed is not None:
            self._check_fixed()
        elif self.tied_to is not None:
            self._check_tied()
        else:
            self._check_tuned()

    @property
    def is_tuned(self) -> bool:
        """Whether the optimizer chooses the value."""
        return self.fixed is None and self.tied_to is None

    @property
    def is_list(self) -> bool:
        """Whether the value is a list, which trials have as text."""
        return self.type in LISTS

    @property
    def is_text(self) -> bool:
        """Whether trials have the value as text."""
        return self.type == "string" or self.is_list

    @property
    def is_integer(self) -> bool:
        """Whether the value is an integer."""
        return self.type == "integer"

    @property
    def is_number(self) -> bool:
        """Whether the value is a number, with bounds where it is tuned, and none of few choices."""
        return self.type in ("double", "integer") and self.choices is None

    @property
    def levels(self) -> tuple[Value, ...]:
        """The values of a tuned parameter between which there is nothing; empty for a number."""
        if self.is_number:
            return ()
        return (False, True) if self.type == "boolean" else (self.choices or ())

    @property
    def has_order(self) -> bool:
        """Whether its `levels` are in an order, so that neighbours are alike."""
        return bool(self.ordered)

    @property
    def is_derived(self) -> bool:
        """Whether its value is an expression of others."""
        return self.tied_to is not None and not checks.PARAMETER_OR_ITEM.fullmatch(self.tied_to)

    def leader(self, parameters: Mapping[str, "Parameter"]) -> "Parameter":
        """Return the parameter whose value it has: the one that it is tied to, or itself."""
        follows = self.tied_to is not None and not self.is_derived
        return parameters[str(self.tied_to)] if follows else self

    def fixed_at(self, value: Value) -> "Parameter":
        """Return it with this value in every trial."""
        left_out = dict.fromkeys((*_TUNED_ONLY, "default"))
        changed: Parameter = replace(self, fixed=value, scale=LINEAR, **left_out)  # type: ignore[arg-type]
        return changed

    @property
    def array(self) -> str:
        """Name of the array that has the parameter as an item; empty if it is no item."""
        return array_and_item(self.parameter)[0]

    @property
    def item(self) -> int:
        """Position of the parameter in its array."""
        return array_and_item(self.parameter)[1]

    def checked(self, value: object, *path: str | int) -> Value:
        """Return a value that has the parameter's type; bounds do not matter.

        Raises
        ------
        StudyError
            If it has another one, or is no choice.
        """
        value = self.in_trials(value, *path)
        if self.type == "string" and self.choices is not None:
            return checks.choice(value, [str(choice) for choice in self.choices], *path)
        checked: Value = _CHECKS[self.type](value, *path)
        if self.choices is not None and checked not in self.choices:
            show = str if self.is_list else checks.show
            known = ", ".join(map(show, self.choices))
            raise StudyError(f"expected one of {known}, found {show(value)}", path)
        return checked

    def in_trials(self, value: object, *path: str | int) -> Any:
        """Return a value as trials have it: a list, or its text, as text in one line.

        Raises
        ------
        StudyError
            If the parameter is a list, and the value none of its type.
        """
        if not self.is_list:
            return value
        kind = self.type.removesuffix("_array")
        if isinstance(value, str):
            with contextlib.suppress(ValueError, RecursionError):
                value = json.loads(value)
        items = checks.sequence(value, f"a list, as it is a {self.type}", *path)
        if not items:
            raise StudyError("expected at least one item in the list", path)
        checks.at_most(items, maxima.CONSTANTS, *path)
        checked = [_CHECKS[kind](item, *path, index) for index, item in enumerate(items)]
        return json.dumps(checked, ensure_ascii=False)

    def as_sent(self, value: Value) -> Any:
        """Return a value of a trial as nodes and functions take it: a list as a list."""
        return json.loads(str(value)) if self.is_list else value

    def _write_lists_as_text(self) -> None:
        choices = self.choices if isinstance(self.choices, list | tuple) else ()
        if self.type in TYPES and any(isinstance(each, list | tuple) for each in choices):
            expected = f"expected {self.type}_array, or such, for choices that are lists"
            raise StudyError(f"{expected}, found {self.type}", ("type",))
        if not self.is_list:
            return
        if self.array:
            raise StudyError("an item of an array is no list", ("type",))
        if choices:
            texts = tuple(self.in_trials(item, "choices", i) for i, item in enumerate(choices))
            object.__setattr__(self, "choices", texts)
        for key in ("fixed", "default"):
            if (value := getattr(self, key)) is not None:
                object.__setattr__(self, key, self.in_trials(value, key))

    def _check_fixed(self) -> None:
        self._refuse("a fixed parameter", *_TUNED_ONLY, "tied_to")
        fixed = self.checked(self.fixed, "fixed")
        object.__setattr__(self, "fixed", fixed)
        if self.default is not None and self.checked(self.default, "default") != fixed:
            raise StudyError(
                f"{self.default} differs from the fixed value {fixed}; leave it out", ("default",)
            )
        object.__setattr__(self, "default", fixed)

    def _check_tied(self) -> None:
        if self.is_derived:
            self._check_derived()
            return
        self._refuse("a tied parameter", *_TUNED_ONLY)
        if self.default is not None:
            object.__setattr__(self, "default", self.checked(self.default, "default"))

    def _check_derived(self) -> None:
        if self.type not in ("double", "integer"):
            raise StudyError(f"a {self.type} is no expression of others", ("tied_to",))
        others = [key for key in _TUNED_ONLY if key != "bounds"]
        self._refuse("a parameter that is computed from others", *others, "default")
        if self.bounds is not None:
            self._settle_bounds(self.bounds)

    def _check_tuned(self) -> None:
        if self.is_number:
            if self.ordered is not None:
                raise StudyError("belongs to choices; leave it out", ("ordered",))
            self._check_range()
        else:
            self._check_levels()
        if self.minimum_correlation is not None and not self.is_integer:
            raise StudyError("applies to integers only; leave it out", ("minimum_correlation",))

    def _check_levels(self) -> None:
        of_choices = self.type in ("double", "integer")
        kind = "a parameter with choices" if of_choices else f"a {self.type}"
        self._refuse(kind, "bounds", "step", "minimum_correlation", "travel", "prior")
        if self.choices is None:
            if self.type != "boolean":
                raise StudyError(f"missing; expected {CHOICES}", ("choices",))
        else:
            self._check_choices(self.choices)
        if self.default is None:
            raise StudyError("missing; expected the hand-tuned value", ("default",))
        object.__setattr__(self, "default", self.checked(self.default, "default"))

    def _check_choices(self, given: tuple[Value, ...]) -> None:
        """Settle the choices: of one type, all different, and numbers in order if they have one."""
        check = _CHECKS[self.type]
        choices = tuple(check(item, "choices", index) for index, item in enumerate(given))
        if len(choices) < 2 or len(set(choices)) < len(choices):
            raise StudyError(f"expected {CHOICES}", ("choices",))
        object.__setattr__(self, "choices", choices)
        if self.is_list and self.ordered:
            raise StudyError("lists have no order; leave it out", ("ordered",))
        if self.type not in ("double", "integer"):
            return
        pairs = list(pairwise(choices))
        sorted_ = all(a < b for a, b in pairs) or all(a > b for a, b in pairs)
        if self.ordered is None:
            object.__setattr__(self, "ordered", sorted_)
        elif self.ordered and not sorted_:
            raise StudyError(
                "expected numbers that increase or decrease, or ordered: false", ("choices",)
            )

    def _write_powers_out(self, step: str) -> None:
        """Put the powers of a factor, times the lower bound, into the place of bounds and step."""
        factor = factor_in(step, "step")
        if self.choices is not None or self.type not in ("double", "integer"):
            raise StudyError("belongs to a number with bounds; leave it out", ("step",))
        with under("bounds"):
            lower, upper = read(Bounds | None, self.bounds) or (0, 0)
        if not 0 < lower < upper:
            raise StudyError(f"a factor needs bounds above 0; {step} times 0 is 0", ("bounds",))
        powers = [float(lower)]
        while (following := powers[-1] * factor) <= upper * (1.0 + 1e-9):
            if len(powers) == maxima.CHOICES:
                raise StudyError(f"gives more than {maxima.CHOICES} values", ("step",))
            powers.append(float(f"{following:.12g}"))
        if self.is_integer:
            if wrong := [power for power in powers if power != round(power)]:
                found = f"found {wrong[0]:g}, a power of {step} times {lower}"
                raise StudyError(f"expected integers only, {found}", ("step",))
            powers = [int(power) for power in powers]
        for key, value in (("choices", tuple(powers)), ("bounds", None), ("step", None)):
            object.__setattr__(self, key, value)

    def _check_range(self) -> None:
        if self.bounds is None:
            raise StudyError(
                "missing; expected [lower, upper] (or choices, tied_to or fixed instead)",
                ("bounds",),
            )
        lower, upper = self._settle_bounds(self.bounds)
        if self.step is not None:
            step = self._computed(self.step, "step")
            if not 0 < step <= upper - lower:
                raise StudyError(f"expected above 0 and within the bounds, found {step}", ("step",))
            object.__setattr__(self, "step", step)
        if self.scale == SYMLOG and (lower < 0 or upper <= 0):
            raise StudyError(
                f"the symlog scale needs bounds from 0 on, found lower bound {lower}; leave it out",
                ("scale",),
            )
        if self.scale == LOG and lower <= 0:
            raise StudyError(
                f"the log scale needs bounds above 0, found lower bound {lower}; "
                f"{_instead_of_log(lower, upper, self.default)}",
                ("scale",),
            )
        if self.default is None:
            raise StudyError("missing; expected the hand-tuned value", ("default",))
        default = self._number(self.default, "default")
        if not lower <= default <= upper:
            raise StudyError(f"{default} lies outside the bounds [{lower}, {upper}]", ("default",))
        object.__setattr__(self, "default", default)
        self.check_grid(default, "default")
        if self.prior is not None:
            with under("prior"):
                self.prior.check(lower, upper)

    def _settle_bounds(self, bounds: tuple[Number, Number]) -> tuple[Number, Number]:
        lower, upper = (self._computed(item, "bounds", i) for i, item in enumerate(bounds))
        if self.is_integer and max(abs(lower), abs(upper)) > LARGEST_BOUND:
            raise StudyError("expected bounds of at most 2^53 in size", ("bounds",))
        checks.check_width(lower, upper, "bounds", instead=f"use fixed: {lower}")
        object.__setattr__(self, "bounds", (lower, upper))
        return lower, upper

    def check_grid(self, value: object, *path: str | int) -> None:
        """Refuse a number that is no multiple of the step above the lower bound.

        Raises
        ------
        StudyError
            If it is not.
        """
        if self.step is None or self.bounds is None or not isinstance(value, (int, float)):
            return
        error = 1e-9 * max(self.step, abs(value))
        if not math.isclose(value, self.on_grid(value), rel_tol=0.0, abs_tol=error):
            lower = self.bounds[0]
            raise StudyError(
                f"{value} is not {lower} plus a multiple of the step {self.step}", path
            )

    def on_grid(self, value: float) -> float:
        """Return the value nearest to a number that is a multiple of the step above the bound."""
        if self.bounds is None or self.step is None:
            return value
        lower, upper = self.bounds
        # The largest multiple may lie below the upper bound.
        most = math.floor((upper - lower) / self.step + 1e-9)
        steps = min(max(math.floor((value - lower) / self.step + 0.5), 0), most)
        return min(lower + steps * self.step, upper)

    def _refuse(self, kind: str, *keys: str) -> None:
        if self.scale != LINEAR:
            raise StudyError(f"{kind} has no scale; leave it out", ("scale",))
        for key in keys:
            if getattr(self, key) is not None:
                raise StudyError(f"{kind} has no {key}; leave it out", (key,))

    def _computed(self, value: object, *path: str | int) -> Number:
        return checks.integer(value, *path) if self.is_integer else checks.magnitude(value, *path)

    def _number(self, value: object, *path: str | int) -> Number:
        return checks.integer(value, *path) if self.is_integer else checks.number(value, *path)


def array_and_item(name: str) -> tuple[str, int]:
    """Return the array and the position in it that ``covariance[7]`` names; ("", 0) if no item."""
    named = checks.IN_NODE.fullmatch(name)
    if named is None or named["item"] is None:
        return "", 0
    return named["array"], int(named["item"])


def study_name(name: str) -> str:
    """Return a name for a study of a parameter that has `name` in its node: itself if it can be."""
    if checks.PARAMETER_OR_ITEM.fullmatch(name):
        return name
    array, item = array_and_item(name)
    groups = [re.sub(r"\W+", "_", part, flags=re.ASCII) for part in (array or name).split(".")]
    joined = ".".join(group for group in groups if group) or "_"
    joined = joined if re.match(r"[A-Za-z_]", joined) else f"_{joined}"
    return f"{joined}[{item}]" if array else joined


def _condition(values: object) -> str:
    """Return the condition that parameters have some values, given by name, each one or a list."""
    expected = "a condition such as horizon > 20, or values by name such as {planner: mppi}"
    if not isinstance(values, Mapping) or not values:
        raise StudyError(f"expected {expected}, found {checks.show(values)}", (WHEN,))
    conjuncts = []
    for name, given in values.items():
        checks.text(name, WHEN)
        several = given if isinstance(given, list | tuple) else [given]
        if not several or not all(isinstance(each, bool | int | float | str) for each in several):
            raise StudyError(
                f"expected a value or a list, found {checks.show(given)}", (WHEN, name)
            )
        # A truth value is 1 or 0 in a condition.
        shown = (repr(int(each) if isinstance(each, bool) else each) for each in several)
        equal = " or ".join(f"{name} == {each}" for each in shown)
        conjuncts.append(f"({equal})" if len(several) > 1 and len(values) > 1 else equal)
    return " and ".join(conjuncts)


def _instead_of_log(lower: Number, upper: Number, default: object) -> str:
    """Say what to write for bounds that have no logarithm."""
    if lower < 0 or upper <= 0:
        return "leave it out"
    # A lower bound three decades below the default covers what is worth searching.
    near = default if isinstance(default, (int, float)) and default > 0 else upper
    proposed = 1 if isinstance(lower, int) else float(f"{min(near, upper) / 1000.0:.1g}")
    return f"write bounds: [{proposed}, {upper}], or scale: symlog if 0 itself counts"
