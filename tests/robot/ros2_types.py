"""Message packages that are on no wheel, built from their definitions with the generators that come
with rclpy's wheels and the system's compiler: real type support, as on a robot.

``python tests/robot/ros2_types.py FOLDER`` builds them there. It takes some seconds a package.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

PATH_RESULT = """
nav_msgs/Path path
builtin_interfaces/Duration planning_time
uint16 error_code
string error_msg
---
"""
CODES = [
    "UNKNOWN",
    "INVALID_PLANNER",
    "TF_ERROR",
    "START_OUTSIDE_MAP",
    "GOAL_OUTSIDE_MAP",
    "START_OCCUPIED",
    "GOAL_OCCUPIED",
    "TIMEOUT",
    "NO_VALID_PATH",
    "NO_VIAPOINTS_GIVEN",
]


def codes(first, count):
    """Nav2's error codes, which are numbered on from the first."""
    lines = [f"uint16 {name}={first + at}" for at, name in enumerate(CODES[:count])]
    return "\n".join(["uint16 NONE=0", *lines])


GOAL = "geometry_msgs/PoseStamped start\nstring planner_id\nbool use_start\n---\n"
DEFINITIONS = {
    "grid_map_msgs": {
        "msg/GridMapInfo.msg": (
            "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n"
        ),
        "msg/GridMap.msg": (
            "std_msgs/Header header\nGridMapInfo info\nstring[] layers\nstring[] basic_layers\n"
            "std_msgs/Float32MultiArray[] data\nuint16 outer_start_index\nuint16 inner_start_index\n"
        ),
    },
    "nav2_msgs": {
        "action/ComputePathToPose.action": (
            f"geometry_msgs/PoseStamped goal\n{GOAL}{codes(200, 9)}{PATH_RESULT}"
        ),
        "action/ComputePathThroughPoses.action": (
            f"nav_msgs/Goals goals\n{GOAL}{codes(300, 10)}{PATH_RESULT}"
        ),
    },
}
"""As of ROS 2 Kilted, without comments."""
NEEDED = [
    "std_msgs",
    "geometry_msgs",
    "builtin_interfaces",
    "nav_msgs",
    "action_msgs",
    "service_msgs",
    "unique_identifier_msgs",
]
PARTS = [
    "rosidl_generator_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_c",
    "rosidl_generator_py",
]
MODULE = "module"
SOURCES = list(
    zip(
        (*PARTS, MODULE),
        ("gcc", "g++", "g++", "gcc", "gcc"),
        (
            "*/detail/*.c",
            "*/detail/*_c.cpp",
            "*/*__type_support.cpp",
            "*/_*_s.c",
            "_*_s.ep.rosidl_typesupport_c.c",
        ),
        strict=True,
    )
)
"""Parts of a package, their compilers and sources."""
RUNTIME = [
    "rosidl_runtime_c",
    "rcutils",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp",
    "fastcdr",
    "rosidl_typesupport_c",
    "rosidl_typesupport_introspection_c",
]


def built():
    """The folder of all packages, built when first asked for, for tests to come too; importable from
    now on.
    """
    script = Path(__file__)
    stamp = hashlib.sha256(script.read_bytes()).hexdigest()[:12]
    folder = script.parents[2] / "build" / f"ros2-types-{stamp}"
    if not folder.exists():
        made = folder.with_suffix(f".{os.getpid()}")
        shutil.rmtree(made, ignore_errors=True)
        subprocess.run([sys.executable, script, made], check=True, capture_output=True)
        made.rename(folder)
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return folder


def build(folder):
    """Build all packages; importable with the folder on the path."""
    os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    for package, files in DEFINITIONS.items():
        generate(package, files, folder)
        compile_sources(package, folder)


def generate(package, files, folder):
    from rosidl_adapter import convert_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport

    share = folder / "share" / package
    interfaces = []
    for name, text in files.items():
        (share / name).parent.mkdir(parents=True, exist_ok=True)
        (share / name).write_text(text)
        made = convert_to_idl(share, package, Path(name), share)
        interfaces.append(f"{share}:{made.relative_to(share)}")
    paths = [str(Path(sys.prefix, "share")), str(share.parent)]
    for generator in (
        GenerateC("c"),
        GenerateFastRTPSCTypesupport("fastrtps_c"),
        GenerateCTypesupport("c", typesupport_implementations=["rosidl_typesupport_fastrtps_c"]),
        GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]),
    ):
        generator.generate(package, interfaces, paths, folder / package)


def compile_sources(package, folder):
    """Four libraries and the module that Python imports; each is linked against those before it."""
    import numpy

    place = folder / package
    headers = Path(sys.prefix, "include")
    includes = [folder, headers, *headers.iterdir(), sysconfig.get_paths()["include"]]
    flags = [f"-I{each}" for each in [*includes, numpy.get_include()]]
    flags += ["-shared", "-fPIC", "-O0", "-w", f"-L{place}", f"-L{sys.prefix}/lib"]
    flags.append(f"-Wl,-rpath,$ORIGIN:{sys.prefix}/lib")
    libraries = [f"-l{each}__{part}" for each in NEEDED for part in PARTS]
    libraries += [f"-l{each}" for each in RUNTIME]
    for part, compiler, pattern in SOURCES:
        target = f"lib{package}__{part}.so"
        if part == MODULE:
            target = f"{package}_s__rosidl_typesupport_c.so"
        sources = sorted(map(str, place.glob(pattern)))
        command = [compiler, *sources, *flags, "-o", str(place / target), *libraries]
        subprocess.run(command, check=True)
        libraries.insert(0, f"-l{package}__{part}")


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve())
