"""The command `tam blind`."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from tam_calibration.cli.main import main
from tam_calibration.recordings import read_array, read_recording
from tam_validation.blind.case_plan import CasePlan


def run(*words):
    """Run `tam blind`."""
    return CliRunner().invoke(main, ["blind", *map(str, words)])


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Return a folder of four cases."""
    folder = tmp_path_factory.mktemp("blind") / "cases"
    result = run("make", folder, "--cases", 4, "--seed", 3, "--jobs", 1)
    assert result.exit_code == 0, result.output
    return folder


def answer_all(folder, verdict):
    """Answer each case alike."""
    for case in folder.glob("case_*"):
        (case / "answer.json").write_text(json.dumps({"verdict": verdict, "causes": [], "considered": []}))


def test_cases_are_recordings_of_their_arrays(cases):
    """Every case is read as any recording is, and its folder holds nothing that tells its key."""
    folders = sorted(cases.glob("case_*"))
    assert [folder.name for folder in folders] == [f"case_{number:04d}" for number in range(1, 5)]
    keys = json.loads((cases / "keys.json").read_text())
    for folder in folders:
        recording, array = read_recording(folder / "data.csv"), read_array(folder / "spec.yaml")
        assert {path.name for path in folder.iterdir()} == {"data.csv", "spec.yaml"}
        assert recording.sensor_count == array.sensor_count == keys[folder.name]["sensors"]
        assert recording.sample_count == keys[folder.name]["samples"]


def test_the_same_seed_makes_the_same_files(cases, tmp_path):
    """A set can be made again by anyone, in any number of processes."""
    assert run("make", tmp_path / "again", "--cases", 4, "--seed", 3, "--jobs", 2).exit_code == 0
    for path in cases.glob("case_*/data.csv"):
        assert (tmp_path / "again" / path.parent.name / "data.csv").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("gaps", [(1.0, 1e9), (1e9, 1e9)])
def test_a_case_that_cannot_be_made_is_left_out(tmp_path, monkeypatch, gaps):
    """The others are made, and the command says which one is not, and why; without any there is no folder."""
    plans = [CasePlan("single", ("bias_jump",), (gap,)) for gap in gaps]
    monkeypatch.setattr("tam_validation.blind.case_plan.plan_cases", lambda *_: plans)
    monkeypatch.setattr("tam_validation.blind.case._TRIES", 20)
    monkeypatch.setattr("tam_validation.blind_command._in_processes", lambda _, work, tasks, jobs: map(work, tasks))
    result, folder = run("make", tmp_path / "cases", "--cases", 2, "--seed", 3), tmp_path / "cases"
    reason = "no recording was found in which bias_jump can be seen and told apart"
    if min(gaps) > 1:
        assert result.exit_code == 1 and f"no case can be made: {reason}" in result.stderr and not folder.exists()
    else:
        assert result.exit_code == 0 and f"case_0002 is left out: {reason}" in result.output
        assert [path.name for path in folder.glob("case_*")] == list(json.loads((folder / "keys.json").read_text()))


def test_no_case_is_mixed_with_older_ones(cases):
    """A folder that is not empty is not written to."""
    result = run("make", cases, "--seed", 1)
    assert result.exit_code == 2
    assert "is not empty: name a new folder" in result.stderr


def test_score(cases, tmp_path):
    """The score is printed, and written as JSON."""
    answer_all(cases, "unexplained")
    result = run("score", cases, "--json", tmp_path / "score.json")
    assert result.exit_code == 0, result.output
    assert "first cause right, verdict right" in result.output
    figures = json.loads((tmp_path / "score.json").read_text())["figures"]
    assert {"clean data → no_gap", "among the first three"} <= {figure["name"] for figure in figures}


def test_failures_are_listed(cases):
    """Each case that went wrong is one line with key and answer."""
    answer_all(cases, "unexplained")
    lines = run("score", cases, "--failures").output.splitlines()
    assert lines and all(line.startswith("case_") and "→ unexplained" in line for line in lines)


def test_an_altered_key_is_refused(cases, tmp_path):
    """The scorer does not open keys that were changed after the commitment."""
    answer_all(cases, "unexplained")
    keys = json.loads((cases / "keys.json").read_text())
    keys["case_0001"]["visible_gap"] = 7.0
    (tmp_path / "keys.json").write_text(json.dumps(keys))
    result = run("score", cases, "--keys", tmp_path / "keys.json")
    assert result.exit_code == 1
    assert "the key of case_0001 is not the one that was committed to" in result.stderr


