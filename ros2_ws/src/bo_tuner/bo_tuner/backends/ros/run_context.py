"""Where a run is seen on ROS whose workers have their nodes in domains of their own."""

import contextlib
import os
from collections.abc import Iterator, Sequence

from rclpy.context import Context

from bo_tuner.backends.ros.isolation import (
    DomainClaim,
    domain_of_environment,
    isolated_environment,
    namespace_of,
)
from bo_tuner.backends.ros.tuner_node import TunerNode
from bo_tuner.backends.workers.workers import Bench


@contextlib.contextmanager
def run_context(ros_arguments: Sequence[str], benches: Sequence[Bench]) -> Iterator[Context]:
    """Join the domain of the environment, or a free one; yields the context of a node there."""
    namespace, domain = namespace_of(ros_arguments), domain_of_environment()
    if benches:
        domain = domain or 0
        if (domain, namespace) in {bench.place for bench in benches}:
            domain = None
    claim = DomainClaim(namespace, domain)
    variables = {} if benches else isolated_environment(claim.domain)
    before = {name: os.environ.get(name) for name in variables}
    with contextlib.ExitStack() as stack:
        stack.callback(claim.release)
        stack.callback(_restore, before)
        os.environ.update(variables)
        tuner = TunerNode(claim.domain, ros_arguments, lambda: None)
        stack.callback(tuner.close)
        yield tuner.context


def _restore(variables: dict[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
