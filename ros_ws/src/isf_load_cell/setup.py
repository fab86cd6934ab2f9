from glob import glob

from setuptools import find_packages, setup

package_name = "isf_load_cell"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*.yaml")),
    ],
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11",
        "pydantic>=2.5",
        "isf-core",
        "isf-ros",
        "isf-force-ctrl",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="Load cells of a forming cell: calibration, raw readings to wrenches, and the node load_cell.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "load_cell = isf_load_cell.node:main",
        ],
    },
)
