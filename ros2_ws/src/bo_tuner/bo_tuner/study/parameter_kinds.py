"""What the numbers among a node's parameters are by their names.

Names are an uncertain sign, so this only orders offers: the user can take any parameter. In doubt a
parameter is not taken for a gain: tuning a limit, a set-point or the noise of a simulation finds
"parameters" that merely make the task easier.
"""

import re
from collections.abc import Mapping
from enum import Enum

from bo_tuner.study.units import unit_in


class Kind(Enum):
    """What a parameter is by its name; the value says so in words."""

    TUNING = "tells of tuning"
    PLANT = "a property of the plant"
    SET_POINT = "a set-point"
    LIMIT = "a limit"
    TIMING = "a time, period or rate"
    DISTANCE = "a distance"
    COUNT = "a size or count"
    UNKNOWN = ""


def _whole(*patterns: str) -> re.Pattern[str]:
    """Match any of the patterns as whole words of a name, which underscores join."""
    return re.compile(rf"(?:^|_)(?:{'|'.join(patterns)})(?=_|$)")


def _last(*patterns: str) -> re.Pattern[str]:
    return re.compile(rf"(?:^|_)(?:{'|'.join(patterns)})$")


_GAIN = (
    r"k[pidfvasq]+|kff|gains?|weights?|weighting|penalt(?:y|ies)|covariances?|(?:co)?variance",
)
_LIMIT = (
    r"max(?:imum)?|min(?:imum)?|lower|upper|limits?|limiter|bounds?|clamp|clip|saturation|saturate",
    r"ceiling|floor|thresh(?:old)?|tolerance|tol|dead_?(?:band|zone)|cap|allow(?:ed|able)",
    r"constraints?",
)
_SETTINGS = (
    (
        Kind.SET_POINT,
        _whole(
            r"targets?|set_?points?|sp|goals?|references?|ref|desired|wanted|demand",
            r"initial|init|home|start|rest",
        ),
    ),
    (
        Kind.TIMING,
        _whole(
            r"frequency|freq|fps|timeouts?|periods?|intervals?|durations?|sampl(?:e|ing)|dt",
            r"time_?step|rate_(?:hz|s)|hz",
        ),
    ),
    (Kind.TIMING, _last(r"rate|time|times|seconds|secs?|ms")),
    (Kind.DISTANCE, _whole(r"distances?|dist")),
    (Kind.COUNT, _whole(r"size|counts?|num|number|depth|id|port|baud|index|channel|version")),
    (Kind.COUNT, _last(r"steps|iterations|samples|order|degree")),
)
_STRONG = _whole(
    r"cut_?off|corner|crossover|bandwidth|natural_frequency|horizon|look_?ahead|process_noise",
    r"(?:learning|adaptation|forgetting)_(?:rate|factor)",
    r"(?:integral|integration|derivative|reset|filter|rise)_time|feed_?forward|compensation",
    r"inflation|scaling_factor|damping_ratio",
)
"""Names of tuning parameters, whatever else is in the name: `cutoff_frequency` is no rate."""
_PLANT = _whole(
    r"mass(?:es)?|inertias?|moment|friction|stiction|payload|luggage|ballast|wind|gust|gravity|drag",
    r"backlash|viscosity|density|inductance|resistance|disturbance|slope|slip|gear(?:box)?",
    r"wheel_?(?:radius|diameter|base|separation|track)|track_?width|radius|diameter",
    r"(?:arm|link|rod|cable|pole|pendulum|body)_length|(?:center|centre)_of_(?:mass|gravity)",
    r"delay|latency|dead_?time|(?:torque|motor|emf|speed)_constant|supply_voltage|battery_voltage",
)
_LOAD = _last(r"loads?")
_NOISE = _whole(r"noise|bias(?:es)?|vibrations?|jitter|drift|random_walk|turbulence")
_EITHER = _whole(r"damping|damper|stiffness|spring|time_?constants?|tau|lag")
"""Names of a plant's parameters, or of a controller's with a filter or an impedance."""
_WEAK = _whole(
    *_GAIN,
    r"alpha|beta|gamma|lambda|eta|rho|sigma|std|stddev|standard_deviation|variances?|penalize",
    r"proportional|integral|derivative|integrator|smoothing|filter|poles?|eigenvalues?|aggressiveness",
)
_LETTERS = re.compile(r"(?:^|_)(?:[pidkqr]|ff|ti|td)$|^(?:[pidk]|ff)_")
_COMPLIANT = _whole(r"admittance|impedance|compliance")
"""A controller of this kind has a mass, a damping and a stiffness of its own to tune."""
_ESTIMATOR = _whole(
    r"(?:\w+_)?(?:estimator|observer|filter|[eu]?kf|kalman|fusion|localization|process_noise)",
    r"(?:\w+_)?covariances?",
)
_MASS = re.compile(r"kg\b")
_CLAUSE_END = re.compile(r"[\[(,;:.]")


