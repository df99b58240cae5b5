"""Methods by name, each loaded when it is asked for."""

from collections.abc import Iterator, Mapping
from typing import cast

from bo_tuner.errors import MethodError
from bo_tuner.method_names import BOUNDARY, DEFAULT_METHOD, SAFE, offered, titles
from bo_tuner.methods.boundary.method import Boundary
from bo_tuner.methods.protocol import Method
from bo_tuner.methods.safe.method import Safe
from bo_tuner.study import named_code
from bo_tuner.study.study import Study


class Methods(Mapping[str, Method]):
    """The methods of the tuner and of other packages; see `bo_tuner.method_names`.

    Raises
    ------
    MethodError
        By a look-up, if the method of another package cannot be loaded. One line.
    """

    def __init__(self, own: Mapping[str, Method]) -> None:
        self._own = own

    def __getitem__(self, name: str) -> Method:
        return self._own[name] if name in self._own else _load(name)

    def __contains__(self, name: object) -> bool:
        return name in titles()

    def __iter__(self) -> Iterator[str]:
        return iter(titles())

    def __len__(self) -> int:
        return len(titles())


METHODS = Methods({BOUNDARY: Boundary(), SAFE: Safe()})


def _load(name: str) -> Method:
    entry = offered()[name]
    what = f"the algorithm {name} of the package {entry.dist.name if entry.dist else entry.module}"
    try:
        method: object = entry.load()
    except named_code.faults() as error:
        raise MethodError(f"{what} cannot be loaded: {named_code.described(error)}") from error
    if Method not in type(method).__mro__:
        found = type(method).__name__
        raise MethodError(f"{what}: {entry.value}: expected a Method, found an object of {found}")
    return cast(Method, method)


def method_of(study: Study) -> str:
    """Return the name of the method of a study, unless the user names another one."""
    return DEFAULT_METHOD if study.safe_search is None else SAFE


def problem_of(name: str, study: Study) -> str:
    """Return in one line why a method cannot run a study; empty if it can."""
    problem = _problem(name, study)
    if not problem:
        return ""
    own = method_of(study)
    expected = "" if own == name or _problem(own, study) else f"; expected {own}"
    return f"{name} {problem}{expected}"


def _problem(name: str, study: Study) -> str:
    # What a machine must not go through stands in its study, and no option of a run passes over it.
    if study.safe_search is None and name == SAFE:
        return "needs `safe_search`, and the study has none"
    if study.safe_search is not None and name != SAFE:
        return "is no safe search, and the study has `safe_search`"
    return METHODS[name].problem(study)
