from setuptools import find_packages, setup

package_name = "isf_ros"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "numpy>=1.26,<3",
        "isf-core",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="ROS plumbing of the cell's nodes: conversion, QoS, lifecycle base, parameters, watchdog.",
    license="Apache-2.0",
)
