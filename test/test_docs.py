import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
import yaml
from catkin_pkg.package import parse_package
from click.testing import CliRunner

import tam_calibration
from tam_calibration.cli.main import main

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site as ``make docs`` does, where a warning is an error, and return its folder."""
    site = tmp_path_factory.mktemp("site")
    sphinx = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet", DOCS, site]
    done = subprocess.run(sphinx, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return site


def test_every_page_is_in_the_navigation(site):
    """The first page leads to all others, those included that a list forgot."""
    first = (site / "index.html").read_text()
    pages = {path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.rglob("*.md")}
    assert pages <= set(re.findall(r'href="([\w/]+)\.html"', first))


def test_every_picture_is_shown(site):
    """None is left out of the site, also of those that README.md shows."""
    assert {path.name for path in (site / "_images").iterdir()} == {path.name for path in (DOCS / "images").iterdir()}


def test_every_public_name_is_documented(site):
    """What the package gives to Python has its place on the page of its names."""
    page = (site / "reference" / "python.html").read_text()
    assert [name for name in tam_calibration.__all__ if f'id="tam_calibration.{name}"' not in page] == []


def test_rosdoc2_finds_the_pages():
    """The file that package.xml names has rosdoc2's two sections, and leads to the folder with conf.py and an index."""
    (export,) = (each for each in parse_package(ROOT).exports if each.tagname == "rosdoc2")
    kind, content = yaml.safe_load_all((ROOT / export.content).read_text())
    assert kind == {"type": "rosdoc2 config", "version": 1}
    (builder,) = content["builders"]
    folder = ROOT / builder["sphinx"]["user_doc_dir"]
    assert (folder / "conf.py").is_file() and (folder / "index.rst").is_file()


def test_no_command_installs_into_the_python_of_the_system():
    """Where pip is called it is that of an environment: outside of one, Ubuntu's and Debian's Python refuses it."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "Makefile", *DOCS.rglob("*.md"), *DOCS.glob("*.rst")]
    lines = [line for page in [*pages, *(ROOT / "benchmarks").glob("*.py")] for line in page.read_text().splitlines()]
    calls = [line for line in lines if re.search(r"\bpip3? install\b", line)]
    assert calls and [line for line in calls if not re.search(r"(/bin/|\$\(BIN\)/)pip install", line)] == []


def test_the_commands_for_a_recording_of_ones_own_work_as_pasted(tmp_path, monkeypatch, undrawn):
    """Those that README.md shows, one after the other, from an empty folder."""
    monkeypatch.chdir(tmp_path)
    section = (ROOT / "README.md").read_text().partition("## Your own recording")[2].partition("\n## ")[0]
    commands = [shlex.split(line, comments=True)[1:] for line in section.splitlines() if line.startswith("tam ")]
    assert {command[0] for command in commands} == {"simulate", "inspect", "calibrate", "correct", "export"}
    for command in commands:
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 0, done.output


PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def test_the_documentation_stays_short():
    """What is read first has 1200 words, all pages together 30 000, and the changelog of a release 60 lines."""
    assert len(PAGES[0].read_text().split()) <= 1200
    assert sum(len(page.read_text().split()) for page in PAGES) <= 30_000
    assert len((ROOT / "CHANGELOG.rst").read_text().partition("\n0.1.0 (")[0].splitlines()) <= 66


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_have_the_options_that_a_page_shows(page):
    """Also those that take too long to run, or need a robot."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    for line in (line for block in blocks for line in block.splitlines() if line.startswith("tam ")):
        command, words = main, shlex.split(line, comments=True)[1:]
        while isinstance(command, click.Group):
            command = command.get_command(click.Context(command), words.pop(0))
            assert command is not None, line
        known = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if re.fullmatch(r"--?[a-z-]+", word, re.IGNORECASE)} <= known, line
