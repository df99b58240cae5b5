"""What the sections of docs/performance.md share: where a result comes from."""

from collections.abc import Mapping
from typing import Any

Result = Mapping[str, Any]


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
