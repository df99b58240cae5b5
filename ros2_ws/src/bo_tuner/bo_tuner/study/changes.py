"""What differs between two studies, and whether evaluations of one can be data of the other."""

from collections.abc import Iterator, Mapping

from bo_tuner.codec import checks
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_to_mapping

MOST_SHOWN = 3
OF_A_RUN = ("name", "description", "seed", "budget", "start", "certificate", "folder", "guard")
"""Sections that say how much is run, and from where. If studies differ only in these, all data of a
run are data of both."""
JUDGED = (
    *("objective", "further_objectives", "constraints", "metrics", "measured", "signals"),
    *("order", "where"),
)
"""Sections that say what is made of an evaluation, not how it is run."""
SAME_PARAMETER = ("node", "parameter", "type")
SAME_CONTEXT = ("node", "parameter", "type")
"""Keys that make a parameter, or a context variable, the same one for its node."""

Path = tuple[str, ...]


def changes(then: Study, now: Study) -> list[str]:
    """Return what has changed, as ``key.path then -> now``; empty if the studies are equal."""
    return [text for _, text in _changes(then, now)]


def changes_of_data(then: Study, now: Study) -> list[str]:
    """Return the `changes` without those of the sections `OF_A_RUN`."""
    return [text for path, text in _changes(then, now) if path[0] not in OF_A_RUN]


def incomparable_changes(then: Study, now: Study) -> list[str]:
    """Return the `changes` after which no evaluation can be compared with the earlier ones.

    The earlier ones were run in another way, or with other parameters or context variables set.
    """
    return [text for path, text in _changes(then, now) if _is_incomparable(path)]


def summarized(lines: list[str]) -> str:
    """Return changes as one line, the first few of them if there are many."""
    more = len(lines) - MOST_SHOWN
    return "; ".join(lines[:MOST_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def _is_incomparable(path: Path) -> bool:
    section, key = path[0], path[-1]
    if section == "parameters":
        return key in SAME_PARAMETER
    if section == "contexts":
        return key in SAME_CONTEXT
    return section not in (*OF_A_RUN, *JUDGED)


def _changes(then: Study, now: Study) -> list[tuple[Path, str]]:
    before = dict(_leaves(study_to_mapping(then)))
    after = dict(_leaves(study_to_mapping(now)))
    return [
        (path, f"{'.'.join(path)} {_shown(before, path)} -> {_shown(after, path)}")
        for path in before | after
        # By their text: for a node, 3 and 3.0 differ.
        if repr(before.get(path)) != repr(after.get(path)) or (path in before) != (path in after)
    ]


def _leaves(value: object, path: Path = ()) -> Iterator[tuple[Path, object]]:
    if not isinstance(value, Mapping) or not value:
        yield path, value
        return
    for key, item in value.items():
        yield from _leaves(item, (*path, str(key)))


def _shown(leaves: Mapping[Path, object], path: Path) -> str:
    return checks.show(leaves[path]) if path in leaves else "nothing"