def kinds(
    node: str, parameters: Mapping[str, str], *, is_estimator: bool = False
) -> dict[str, Kind]:
    """Return what each parameter of a node is.

    Parameters
    ----------
    node
        Name of the node.
    parameters
        What the node says of each in words, by name.
    is_estimator
        Whether it is known to be an estimator; otherwise names tell.
    """
    of_node = _words(node)
    texts = [of_node, *(_words(name) for name in parameters)]
    is_estimator = is_estimator or any(_ESTIMATOR.search(text) for text in texts)
    noise = Kind.TUNING if is_estimator else Kind.PLANT
    by_name = {
        name: _kind(name, description, noise, is_compliant=bool(_COMPLIANT.search(of_node)))
        for name, description in parameters.items()
    }
    known = set(by_name.values())
    # A time constant is the plant's if the node has a mass, and a filter's if it has a gain.
    meant = Kind.PLANT if Kind.PLANT in known else Kind.TUNING
    if {Kind.PLANT, Kind.TUNING} <= known:
        meant = Kind.UNKNOWN
    return {name: meant if kind is None else kind for name, kind in by_name.items()}


def _kind(name: str, description: str, noise: Kind, *, is_compliant: bool) -> Kind | None:
    """Return the kind of a parameter; None where the other parameters of the node decide it."""
    *groups, leaf = (_words(part) for part in name.split("."))
    kind = _of_words(leaf, noise)
    is_compliant = is_compliant or any(_COMPLIANT.search(group) for group in groups)
    if is_compliant and kind in (Kind.PLANT, None):
        return Kind.TUNING
    if kind in (Kind.TUNING, Kind.UNKNOWN) and _MASS.match(unit_in(description)):
        return Kind.PLANT
    for group in reversed(groups):
        if kind is Kind.UNKNOWN:
            kind = _of_words(group, noise, is_name=False)
    if kind is Kind.UNKNOWN:
        # Only the first clause of a description: the rest may name other parameters.
        by_text = _of_words(_words(_CLAUSE_END.split(description)[0]), noise, is_name=False)
        kind = by_text if by_text in (Kind.TUNING, Kind.PLANT) else kind
    return kind


def _of_words(text: str, noise: Kind, *, is_name: bool = True) -> Kind | None:
    if _whole(*_LIMIT).search(text):
        return Kind.TUNING if _last(r"weights?|penalt(?:y|ies)|cost").search(text) else Kind.LIMIT
    is_gain = _last(*_GAIN).search(text) or (is_name and _LETTERS.search(text))
    is_timing = _last(r"dt|period|hz|rate|interval|timeout").search(text)
    if is_gain or (_STRONG.search(text) and not is_timing):
        return Kind.TUNING
    if _NOISE.search(text):
        return noise
    if _PLANT.search(text) or _LOAD.search(text):
        return Kind.PLANT
    for kind, pattern in _SETTINGS:
        if pattern.search(text):
            return kind
    if _EITHER.search(text):
        return None
    return Kind.TUNING if _WEAK.search(text) else Kind.UNKNOWN


def _words(text: str) -> str:
    """Return the words of a name in lower case, joined by underscores: `maxVelX2` is max_vel_x."""
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text)
    return "_".join(re.findall(r"[a-z]+", apart.lower()))
