from glob import glob

from setuptools import find_packages, setup

package_name = "isf_springback"

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
        "numba>=0.59",
        "trimesh>=4.0",
        "scikit-learn>=1.3",
        "isf-core",
        "isf-ros",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="Springback correction of every contour before it is formed, by one of several methods.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "springback = isf_springback.node:main",
        ],
        # springback methods by name; packages beside this one add their own (see CONTRIBUTING.md)
        "isf.springback_methods": [
            "none = isf_springback.estimators.estimator:NoCorrection",
            "analytic = isf_springback.estimators.analytic:AnalyticModel",
            "elastic = isf_springback.estimators.elastic:ElasticModel",
            "fused = isf_springback.estimators.fused:FusedEstimator",
            "learned = isf_springback.estimators.learned:learned",
            "learned_map = isf_springback.estimators.learned:learned_map",
            "mpc_vertical = isf_springback.estimators.mpc:MpcVertical",
            "mpc_two_directional = isf_springback.estimators.mpc:MpcTwoDirectional",
            "mpc_tpif = isf_springback.estimators.mpc:MpcTpif",
        ],
    },
)
