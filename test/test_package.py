import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
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
    statement = re.compile(r"^ *(?:from (\w+)[\w.]* import\b|import (\w+)[\w.]*(?: as \w+)?$)", re.MULTILINE)
    found = [pair for path in PACKAGE.rglob("*.py") for pair in statement.findall(path.read_text())]
    return {one or other for one, other in found} - sys.stdlib_module_names - {PACKAGE.name}


def test_every_import_is_declared(manifest, arguments):
    """Each library that the package imports is asked for in setup.py, each ROS package in package.xml, and no other."""
    required = {
        requirement.split(">")[0].lower().replace("pyyaml", "yaml") for requirement in arguments["install_requires"]
    }
    depends = {depend.name for depend in manifest.exec_depends}
    ros = {name for name in depends if not name.startswith("python3-")} - {"launch", "launch_ros"}
    extras = arguments["extras_require"]
    optional = {
        requirement.split(">")[0]
        for extra in ("bags", "fleet", "notebook", "report", "tables")
        for requirement in extras[extra]
    }
    assert third_party_imports() == required | ros | optional
    keys = {name.removeprefix("python3-") for name in depends if name.startswith("python3-")}
    assert keys == required, "package.xml asks for what every command needs, by rosdep keys with a package of Ubuntu"


@pytest.mark.parametrize(
    ("group", "kind"),
    [
        ("console_scripts", ast.FunctionDef),
        ("tam_calibration.readers", ast.ClassDef),
    ],
)
def test_entry_points_exist(arguments, group, kind):
    """Every command and reader names a module of the package and what is in it; told without importing rclpy."""
    for point in arguments["entry_points"][group]:
        module, name = point.split(" = ")[1].split(":")
        source = (ROOT / module.replace(".", "/")).with_suffix(".py")
        defined = {node.name for node in ast.parse(source.read_text()).body if isinstance(node, kind)}
        assert name in defined, f"{point}: {source.name} has no {name}"


def run(*command, **options):
    """Run a command to its good end."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def colcon(folder, *command):
    """Run colcon on the package in a folder."""
    program = shutil.which("colcon", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    assert program, "colcon is missing: pip install colcon-common-extensions"
    return run(program, *command, "--base-paths", str(ROOT), cwd=folder)


def test_colcon_knows_the_kind_of_the_package(tmp_path):
    """A package of ROS in Python."""
    assert "(ros.ament_python)" in colcon(tmp_path, "list")


@pytest.fixture(scope="module", params=["", "--symlink-install"])
def workspace(tmp_path_factory, request):
    """Build the package with colcon and return the workspace."""
    folder = tmp_path_factory.mktemp("workspace")
    colcon(folder, "build", *request.param.split())
    return folder


@pytest.fixture
def prefix(workspace):
    """Return the folder into which colcon installed the package."""
    return workspace / "install" / PACKAGE.name


@pytest.mark.parametrize("workspace", [""], indirect=True)
def test_colcon_installs_the_whole_package(prefix):
    """Every file of the package is installed, data included."""
    assert files_below(next(prefix.glob("lib/python3*/site-packages")) / PACKAGE.name) == files_below(PACKAGE)


def test_colcon_installs_what_ros_looks_for(prefix):
    """The marker, package.xml, launch files and configuration are in share, the commands where ``ros2 run`` looks."""
    share = prefix / "share"
    assert (share / "ament_index/resource_index/packages" / PACKAGE.name).is_file()
    assert (share / PACKAGE.name / "package.xml").is_file()
    assert files_below(share / PACKAGE.name / "launch") == files_below(ROOT / "launch")
    assert files_below(share / PACKAGE.name / "config") == files_below(ROOT / "config")
    commands = prefix / "lib" / PACKAGE.name
    assert all(os.access(commands / name, os.X_OK) for name in ("tam", "collector", "calibrator", "corrector"))


def test_command_runs_where_colcon_put_it(workspace, tmp_path):
    """In a shell that sourced the workspace the installed command finds the package and its scenarios."""
    source = f". {workspace}/install/local_setup.bash"
    tam = f"{workspace}/install/{PACKAGE.name}/lib/{PACKAGE.name}/tam"
    run("bash", "-c", f"{source} && {tam} simulate wu_table_1 -o run.csv", cwd=tmp_path)
    assert (tmp_path / "run.csv").stat().st_size > 10_000


def test_command_runs_where_pip_put_it(tmp_path):
    """From a wheel in an environment of its own the command finds the scenarios; all other tests do in the sources."""
    sources, environment = tmp_path / "sources", tmp_path / "environment"
    for name in (PACKAGE.name, "config", "launch", "resource"):
        shutil.copytree(ROOT / name, sources / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("package.xml", "pyproject.toml", "setup.cfg", "setup.py"):
        shutil.copy(ROOT / name, sources)
    run(sys.executable, "-m", "venv", "--without-pip", environment)
    (packages,) = environment.glob("lib/python3*/site-packages")
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib"))  # numpy and the others, by their path
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    pip = [sys.executable, "-m", "pip", "--python", environment, "install", "--no-index", "--ignore-installed"]
    run(*pip, "--no-deps", "--no-build-isolation", "--no-compile", sources, env=alone)
    run(environment / "bin" / "tam", "simulate", "wu_table_1", "-o", "run.csv", cwd=tmp_path, env=alone)
    assert (tmp_path / "run.csv").stat().st_size > 10_000
    where = f"import {PACKAGE.name}.files.text_files as c; print(c.configuration_folder())"
    found = run(environment / "bin" / "python", "-c", where, cwd=tmp_path, env=alone)
    assert Path(found.strip()) == environment / "share" / PACKAGE.name / "config"