ANSWERS = [
    "[" * 200_000,
    "[]",
    "7",
    '{"verdict": "explained", "causes": 3}',
    '{"verdict": "explained", "causes": [{"probability": 1}]}',
    '{"verdict": "explained", "causes": ["bias_jump"]}',
    '{"verdict": "explained", "causes": [{"effect": "bias_jump", "probability": "much"}]}',
    '{"verdict": "no_gap", "gap": [1]}',
    '{"verdict": "no_gap", "gap": {"before": "x"}}',
    '{"verdict": "no_gap", "probabilities": [1]}',
    '{"verdict": "no_gap", "where": {"sensors": 1}}',
    '{"verdict": "clean"}',
    '{"verdict": "explained", "causes": [{"effect": "nonsense"}]}',
]


@pytest.mark.parametrize("content", ANSWERS, ids=lambda each: each[:60])
def test_what_is_no_answer_is_one_sentence(cases, content):
    """An answer is a file of anybody: broken, of another shape, or nested without end."""
    answer_all(cases, "no_gap")
    path = cases / "case_0001" / "answer.json"
    path.write_text(content)
    result = run("score", cases)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith(f"tam: {path}") and len(result.stderr.splitlines()) == 1


def test_what_is_allowed_is_told(cases):
    """Verdicts and effects that there are not are refused with those that there are."""
    answer_all(cases, "clean")
    assert "verdict: input should be 'no_gap' or 'explained'" in run("score", cases).stderr
    answer_all(cases, "explained")
    (cases / "case_0001" / "answer.json").write_text('{"verdict": "explained", "causes": [{"effect": "nonsense"}]}')
    assert "there is no effect 'nonsense': name ambient_gradient, bias_jump" in run("score", cases).stderr


def test_a_missing_answer_counts_as_wrong(cases, tmp_path):
    """A case that is left out does not make the score better, and the number of them is told."""
    answer_all(cases, "unexplained")
    assert run("score", cases, "--json", tmp_path / "all.json").stderr == ""
    (cases / "case_0002" / "answer.json").unlink()
    result = run("score", cases, "--json", tmp_path / "three.json", "--failures")
    assert "warning: 1 of 4 cases have no answer and count as wrong" in result.stderr
    assert re.search(r"^case_0002 .* → error", result.stdout, re.MULTILINE)
    counts = [
        {(one["name"], one["size"]): one["cases"] for one in json.loads((tmp_path / name).read_text())["figures"]}
        for name in ("all.json", "three.json")
    ]
    assert counts[1].items() >= {key: n for key, n in counts[0].items() if key[0].startswith("first cause")}.items()


@pytest.mark.parametrize("name", ["keys.json", "commitments.json", "answer_times_s.json"])
@pytest.mark.parametrize("content", ["[" * 200_000, "[]", '{"case_0001": "x"}', '{"case_0001": [1]}'])
def test_what_is_no_file_of_a_set_is_one_sentence(cases, tmp_path, name, content):
    """Keys, commitments and times."""
    answer_all(cases, "no_gap")
    for each in ("keys.json", "commitments.json", *(f"case_{number:04d}" for number in range(1, 5))):
        (tmp_path / each).symlink_to(cases / each)
    (tmp_path / name).unlink(missing_ok=True)
    (tmp_path / name).write_text(content)
    result = run("score", tmp_path)
    assert result.exit_code in (1, 2), result.output
    assert result.stderr.startswith("tam: ") and len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("named", [(), ("--effect", "rust")])
def test_an_effect_must_be_named(cases, named):
    """All that there are are told, in one line, where none or another one is named."""
    data, array = cases / "case_0001" / "data.csv", cases / "case_0001" / "spec.yaml"
    result = run("inject", data, "--array", array, *named, "-o", "new.csv")
    assert result.exit_code == 2
    assert result.stderr.startswith("tam: name an effect") and "bias_jump" in result.stderr


def test_without_answers_there_is_no_score(tmp_path):
    """The next step is told."""
    assert run("make", tmp_path / "cases", "--cases", 1, "--seed", 1, "--jobs", 1).exit_code == 0
    result = run("score", tmp_path / "cases")
    assert result.exit_code == 1
    assert "run tam blind answer" in result.stderr


