from pathlib import Path

from setuptools import setup

NAME = "nnpp_edge_ros"
SHARE = f"share/{NAME}"


def files_in(folder):
    return sorted(str(path) for path in Path(folder).iterdir())


setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", files_in("launch")),
        (f"{SHARE}/config", files_in("config")),
    ],
    license="Apache-2.0",
    entry_points={"console_scripts": ["nnpp_edge = nnpp_edge_ros.node:main"]},
)
