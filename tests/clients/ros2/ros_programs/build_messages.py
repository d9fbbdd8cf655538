"""Builds message packages from their definitions with ROS's own generators; run by ROS's Python.

    python build_messages.py FOLDER

FOLDER/msg/PACKAGE/msg/NAME.msg are read; FOLDER/PACKAGE becomes a Python package that rclpy takes, and
FOLDER/hashes.json has the hashes that the generators computed. A C++ compiler must be there.
"""

import json
import subprocess
import sys
import sysconfig
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import rosidl_cli.entry_points

# The wheels name each entry point twice, which the generators refuse.
_UNIQUE = {
    (point.group, point.name): point for each in metadata.distributions() for point in each.entry_points
}
rosidl_cli.entry_points.importlib_metadata = SimpleNamespace(
    entry_points=lambda: metadata.EntryPoints(_UNIQUE.values()), EntryPoint=metadata.EntryPoint
)

from rosidl_cli.command.translate.api import translate  # noqa: E402
from rosidl_generator_c.cli import GenerateC  # noqa: E402
from rosidl_generator_py.cli import GeneratePython  # noqa: E402
from rosidl_typesupport_c.cli import GenerateCTypesupport  # noqa: E402
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport  # noqa: E402

PREFIX = Path(sys.prefix)
FAST = "rosidl_typesupport_fastrtps_c"


def build(folder: Path, package: str) -> dict[str, str]:
    """One package; returns its hashes by message."""
    source = folder / "msg" / package
    target = folder / package
    includes = [str(PREFIX / "share"), str(folder / "msg")]
    files = translate(
        package_name=package,
        interface_files=[
            f"{source}:{path.relative_to(source)}" for path in sorted(source.glob("msg/*.msg"))
        ],
        include_paths=includes,
        output_format="idl",
        output_path=target / "idl",
    )
    generators = [
        GenerateC("c"),
        GenerateFastRTPSCTypesupport("fastrtps_c"),
        GenerateCTypesupport("c", typesupport_implementations=[FAST]),
        GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]),
    ]
    for generator in generators:
        generator.generate(package, files, includes, target)
    compile_all(folder, package, target)
    described = (json.loads(path.read_text()) for path in target.glob("msg/*.json"))
    hashes = (one for each in described for one in each["type_hashes"])
    return {one["type_name"]: one["hash_string"] for one in hashes if one["type_name"].startswith(package)}


def compile_all(folder: Path, package: str, target: Path) -> None:
    """Everything into the one module that rclpy imports."""
    includes = [PREFIX / "include", folder, np.get_include(), sysconfig.get_paths()["include"]]
    includes += [path for path in (PREFIX / "include").iterdir() if path.is_dir()]
    flags = ["-O0", "-fPIC", "-w", *(f"-I{path}" for path in includes)]
    entry = target / f"_{package}_s.ep.rosidl_typesupport_c.c"
    sources = [entry, *target.glob("msg/**/*.c"), *target.glob("msg/**/*.cpp")]
    objects = [folder / f"{package}_{number}.o" for number in range(len(sources))]
    for path, output in zip(sources, objects, strict=True):
        compiler = ["g++", "-std=c++17"] if path.suffix == ".cpp" else ["gcc"]
        subprocess.run([*compiler, *flags, "-c", path, "-o", output], check=True)
    libraries = PREFIX / "lib"
    used = [path for path in libraries.glob("lib*rosidl_*.so") if "generator_cpp" not in path.name]
    further = [libraries / f"lib{name}.so" for name in ("fastcdr", "rcutils", "rmw")]
    module = target / f"{package}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
    found = [path for path in [*used, *further] if path.exists()]
    subprocess.run(
        ["g++", "-shared", "-o", module, *objects, *found, f"-Wl,-rpath,{libraries}"], check=True
    )


if __name__ == "__main__":
    here = Path(sys.argv[1])
    found = {}
    for one in sorted((here / "msg").iterdir()):
        found |= build(here, one.name)
    (here / "hashes.json").write_text(json.dumps(found))
