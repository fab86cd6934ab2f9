from glob import glob

from setuptools import find_packages, setup

package_name = "isf_description"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*.yaml")),
        (f"share/{package_name}/layouts", glob("layouts/*")),
    ],
    install_requires=[
        "numpy>=1.26,<3",
        "isf-core",
        "isf-ros",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="The cell as viewers see it: URDF of rig and tools, frames, joint states, layouts of RViz and others.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "cell_state_publisher = isf_description.node:main",
        ],
    },
)
