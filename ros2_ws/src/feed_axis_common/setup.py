from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "feed_axis_common"

setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    description="What the plant and the controller of a feed axis share",
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
    ],
    # rclpy and the message packages are no requirement: with a ROS installation they are system
    # packages, which pip does not see. Without one they are an extra.
    python_requires=">=3.11",
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11,<2",
        "PyYAML>=6,<7",
    ],
    extras_require={
        "jazzy": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "kilted": ["ros-kilted-rclpy[fastrtps]", "ros-kilted-common-interfaces"],
        "test": ["pytest"],
    },
    zip_safe=False,
)
