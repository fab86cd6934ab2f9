from glob import glob

from setuptools import find_packages, setup

package_name = "isf_core"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "view/viewer.js"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/materials", glob("materials/*.yaml")),
        (f"share/{package_name}/tools", glob("tools/*.yaml")),
        (f"share/{package_name}/blanks", glob("blanks/*.yaml")),
        (f"share/{package_name}/plates", glob("plates/*.yaml")),
        (f"share/{package_name}/adsif", glob("adsif/*.yaml")),
        (f"share/{package_name}/rigs", glob("rigs/*.yaml") + glob("rigs/*.csv")),
    ],
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11",
        "pydantic>=2.5",
        "pint>=0.23",
        "PyYAML>=6.0",
        "numba>=0.59",
        "trimesh>=4.0",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="Process model of incremental sheet forming shared by all packages; free of ROS.",
    license="Apache-2.0",
)
