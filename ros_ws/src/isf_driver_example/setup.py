from setuptools import find_packages, setup

package_name = "isf_driver_example"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="A driver to start from: stands in for the machine of a forming cell, hardware calls in one file.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "driver = isf_driver_example.driver_node:main",
        ],
    },
)
