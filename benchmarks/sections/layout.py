"""What the sections of docs/performance.md share: the origin of a result, and tables."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Result = Mapping[str, Any]


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Lay out a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def origin(result: Result) -> str:
    """Tell how a result came about."""
    p = result["provenance"]
    seeds = f", seeds {p['seeds'][0]} to {p['seeds'][-1]}" if p.get("seeds") else ""
    changed = p.get("changed_since_commit") or " with " in p["commit"]
    commit = p["commit"][:10] + (", with uncommitted changes" if changed else "")
    return (
        f"*`{p['command']}`, {p['date'][:10]}, commit {commit}{seeds}; "
        f"{p['processor']}, {p['cpus']} cores, Python {p['python']}.*"
    )
