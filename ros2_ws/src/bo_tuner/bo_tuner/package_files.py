"""Where the files lie that ship with a package."""

from importlib.util import find_spec
from pathlib import Path

from bo_tuner.errors import PackageFilesError


def config_directory(package: str = "bo_tuner") -> Path:
    """Return the `config` directory of a package, installed or in the source tree.

    Returns
    -------
    pathlib.Path
        `<prefix>/share/<package>/config` beside `<prefix>/lib/pythonX.Y/site-packages/<package>`,
        or `config` beside the package in the source tree.

    Raises
    ------
    PackageFilesError
        If neither holds the shipped studies.
    """
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise PackageFilesError(f"{package} is not installed")
    # A symlink install (`colcon build --symlink-install`) leads back to the source tree.
    parents = Path(spec.origin).resolve().parents
    candidates = [parents[1] / "config"]
    if len(parents) > 4:
        # First, because site-packages may hold an unrelated top-level `config`.
        candidates.insert(0, parents[4] / "share" / package / "config")
    for candidate in candidates:
        if (candidate / "studies").is_dir():
            return candidate
    raise PackageFilesError(
        f"the shipped studies are missing: expected a folder 'studies' in "
        f"{' or '.join(map(str, candidates))}; install {package} again"
    )
