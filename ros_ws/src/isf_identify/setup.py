from setuptools import find_packages, setup

package_name = "isf_identify"

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
        "scipy>=1.11",
        "matplotlib>=3.6",
        "isf-core",
        "isf-force-ctrl",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="Identification of a forming machine with tools or dial indicator, and tuning of its force loop.",
    license="Apache-2.0",
    entry_points={
        # measurements that actions of node force_ctrl begin, by name
        "isf_force_ctrl.measurements": ["identify = isf_identify.identification:Identification"],
    },
)
