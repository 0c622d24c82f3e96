"""A sample of new random cases each time: none may be bad; and the battery itself sees what is bad."""

import os
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from battery.cases import CASES, FAMILIES, prepare
from battery.judge import Answer, Bad, judge
from battery.recipes import RECIPES
from battery.surroundings import PLAIN, Ended
from battery.trial import May, Trial
from tam_calibration.cli.main import subcommands

ROOT = Path(__file__).parents[2]

SAMPLE = 10
"""Cases that take a quarter of a minute of one core, with the good inputs, which are made once."""


def test_no_case_of_a_new_sample_is_bad():
    """The seed stands in the output, with what tries each bad case again."""
    command = [sys.executable, "-m", "battery", "--sample", str(SAMPLE), "--jobs", "1"]
    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'test'}:{ROOT}", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(f"^{SAMPLE} cases of seed", done.stdout, re.MULTILINE)


def test_every_command_is_tried_and_killed():
    """A thousand bad inputs and more over all commands, and a hundred kills of each that writes."""
    tried = Counter(RECIPES[name].command for family, name in CASES if family != "kills")
    assert set(tried) == set(subcommands()) and tried.total() >= 1000
    kills = Counter(
        RECIPES[name].command for name in FAMILIES["kills"].counts for _ in range(FAMILIES["kills"].counts[name])
    )
    assert set(kills) == {recipe.command for recipe in RECIPES.values() if recipe.writes}
    assert all(count >= 100 for count in kills.values())


@pytest.mark.parametrize("family", ["csv", "yaml", "bytes", "arguments"])
def test_a_case_is_told_by_its_number_and_seed(tmp_path, family):
    """The same again for the same seed, another for another."""
    number = next(n for n, case in enumerate(CASES) if case[0] == family)
    material = tmp_path / "material"
    material.mkdir()
    for name in RECIPES[CASES[number][1]].reads:
        (material / name).write_text("a: 1\nb: [2, 3]\nc: {d: 4, e: 5}\n" if ".yaml" in name else _table())
    spoiled = []
    for place, seed in enumerate((1, 1, 2)):
        trial = prepare(number, seed, material, folder := tmp_path / str(place))
        spoiled.append((trial, {path.name: path.read_bytes() for path in folder.iterdir()}))
    assert spoiled[0] == spoiled[1] != spoiled[2]


def _table():
    header = ",".join(["time_s", *(f"b{k}{axis}_nT" for k in range(1, 5) for axis in "xyz")])
    return "\n".join([header, *(",".join([str(row)] * 13) for row in range(50))]) + "\n"


GOOD = Ended(0, False, "done 1.5\n", "", 1.0, 1 << 27)
REFUSED = replace(GOOD, code=2, stdout="", stderr="tam: run.csv: line 3 is not a number\n")
TRIAL = Trial.of(RECIPES["calibrate run.csv"], "", May.REFUSE)
OURS, OTHERS = (Answer(np.array([value]), "") for value in (1.5, 1.6))


@pytest.mark.parametrize(
    ("bad", "ended", "may", "after"),
    [
        (None, GOOD, May.DO_THE_SAME, {"new.yaml": "1"}),
        (None, REFUSED, May.REFUSE, {}),
        (None, replace(REFUSED, stderr="Usage: tam [OPTIONS]\n\nError: No such option: -q\n"), May.REFUSE, {}),
        (Bad.TRACEBACK, replace(REFUSED, code=1, stderr="Traceback (most recent call last):\n"), May.REFUSE, {}),
        (Bad.TRACEBACK, replace(REFUSED, code=139, died=True), May.REFUSE, {}),
        (Bad.ACCEPTED, GOOD, May.REFUSE, {}),
        (Bad.ACCEPTED, GOOD, May.WARN, {}),
        (Bad.LEFT, REFUSED, May.REFUSE, {"new.yaml": "1"}),
        (Bad.LEFT, GOOD, May.DO_ANYTHING, {".new.yaml.x": "1"}),
        (Bad.LEFT, GOOD, May.DO_ANYTHING, {"run.csv": "other"}),
        (Bad.LEFT, replace(REFUSED, left_running=("python",)), May.REFUSE, {}),
        (Bad.HUNG, replace(REFUSED, code=137, died=True, is_hung=True), May.REFUSE, {}),
        (Bad.MEMORY, replace(REFUSED, memory_bytes=2 << 30), May.REFUSE, {}),
        (Bad.MEMORY, replace(REFUSED, stderr="tam: Unable to allocate 30 GiB\n"), May.REFUSE, {}),
        (Bad.CODE, replace(REFUSED, code=70), May.REFUSE, {}),
        (Bad.NOISE, replace(REFUSED, stderr=""), May.REFUSE, {}),
        (Bad.NOISE, replace(REFUSED, stderr="tam: \n"), May.REFUSE, {}),
        (Bad.NOISE, replace(REFUSED, stderr="tam: one sentence\ntam: and another\n"), May.REFUSE, {}),
        (Bad.NOISE, replace(REFUSED, stderr="tam: '>' not supported between str and int\n"), May.REFUSE, {}),
        (Bad.NOISE, replace(GOOD, stderr="x.py:3: RuntimeWarning: overflow\n"), May.DO_ANYTHING, {}),
    ],
)
def test_what_is_bad_is_seen(bad, ended, may, after):
    """Each class by a run of which it is true, and none where all is well."""
    before = {"run.csv": "digest"}
    found = judge(replace(TRIAL, may=may), ended, before, before | after, OURS, OURS)
    assert list(found) == ([] if bad is None else [bad])


def test_other_numbers_need_a_word():
    """Numbers of a damaged input that are others are bad, unless it is said that something is damaged."""
    trial = replace(TRIAL, may=May.DO_THE_SAME)
    assert list(judge(trial, GOOD, {}, {}, OTHERS, OURS)) == [Bad.NUMBERS]
    told = replace(OTHERS, text="run.mcap is unfinished: 30 messages were recovered\n")
    assert judge(trial, GOOD, {}, {}, told, OURS) == {}


def test_a_signal_is_told_by_the_exit_code():
    """130 and 143 are those of a command that was ended; 1 is that of a refusal."""
    import signal

    for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
        trial = replace(TRIAL, may=May.DO_THE_SAME, around=replace(PLAIN, ended_by=number))
        assert judge(trial, replace(REFUSED, code=code, stderr=""), {}, {}, OURS, OURS) == {}
        assert list(judge(trial, replace(REFUSED, code=1, stderr="tam: it ended\n"), {}, {}, OURS, OURS)) == [Bad.CODE]