def test_a_folder_without_cases(tmp_path):
    """There must be a case to answer."""
    result = run("answer", tmp_path)
    assert result.exit_code == 2
    assert "holds no case" in result.stderr


def test_answers_are_those_of_diagnose(tmp_path):
    """Each case is diagnosed from its two files alone, exactly as by hand; what cannot be read gives its reason."""
    folder = tmp_path / "cases"
    assert run("make", folder, "--cases", 2, "--seed", 2, "--kinds", "short", "--jobs", 1).exit_code == 0
    (folder / "case_0002" / "data.csv").write_text("time_s\n")
    assert run("answer", folder, "--jobs", 1).exit_code == 0
    case = folder / "case_0001"
    words = ["diagnose", case / "data.csv", "--array", case / "spec.yaml", "--json", tmp_path / "by_hand.json"]
    assert CliRunner().invoke(main, list(map(str, words))).exit_code in (0, 1)
    assert json.loads((case / "answer.json").read_text()) == json.loads((tmp_path / "by_hand.json").read_text())
    spoilt = json.loads((folder / "case_0002" / "answer.json").read_text())
    assert spoilt["verdict"] == "error" and "has a header but no sample" in spoilt["why"]


def test_the_true_effect_can_be_left_out(tmp_path):
    """With the keys opened, single effects are answered once more without the effect that is there."""
    folder = tmp_path / "cases"
    assert run("make", folder, "--cases", 1, "--seed", 2, "--kinds", "single", "--jobs", 1).exit_code == 0
    assert run("answer", folder, "--jobs", 1, "--without-effect").exit_code == 0
    true = json.loads((folder / "keys.json").read_text())["case_0001"]["effects"][0]["effect"]
    answer = json.loads((folder / "case_0001" / "answer_without.json").read_text())
    assert true not in [one["effect"] for one in answer["causes"] + answer["considered"]]


def made_up_recording(path):
    """Write a recording of one sensor that turns through all directions, and its array file; return both."""
    time_s = np.arange(600) / 20
    heading, tilt = 1.7 * time_s, np.arccos(np.cos(0.61 * time_s))
    unit = np.stack([np.cos(heading) * np.sin(tilt), np.sin(heading) * np.sin(tilt), np.cos(tilt)], axis=1)
    noise = np.random.default_rng(1).normal(size=(600, 3))
    table = np.column_stack([time_s, 50000 * unit + 50 * noise])
    np.savetxt(path / "real.csv", table, delimiter=",", header="time_s,b1x_nT,b1y_nT,b1z_nT", comments="")
    (path / "one.yaml").write_text("positions_m: [[0, 0, 0]]\n")
    return path / "real.csv", path / "one.yaml"


def test_inject(tmp_path):
    """The recording with the effect and its channel is a recording; the truth lies beside it; the seed decides."""
    real, array = made_up_recording(tmp_path)
    words = ["inject", real, "--array", array, "--effect", "temperature_drift", "--times", 3]
    result = run(*words, "-o", tmp_path / "new.csv")
    assert result.exit_code == 0, result.output
    made, key = read_recording(tmp_path / "new.csv"), json.loads((tmp_path / "new.key.json").read_text())
    assert made.temperature_C is not None and made.sample_count == 600
    assert key["effect"] == "temperature_drift" and key["recording"] == "real.csv"
    assert key["visible_nT"] == pytest.approx(3 * key["own_residual_nT"], rel=0.02)
    assert run(*words, "-o", tmp_path / "again.csv").exit_code == 0
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "new.csv").read_bytes()


def test_inject_refuses_what_does_not_fit(tmp_path):
    """One sentence for an array of another number of sensors, an output that is no CSV, and an input as output."""
    real, array = made_up_recording(tmp_path)
    (tmp_path / "two.yaml").write_text("positions_m: [[0, 0, 0], [1, 0, 0]]\n")
    words = ["inject", real, "--effect", "bias_jump", "--array"]
    assert "holds 1 sensors, but" in run(*words, tmp_path / "two.yaml", "-o", tmp_path / "new.csv").stderr
    assert "must end in .csv" in run(*words, array, "-o", tmp_path / "new.mcap").stderr
    assert "would be overwritten" in run(*words, array, "-o", real).stderr
    assert {path.name for path in tmp_path.iterdir()} == {"real.csv", "one.yaml", "two.yaml"}
