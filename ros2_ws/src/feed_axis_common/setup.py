from setuptools import find_packages, setup

NAME = "feed_axis_common"

setup(
    name=NAME,
    version="0.1.0",
    description="What the plant and the controller of a feed axis share",
    maintainer="bo_tuner maintainers",
    maintainer_email="maintainers@example.com",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    # rclpy and the message packages are named in package.xml only: with a ROS installation they
    # are system packages, which pip does not see.
    python_requires=">=3.11",
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11,<2",
        "PyYAML>=6,<7",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
)
