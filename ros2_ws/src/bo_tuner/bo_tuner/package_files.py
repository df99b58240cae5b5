"""Where the files lie that ship with the package."""

from pathlib import Path

from bo_tuner.errors import PackageFilesError


def config_directory() -> Path:
    """Return the package's `config` directory, installed or in the source tree.

    Returns
    -------
    pathlib.Path
        `<prefix>/share/bo_tuner/config` beside `<prefix>/lib/pythonX.Y/site-packages/bo_tuner`,
        or `config` beside the package in the source tree.

    Raises
    ------
    PackageFilesError
        If neither holds the shipped studies.
    """
    # A symlink install (`colcon build --symlink-install`) leads back to the source tree.
    parents = Path(__file__).resolve().parents
    candidates = [parents[1] / "config"]
    if len(parents) > 4:
        # First, because site-packages may hold an unrelated top-level `config`.
        candidates.insert(0, parents[4] / "share" / "bo_tuner" / "config")
    for candidate in candidates:
        if (candidate / "studies").is_dir():
            return candidate
    raise PackageFilesError(
        f"the shipped studies are missing: expected a folder 'studies' in "
        f"{' or '.join(map(str, candidates))}; install bo_tuner again"
    )
