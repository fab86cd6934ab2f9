from glob import glob

from setuptools import find_packages, setup

package_name = "isf_planner"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "exports/posts/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*.yaml")),
    ],
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11",
        "numba>=0.59",
        "trimesh>=4.0",
        "networkx>=2.8",
        "lxml>=4.9",
        "shapely>=2.0",
        "contourpy>=1.2",
        "matplotlib>=3.6",
        "scikit-learn>=1.3",
        "isf-core",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="Toolpath planning for incremental sheet forming: from a CAD surface to contours and tool tips.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "planner = isf_planner.node:main",
        ],
        # processes by name; packages beside this one add their own (see CONTRIBUTING.md)
        "isf.processes": [
            "SPIF = isf_planner.processes:IncrementalForming",
            "DSIF = isf_planner.processes:DoubleSidedForming",
            "TPIF = isf_planner.processes:FormingOverDie",
            "ADSIF = isf_planner.processes:AccumulativeForming",
        ],
    },
)
