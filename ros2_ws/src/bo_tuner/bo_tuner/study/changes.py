"""What differs between two studies."""

from collections.abc import Iterator, Mapping

from bo_tuner.study import checks
from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_to_mapping

MOST_SHOWN = 3
OF_A_RUN = ("name", "description", "seed", "budget", "start", "certificate", "folder")
"""Sections that may differ between runs whose trials can be compared."""


def changes(then: Study, now: Study) -> list[str]:
    """Return what has changed, as ``key.path then -> now``; empty if the studies are equal."""
    before = dict(_leaves(study_to_mapping(then)))
    after = dict(_leaves(study_to_mapping(now)))
    return [
        f"{path} {_shown(before, path)} -> {_shown(after, path)}"
        for path in before | after
        # By their text: for a node, 3 and 3.0 differ.
        if repr(before.get(path)) != repr(after.get(path)) or (path in before) != (path in after)
    ]


def incomparable_changes(then: Study, now: Study) -> list[str]:
    """Return the `changes` after which trials cannot be compared with the earlier ones."""
    return [
        change for change in changes(then, now) if change.split()[0].split(".")[0] not in OF_A_RUN
    ]


def summarized(found: list[str]) -> str:
    """Return changes as one line, the first few of them if there are many."""
    more = len(found) - MOST_SHOWN
    return "; ".join(found[:MOST_SHOWN]) + (f"; and {more} more" if more > 0 else "")


def _leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    if not isinstance(value, Mapping) or not value:
        yield path, value
        return
    for key, item in value.items():
        yield from _leaves(item, f"{path}.{key}" if path else str(key))


def _shown(leaves: Mapping[str, object], path: str) -> str:
    return checks.show(leaves[path]) if path in leaves else "nothing"
