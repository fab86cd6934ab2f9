from glob import glob

from setuptools import find_packages, setup

package_name = "isf_analysis"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "*_template.html", "report_style.css", "bag/msg/*.msg"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*.yaml")),
    ],
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11",
        "matplotlib>=3.6",
        "rosbags>=0.10",
        "shapely>=2.0",
        "PyYAML>=6.0",
        "isf-core",
        "isf-ros",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="Recorder, bags, metrics and report of formed parts.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "recorder = isf_analysis.recorder_node:main",
        ],
    },
)
