from glob import glob

from setuptools import Extension, find_packages, setup

package_name = "isf_sim"

# Called by ctypes (isf_sim/explicit_shell/library.py). Vector code for several processors is in one file.
shell_kernels = Extension(
    "isf_sim.explicit_shell._shell",
    sources=["isf_sim/explicit_shell/shell.c"],
    extra_compile_args=[
        "-O3",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-ffp-contract=fast",
        "-fopenmp-simd",
        "-pthread",
    ],
    extra_link_args=["-pthread"],
    libraries=["m"],
)

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
        "matplotlib>=3.6",
        "isf-core",
        "isf-ros",
    ],
    extras_require={"test": ["pytest"]},
    ext_modules=[shell_kernels],
    zip_safe=False,
    maintainer="ISF cell maintainers",
    maintainer_email="maintainers@isf-cell.invalid",
    description="Simulated two-tool forming machine: sheet, contact, servo axes and load cells.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "machine = isf_sim.node:main",
        ],
    },
)
