"""ROS 2 packages that PyPI lacks, written from the packaged type tables and compiled by rosidl (``make test-ros2``)."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

from armbridge_ros2.interfaces import ACTIONS, FROM_SERVER, SERVICES, TO_SERVER
from protocol import type_descriptions
from protocol.registry import Registry

WANTED = sorted({each.type for each in (*FROM_SERVER, *TO_SERVER, *SERVICES, *ACTIONS)})
# The folders of Python and numpy on the machine where the published packages were compiled.
PUBLISHED_PYTHON = "/opt/python/cp311-cp311"
SEPARATOR = "=" * 80

Files = dict[str, dict[str, str]]


def interface_files(registry: Registry) -> tuple[Files, dict[str, set[str]]]:
    """Return each package's files with their texts, and the packages that each refers to."""
    files: Files = {}
    needs: dict[str, set[str]] = {}

    def add(package: str, path: str, text: str) -> None:
        files.setdefault(package, {})[path] = text
        needs.setdefault(package, set()).update(
            line.split("/")[0] for line in text.splitlines() if "/" in line.split(" ")[0]
        )

    for wanted in WANTED:
        package, kind, name = wanted.split("/")
        match kind:
            case "action":
                action = registry.action(wanted)
                members = [action.goal, action.result, action.feedback]
            case "srv":
                service = registry.service(wanted)
                members = [service.request, service.response]
            case _:
                members = [registry.message(wanted)]
        own = []
        for member in members:
            text, *others = type_descriptions.full_text(registry, member.name).split(f"\n{SEPARATOR}\nMSG: ")
            own.append(text)
            for other in others:
                (full_name, other_text) = other.split("\n", 1)
                other_package, other_name = full_name.split("/")
                add(other_package, f"msg/{other_name}.msg", other_text)
        add(package, f"{kind}/{name}.{kind}", "---\n".join(own))
    return files, {package: others - {package} for package, others in needs.items()}


def write_package(folder: Path, package: str, files: dict[str, str], needs: set[str]) -> None:
    """Write a package of ROS 2 as rosidl takes it."""
    for path, text in files.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text)
    (folder / "package.xml").write_text(
        f'<package format="3"><name>{package}</name><version>1.0.0</version><description>interfaces</description>'
        '<maintainer email="maintainer@example.com">maintainer</maintainer><license>BSD</license>'
        "<buildtool_depend>ament_cmake</buildtool_depend>"
        "<buildtool_depend>rosidl_default_generators</buildtool_depend>"
        f"{''.join(f'<depend>{need}</depend>' for need in sorted(needs))}"
        "<exec_depend>rosidl_default_runtime</exec_depend>"
        "<member_of_group>rosidl_interface_packages</member_of_group></package>"
    )
    found = "\n".join(f"find_package({need} REQUIRED)" for need in sorted(needs))
    (folder / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.20)\nproject({package})\nfind_package(ament_cmake REQUIRED)\n"
        f"find_package(rosidl_default_generators REQUIRED)\n{found}\n"
        f"rosidl_generate_interfaces(${{PROJECT_NAME}} {' '.join(files)} DEPENDENCIES {' '.join(needs)})\n"
        "ament_package()\n"
    )


def main(prefix: Path) -> None:
    """Compile what is missing in an environment into it."""
    share = prefix / "share"
    places = {
        f"{PUBLISHED_PYTHON}/include/python3.11": sysconfig.get_path("include"),
        f"{PUBLISHED_PYTHON}/lib/": f"{prefix}/lib/",
    }
    for exported in share.rglob("*.cmake"):
        text = exported.read_text()
        if PUBLISHED_PYTHON in text:
            for published, here in places.items():
                text = text.replace(published, here)
            exported.write_text(text)
    files, needs = interface_files(Registry.load())
    environment = {
        **os.environ,
        "PATH": f"{prefix / 'bin'}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(prefix),
        "CMAKE_PREFIX_PATH": str(prefix),
    }
    sources = prefix / "interfaces" / "source"
    missing = [package for package in files if not (share / package).exists() or (sources / package).exists()]
    while missing:
        package = next(each for each in missing if not needs[each] & set(missing))
        missing.remove(package)
        source, target = sources / package, prefix / "interfaces" / "build" / package
        uses_actions = any(path.startswith("action/") for path in files[package])
        write_package(source, package, files[package], needs[package] | ({"action_msgs"} if uses_actions else set()))
        configure = ["cmake", "-S", source, "-B", target, f"-DCMAKE_INSTALL_PREFIX={prefix}", "-DBUILD_TESTING=OFF"]
        configure.append(f"-DPython3_EXECUTABLE={prefix / 'bin' / 'python'}")
        for command in (configure, ["cmake", "--build", target, "-j2"], ["cmake", "--install", target]):
            subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, timeout=3600)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
