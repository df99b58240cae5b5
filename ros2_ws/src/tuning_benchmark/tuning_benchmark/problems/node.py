"""What the nodes of closed-form problems have in common."""

from collections.abc import Mapping
from typing import Any

from bo_tuner.study.study import Study
from bo_tuner.study.study_file import study_from_mapping

NODE = {"node": "problem"}


def problem_study(code: str, settings: Mapping[str, object], **sections: Any) -> Study:
    """Return a study in process, of one node ``module:Class`` with its constant parameters."""
    node = NODE | {"result": "~/result", "object": code, "parameters": settings}
    budget = {"trials": 40, "drawn_contexts": 3, "search_evaluations": 4}
    common = {
        "nodes": {"problem": node},
        "seed_parameter": NODE | {"parameter": "seed"},
        "trigger": NODE | {"service": "~/run"},
        # The default is the cube's centre, near what is searched for.
        "start": [],
        "budget": budget | {"initial_trials": 4 + len(sections["parameters"])},
    }
    return study_from_mapping(common | sections)


class ParameterizedNode:
    """A node that takes any parameter; what it evaluates is up to its subclass.

    Attributes
    ----------
    values : dict
        The parameters that were set last, by name.
    """

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Take settings, parameters, contexts and the seed."""
        self.values |= values
