"""Packages that offer methods, as installed ones do."""

from pathlib import Path


def offer(folder: Path, package: str, **methods: str) -> None:
    """Have a package, in a folder of the path, offer methods: ``module:name``, with titles."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = (f"{name}: {name} of {package} = {value}\n" for name, value in methods.items())
    (info / "entry_points.txt").write_text("[bo_tuner.methods]\n" + "".join(lines))
