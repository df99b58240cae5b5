from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "tuning_benchmark"
METHODS = {
    "I": "Bayesian optimization on the nominal model",
    "II": "random sampling in stage one",
    "III": "Bayesian optimization without outlier detection",
    "IV": "Bayesian optimization with outlier detection",
    "V": "as IV, with one joint model of parameter set and context",
}


def shared(folder):
    """List the files below a folder for share/<package>, sub-folders kept."""
    folders = [path for path in Path(folder).glob("**/") if path.name != "__pycache__"]
    return [
        (f"share/{NAME}/{path}", [str(file) for file in sorted(path.iterdir()) if file.is_file()])
        for path in folders
    ]


setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    description="Comparison of tuning algorithms over many runs",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer="bo_tuner maintainers",
    maintainer_email="maintainers@example.com",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"lib/{NAME}", ["scripts/benchmark"]),
        *shared("config"),
    ],
    # Our other packages are named in package.xml only: they are on no index.
    python_requires=">=3.11",
    install_requires=["joblib>=1.4,<2", "numpy>=1.26,<3", "scipy>=1.11,<2", "threadpoolctl>=3,<4"],
    extras_require={
        "cluster": ["distributed>=2024.8"],
        # The other optimizers, see tuning_benchmark.peers.
        "peers": [
            "torch",
            "botorch>=0.18,<0.19",
            "optuna>=5,<6",
            "greenlet",
            "smac>=2.4,<3",
            "cma>=4.5,<5",
            "cobyqa>=1.1,<2",
        ],
        "test": ["pytest"],
    },
    entry_points={
        "console_scripts": [f"benchmark = {NAME}.__main__:benchmark"],
        "bo_tuner.methods": [
            f"{name}: {title} = {NAME}.paper.algorithms:ALGORITHM_{name}"
            for name, title in METHODS.items()
        ],
    },
    zip_safe=False,
)
