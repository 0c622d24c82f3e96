import ast
import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import setuptools
from catkin_pkg.changelog import get_changelog_from_path
from catkin_pkg.package import parse_package

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "tam_calibration"


def files_below(folder):
    """Return the files below a folder, relative to it, without compiled Python."""
    files = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc"}
    return {str(path) for path in files}


@pytest.fixture
def manifest():
    """Return package.xml, parsed and validated as ROS tools do."""
    warnings = []
    package = parse_package(ROOT, warnings=warnings)
    assert warnings == []
    return package


@pytest.fixture
def arguments(monkeypatch):
    """Return what setup.py gives to setuptools."""
    given = {}
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: given.update(arguments))
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py")
    return given


def test_package_xml_and_setup_py_agree(manifest, arguments):
    """What both must state, both state alike."""
    maintainer = manifest.maintainers[0]
    assert manifest.name == arguments["name"] == PACKAGE.name
    assert manifest.version == arguments["version"]
    assert manifest.description == arguments["description"]
    assert manifest.licenses == [arguments["license"]]
    assert (maintainer.name, maintainer.email) == (arguments["maintainer"], arguments["maintainer_email"])


@pytest.mark.filterwarnings("ignore:nodes.Node.traverse:DeprecationWarning")  # catkin_pkg with a new docutils
def test_changelog_names_the_version(manifest):
    """The changelog is in the form of ROS and describes the version."""
    changelog = get_changelog_from_path(ROOT / "CHANGELOG.rst", manifest.name)
    assert changelog.get_content_of_version(manifest.version)


def third_party_imports():
    """Return the top names of all modules that the package imports and that neither it nor Python holds."""
    names = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module.split(".")[0])
    return names - sys.stdlib_module_names - {PACKAGE.name}


def test_every_import_is_declared(manifest, arguments):
    """Each library that the package imports is asked for in setup.py, each ROS package in package.xml, and no other."""
    required = {
        requirement.split(">")[0].lower().replace("pyyaml", "yaml") for requirement in arguments["install_requires"]
    }
    depends = {depend.name for depend in manifest.exec_depends}
    ros = {name for name in depends if not name.startswith("python3-")} - {"launch", "launch_ros"}
    optional = {requirement.split(">")[0] for requirement in arguments["extras_require"]["fleet"]}
    assert third_party_imports() == required | ros | optional
    keys = {name.removeprefix("python3-").removesuffix("-pip") for name in depends if name.startswith("python3-")}
    assert keys == required - {"ppigrf", "pydantic", "zstandard"}  # by pip, as package.xml says


@pytest.mark.parametrize(
    ("group", "kind"), [("console_scripts", ast.FunctionDef), ("tam_calibration.effects", ast.ClassDef)]
)
def test_entry_points_exist(arguments, group, kind):
    """Every command and effect names a module of the package and what is in it; told without importing rclpy."""
    for point in arguments["entry_points"][group]:
        module, name = point.split(" = ")[1].split(":")
        source = (ROOT / module.replace(".", "/")).with_suffix(".py")
        defined = {node.name for node in ast.parse(source.read_text()).body if isinstance(node, kind)}
        assert name in defined, f"{point}: {source.name} has no {name}"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Build the package with colcon and return the folder into which it was installed."""
    folder = tmp_path_factory.mktemp("workspace")
    colcon = shutil.which("colcon", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    assert colcon, "colcon is missing: pip install colcon-common-extensions"
    base = ["--base-paths", str(ROOT)]
    options = {"cwd": folder, "capture_output": True, "text": True, "timeout": 120}
    listed = subprocess.run([colcon, "list", *base], **options)
    assert "(ros.ament_python)" in listed.stdout, listed.stderr
    built = subprocess.run([colcon, "build", *base], **options)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / "install" / PACKAGE.name


def test_colcon_installs_the_whole_package(installed):
    """Every file of the package is installed, data included."""
    assert files_below(next(installed.glob("lib/python3*/site-packages")) / PACKAGE.name) == files_below(PACKAGE)


def test_colcon_installs_what_ros_looks_for(installed):
    """The marker, package.xml, launch files and configuration are in share, the commands where ``ros2 run`` looks."""
    share = installed / "share"
    assert (share / "ament_index/resource_index/packages" / PACKAGE.name).is_file()
    assert (share / PACKAGE.name / "package.xml").is_file()
    assert files_below(share / PACKAGE.name / "launch") == files_below(ROOT / "launch")
    assert files_below(share / PACKAGE.name / "config") == files_below(PACKAGE / "config")
    commands = installed / "lib" / PACKAGE.name
    assert all(os.access(commands / name, os.X_OK) for name in ("tam", "collector", "calibrator", "corrector"))


def test_command_runs_where_colcon_put_it(installed):
    """The installed command finds the installed package."""
    path = next(installed.glob("lib/python3*/site-packages"))
    command = [installed / "lib" / PACKAGE.name / "tam", "--version"]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": str(path)}, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
