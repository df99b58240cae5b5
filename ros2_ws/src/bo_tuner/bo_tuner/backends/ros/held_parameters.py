"""Parameters of nodes outside of evaluations, and those that a study does not set."""

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path

from bo_tuner.backends.ros.parameters import differences
from bo_tuner.errors import BackendError, OutputError
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.run_files import HELD_PARAMETERS, PREVIOUS_PARAMETERS, read_text
from bo_tuner.study.checks import same_value
from bo_tuner.study.study import Study
from bo_tuner.text import brief, shown
from bo_tuner.trials import Value


def safe_parameters(study: Study) -> dict[str, dict[str, object]]:
    """Return by node key the parameters that nodes have while no run is performed."""
    safe = _assigned(study, study.safe_parameters)
    if study.seed_parameter is not None:
        del safe[study.seed_parameter.node][study.seed_parameter.parameter]
    return safe


def divide(
    study: Study, values: Mapping[str, Mapping[str, object]]
) -> tuple[dict[str, dict[str, object]], dict[str, dict[str, object]]]:
    """Return the parameters, by node key, that a study sets, and the others."""
    assigned = _assigned(study, study.search_space().defaults)
    own: dict[str, dict[str, object]] = {}
    others: dict[str, dict[str, object]] = {}
    for key, found in values.items():
        names = {*study.nodes[key].parameters, *assigned.get(key, {})}
        own[key] = {name: value for name, value in found.items() if name in names}
        others[key] = {name: value for name, value in found.items() if name not in names}
    return own, others


def named_safe(
    study: Study, previous: Mapping[str, Mapping[str, object]]
) -> dict[str, dict[str, object]]:
    """Return by node key the values that ``park`` names and nodes do not have already.

    Parameters
    ----------
    study
        The study.
    previous
        What the nodes have, by key. Of an array the items that are not named stay as they are.
    """
    safe, whole = study.safe_parameters, _assigned(study, study.safe_parameters)
    found: dict[str, dict[str, object]] = {}
    for item in (study.parameters[name] for name in study.park.parameters):
        of_node = found.setdefault(item.node, {})
        if not item.array:
            of_node[item.parameter] = safe[item.name]
            continue
        had = of_node.get(item.array, previous[item.node].get(item.array))
        if isinstance(had, list) and item.item < len(had):
            of_node[item.array] = [*had[: item.item], safe[item.name], *had[item.item + 1 :]]
        else:
            of_node[item.array] = whole[item.node][item.array]
    return {
        key: {n: v for n, v in values.items() if not same_value(v, previous[key].get(n))}
        for key, values in found.items()
    }


def left_parked(values: Mapping[str, object], previous: Mapping[str, object]) -> str:
    """Tell in a few words with which safe values a node is left, and which it had before."""
    texts = [f"{n} {_shown(v)} (was {_shown(previous.get(n))})" for n, v in values.items()]
    return f"is left with the park values: {', '.join(texts)}"


def _shown(value: object) -> str:
    if isinstance(value, bool | float):
        return shown(value)
    return "not set" if value is None else brief(str(value))


def _assigned(study: Study, parameters: Mapping[str, Value]) -> dict[str, dict[str, object]]:
    return {key: dict(v) for key, v in study.nominal_assignments(parameters).items()}


def note_previous(folder: Path, values: Mapping[str, Mapping[str, object]]) -> None:
    """Note down in a folder what nodes had, by key, unless that was done when its run began."""
    file = folder / PREVIOUS_PARAMETERS
    # Without the file the way back is to the study's defaults, which the bundle says.
    with contextlib.suppress(OutputError):
        if not file.exists():
            write_atomically(file, json.dumps(values, indent=1, default=str))


def compare_with_earlier(
    folder: Path,
    values: Mapping[str, Mapping[str, object]],
    *,
    refuse: bool,
    note: bool,
) -> bool:
    """Compare parameters with those that were noted down first in a folder, or note them down.

    A validation, or the rest of a run, on attached nodes would else measure something else.

    Parameters
    ----------
    folder
        Takes the file.
    values
        Parameters by node key.
    refuse
        Whether to refuse nodes that have other ones.
    note
        Whether to note them down where there is nothing yet; else the folder is only read.

    Returns
    -------
    bool
        Whether there was nothing yet to compare with.

    Raises
    ------
    BackendError
        If one is not what it was, with its name.
    """
    file = folder / HELD_PARAMETERS
    try:
        earlier = json.loads(read_text(file))
        known = {key: dict(earlier[key]) for key in values}
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        known = {}
    if not known:
        if note:
            with contextlib.suppress(OutputError):
                write_atomically(file, json.dumps(values, indent=1, default=str))
        return True
    if not refuse:
        return False
    for key, now in values.items():
        common = {name: known[key][name] for name in now if name in known[key]}
        if changed := differences(key, json.loads(json.dumps(now, default=str)), common):
            raise BackendError(f"{changed[0]}, as when the run began; set it back")
    return False
