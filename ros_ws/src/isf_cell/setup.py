from glob import glob

from setuptools import find_packages, setup

package_name = "isf_cell"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        ("bin", ["bin/isf"]),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
        (f"share/{package_name}/config", [*glob("config/*.yaml"), *glob("config/*.xml")]),
        (f"share/{package_name}/config/security", glob("config/security/*.xml")),
    ],
    install_requires=[
        "numpy>=1.26,<3",
        "typer>=0.12",
        "rich>=13",
        "trimesh>=4.0",
        "PyYAML>=6.0",
        "isf-core",
        "isf-ros",
        "isf-planner",
        "isf-sim",
        "isf-springback",
        "isf-force-ctrl",
        "isf-identify",
        "isf-load-cell",
        "isf-analysis",
        "isf-dashboard",
        "isf-description",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="The forming cell: executive node, in-process cell, launch and config files, the isf command.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "executive = isf_cell.executive_node:main",
            "together = isf_cell.together:main",
            "isf = isf_cell.cli:main",
        ],
    },
)
