"""Which methods there are, by name: those of the tuner, then those of other packages.

A package offers one by an entry point of the group `bo_tuner.methods` whose name is ``NAME: title``
and whose value names the method. So help and records know all of them, and load none.
"""

from importlib.metadata import EntryPoint, entry_points

GROUP = "bo_tuner.methods"

BOUNDARY, SAFE = "boundary", "safe"
DEFAULT_METHOD = BOUNDARY

OWN = {
    BOUNDARY: "search, then repeated runs at the boundary of the limits, all pooled in one joint "
    "model",
    SAFE: "as boundary, in bounded steps among what is expected to keep all limits",
}


def titles() -> dict[str, str]:
    """Return a short description of each method."""
    return OWN | {name: entry.name.partition(":")[2].strip() for name, entry in offered().items()}


def offered() -> dict[str, EntryPoint]:
    """Return what other packages offer, by the names of the methods; none has the name of ours."""
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=GROUP):
        name = entry.name.partition(":")[0].strip()
        if name not in OWN:
            # As with an import, the first on the path counts.
            found.setdefault(name, entry)
    return found


def package_of(name: str) -> str:
    """Return the package that offers a method; empty for one of the tuner."""
    entry = offered().get(name)
    return entry.dist.name if entry is not None and entry.dist is not None else ""
