"""The packages' metadata: complete, consistent, and true to what the code imports."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bo_tuner.ros_distribution import WHEELS

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "ros2_ws" / "src"
EXECUTABLES = {
    "feed_axis_common": [],
    "mpc_controller": ["mpc_controller"],
    "milling_plant": ["milling_plant"],
    "bo_tuner": [
        "tune",
        "init",
        "check",
        "try",
        "report",
        "validate",
        "replay",
        "recompute",
        "identify",
        "apply",
        "guard",
    ],
    "tuning_benchmark": ["benchmark"],
}
# Import name -> rosdep key and name for pip; None where there is no key.
PIP_PACKAGES = {
    "filterpy": ("python3-filterpy-pip", "filterpy"),
    "jinja2": ("python3-jinja2", "Jinja2"),
    "joblib": ("python3-joblib", "joblib"),
    "matplotlib": ("python3-matplotlib", "matplotlib"),
    "numpy": ("python3-numpy", "numpy"),
    "osqp": (None, "osqp"),
    "rich": ("python3-rich", "rich"),
    "rosbags": ("python3-rosbags-pip", "rosbags"),
    "scipy": ("python3-scipy", "scipy"),
    "simpleeval": (None, "simpleeval"),
    "sklearn": ("python3-sklearn", "scikit-learn"),
    "threadpoolctl": (None, "threadpoolctl"),
    "tornado": ("python3-tornado", "tornado"),
    "yaml": ("python3-yaml", "PyYAML"),
}
ROSDEP_KEYS = {name: key for key, name in PIP_PACKAGES.values()}
# Parts of Python, or of extras: imported only when they are asked for.
NOT_DECLARED = {
    *sys.stdlib_module_names, "setuptools", "cloudpickle", "dask", "distributed",
    "ConfigSpace", "botorch", "cma", "cobyqa", "gpytorch", "greenlet", "optuna", "pandas", "smac",
    "torch",
}  # fmt: skip

every_package = pytest.mark.parametrize("package", EXECUTABLES)


def manifest(package):
    return ElementTree.parse(SOURCE / package / "package.xml").getroot()


def dependencies(package):
    tags = ("depend", "exec_depend")
    return {element.text for tag in tags for element in manifest(package).iter(tag)}


def setup_keyword(package, name):
    """Return a keyword of setup() that is written as a literal."""
    tree = ast.parse((SOURCE / package / "setup.py").read_text(encoding="utf-8"))
    (value,) = (
        node.value for node in ast.walk(tree) if isinstance(node, ast.keyword) and node.arg == name
    )
    return ast.literal_eval(value)


def pip_names(package):
    return {re.match(r"[\w.-]+", text)[0] for text in setup_keyword(package, "install_requires")}


def imported(package):
    """Return the top-level names that a package's modules and launch files need at run time."""
    names = set()
    for folder in (package, "launch"):
        for path in (SOURCE / package / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    names.update(alias.name.partition(".")[0] for alias in node.names)
                elif isinstance(node, ast.ImportFrom) and node.level == 0:
                    names.add(node.module.partition(".")[0])
                elif isinstance(node, ast.keyword) and node.arg == "package":
                    names.update(c.value for c in ast.walk(node) if isinstance(c, ast.Constant))
    return names - NOT_DECLARED - {package}


def tracked_files():
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    return [ROOT / name for name in listed.stdout.split("\0") if name]


@every_package
def test_package_xml_is_format_3_and_complete(package):
    root = manifest(package)
    assert root.get("format") == "3"
    assert root.findtext("name") == package
    assert root.findtext("license") == "Apache-2.0"
    assert root.findtext("export/build_type") == "ament_python"
    assert root.findtext("description").strip()
    # colcon silently treats a package with an address that catkin_pkg refuses as plain Python.
    for maintainer in root.findall("maintainer"):
        assert re.fullmatch(r"[\w.+-]+@[\w-]+(\.[\w-]+)*\.[A-Za-z]{2,}", maintainer.get("email"))


def test_versions_agree():
    versions = {manifest(package).findtext("version") for package in EXECUTABLES}
    assert len(versions) == 1
    assert {metadata.version(package) for package in EXECUTABLES} == versions


@every_package
def test_imports_are_declared(package):
    keys = set()
    names = set()
    for module in imported(package):
        key, name = PIP_PACKAGES.get(module, (module, None))
        keys.add(key)
        names.add(name)
    assert keys - {None} <= dependencies(package)
    assert names - {None} <= pip_names(package)


def ros_dependencies(package):
    other = {"launch", "launch_ros", *EXECUTABLES}
    return {key for key in dependencies(package) if not key.startswith("python3-")} - other


@pytest.mark.parametrize("missing", sorted(ros_dependencies("bo_tuner")))
def test_a_command_without_ros_says_what_to_install(missing):
    program = (
        f"import sys; sys.modules['{missing}'] = None\n"
        "from bo_tuner.cli.executables import tune\n"
        "sys.argv = ['tune', '--help']\ntune()"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    if done.returncode == 0:
        # It is imported later, if at all.
        return
    assert done.returncode == 1
    assert f"({missing} is missing)" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@every_package
def test_import_contract_covers_each_ros_dependency(package):
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (protected,) = (
        set(contract["protected_modules"])
        for contract in settings["tool"]["importlinter"]["contracts"]
        if contract["id"] == "ros"
    )
    assert ros_dependencies(package) <= protected


@every_package
def test_package_xml_and_setup_declare_the_same(package):
    keys = {ROSDEP_KEYS[name] for name in pip_names(package)} - {None}
    assert keys == {key for key in dependencies(package) if key.startswith("python3-")}


@every_package
def test_requirements_are_installed_by_make_and_pinned(package):
    def names(path):
        return set(requirements(path))

    assert pip_names(package) <= names("runtime.txt")
    for path in ("runtime.txt", "dev.txt", "colcon.txt", "dist.txt", "site.txt"):
        assert names(path) <= names("constraints.txt")


def test_workers_are_there_after_make_setup():
    """So docs/workers.md says, and so the Dockerfile, whose image is scheduler and worker, too."""
    extra = setup_keyword("bo_tuner", "extras_require")["workers"]
    assert {re.match(r"[\w.-]+", text)[0] for text in extra} <= set(requirements("runtime.txt"))


def requirements(path):
    """Names in a file of requirements."""
    lines = (ROOT / "requirements" / path).read_text(encoding="utf-8").splitlines()
    return [re.match(r"[\w.-]+", line)[0] for line in lines if line and line[0] != "#"]


@pytest.mark.parametrize("distribution", WHEELS)
def test_ros_is_installed_by_its_distribution_s_names_only(distribution):
    pinned = requirements(f"{distribution}/constraints.txt")
    for path in ("runtime.txt", "dev.txt"):
        names = requirements(f"{distribution}/{path}")
        assert names
        assert all(name.startswith(f"ros-{distribution}-") for name in names)
        assert {*names} <= {*pinned}
        # Elsewhere no name of ROS stands, whose version would be that of one distribution.
        assert not any(name.startswith("ros-") for name in requirements(path))
    assert not any(name.startswith("ros-") for name in requirements("constraints.txt"))
    others = [f"ros-{name}-" for name in WHEELS if name != distribution]
    assert not any(name.startswith(tuple(others)) for name in pinned)


@every_package
def test_source_has_marker_and_executables_for_ros2_run(package):
    assert (SOURCE / package / "resource" / package).is_file()
    scripts = (SOURCE / package).glob("scripts/*")
    assert {path.name for path in scripts if os.access(path, os.X_OK)} == {*EXECUTABLES[package]}


@every_package
def test_each_folder_with_modules_is_a_package(package):
    folders = {path.parent for path in (SOURCE / package / package).rglob("*.py")}
    assert all((folder / "__init__.py").is_file() for folder in folders)


@every_package
def test_installed_package_has_marker_data_and_executables(package):
    prefix = Path(sys.prefix)
    assert (prefix / "share/ament_index/resource_index/packages" / package).is_file()
    for folder in ("config", "launch"):
        for path in (SOURCE / package / folder).rglob("*.*"):
            if "__pycache__" not in path.parts:
                installed = prefix / "share" / package / path.relative_to(SOURCE / package)
                assert installed.read_bytes() == path.read_bytes()
    entry_points = metadata.distribution(package).entry_points.select(group="console_scripts")
    assert entry_points.names == {*EXECUTABLES[package]}
    for entry_point in entry_points:
        assert os.access(prefix / "lib" / package / entry_point.name, os.X_OK)
        assert os.access(prefix / "bin" / entry_point.name, os.X_OK)
        assert callable(entry_point.load())


def test_executable_for_ros2_run_reaches_the_command():
    result = subprocess.run(
        [Path(sys.prefix) / "lib" / "bo_tuner" / "tune", "--help"],
        check=False,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    assert "--study" in result.stdout


def test_launch_files_name_existing_executables():
    for path in SOURCE.glob("*/launch/*.launch.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert "generate_launch_description" in functions
        assert {"launch", "launch_ros"} <= dependencies(path.parents[1].name)
        texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
        assert texts & {name for names in EXECUTABLES.values() for name in names}


def test_no_registry_or_machine_path_in_the_repository():
    # Put together here, so that this file does not find itself.
    forbidden = re.compile(
        "|".join(
            (
                "pypi" + r"\.org",
                "python" + "hosted",
                "index" + "-url",
                "find" + "-links",
                "/" + r"home/\w+",
                "/" + r"root/",
                "/" + r"Users/\w+",
                "/" + r"work/",
            )
        )
    )
    for path in tracked_files():
        try:
            text = path.read_text(encoding="utf-8")
        except (UnicodeDecodeError, FileNotFoundError):  # pictures; deleted, not yet committed
            continue
        match = forbidden.search(text)
        assert match is None, f"{path.relative_to(ROOT)}: {match[0]}"
