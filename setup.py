"""Packages of the distribution: the code, and the shipped nets, which lie beside it in the repository."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["advdiff_sumo", "advdiff_sumo.*"]), "advdiff_sumo.networks"],
    package_dir={"advdiff_sumo.networks": "networks"},
    package_data={
        "advdiff_sumo": [
            "py.typed",
            "report/assets/*",
            "weights/*",
            "experiments/bench/*.json",
            "planner_kit/planner.*",
        ],
        "advdiff_sumo.networks": ["*.net.xml", "*.poly.xml"],
    },
)
