"""The good inputs, made by the commands themselves in one folder, which each case gets a copy of."""

import shutil
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import yaml
import zstandard
from foreign.bags import BAGS
from foreign.logs import LOGS
from foreign.texts import TEXTS
from scipy.spatial.transform import Rotation

from battery.recipes import FOREIGN
from tam_calibration.cli.main import main
from tam_calibration.files.text_files import configuration_folder
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results import read_calibration, write_recording
from tam_calibration.sources.dipole import Dipole, Loop, area_of

_SAMPLES = 400


def _tam(*line: str) -> None:
    said = StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = main.main(list(line), prog_name="tam", standalone_mode=False)
    if code:
        raise RuntimeError(f"tam {' '.join(line)}: {said.getvalue()}")


def make(folder: Path) -> None:
    """Make what the lines of `recipes` read.

    Parameters
    ----------
    folder : Path
        That is there and empty.
    """
    scenario = yaml.safe_load((configuration_folder() / "scenarios" / "warming_up.yaml").read_text())
    del scenario["effects"]
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario | {"samples": _SAMPLES}, sort_keys=False))
    for name in ("run.csv", "run.mcap"):
        _tam("simulate", str(folder / "scenario.yaml"), "-o", str(folder / name))
    for storage in ("mcap", "sqlite3"):
        write_recording(folder / f"run_{storage}", read_recording(folder / "run.mcap"), storage)
    _tam("simulate", str(folder / "scenario.yaml"), "-o", str(folder / "simulator.csv"), "--seed", "9")
    turned = scenario | {"samples": _SAMPLES, "attitude": {"noise_deg": 0.0}}
    (folder / "turned.yaml").write_text(yaml.safe_dump(turned, sort_keys=False))
    _tam("simulate", str(folder / "turned.yaml"), "-o", str(folder / "turned.csv"))
    bare = replace(read_recording(folder / "run.csv"), scalar_T=None, temperature_C=None)
    write_recording(folder / "bare.csv", bare)
    (folder / "run.array.yaml").rename(folder / "array.yaml")
    for path in (*folder.glob("*.array.yaml"), *folder.glob("*.truth.yaml"), folder / "turned.yaml"):
        path.unlink()
    _tam(
        *("calibrate", str(folder / "run.csv"), "--array", str(folder / "array.yaml")),
        *("-o", str(folder / "calibration.yaml")),
    )
    _pack(folder / "run_sqlite3", folder / "run_zstd")
    _write_pass(folder)
    _write_coil(folder)
    for foreign in (each for each in (*BAGS, *LOGS, *TEXTS) if each.file in FOREIGN):
        foreign.make(folder / foreign.file, foreign.truth)
        (folder / f"{foreign.file}.yaml").write_text(foreign.array)
    shutil.copy(configuration_folder() / "tam.yaml", folder / "parameters.yaml")
    missions = folder / "missions" / "auv"
    missions.mkdir(parents=True)
    shutil.copy(folder / "run.csv", missions)
    (missions / "damaged.mcap").write_bytes((folder / "run.mcap").read_bytes()[:999])
    shutil.copy(folder / "run.mcap", folder / "cut.mcap")
    _make_blind(folder)


def _pack(bag: Path, packed: Path) -> None:
    """Write a bag anew, its file compressed."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

    writer = Writer(packed, version=8, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with Reader(bag) as reader, writer:
        connections = {}
        for each in reader.connections:
            connections[each.id] = writer.add_connection(
                each.topic, each.msgtype, msgdef=each.msgdef.data, rihs01=each.digest
            )
        for connection, time_ns, message in reader.messages():
            writer.write(connections[connection.id], time_ns, message)
    [path] = packed.glob("*.zstd")  # anew, with a checksum, without which nobody could tell what was damaged
    content = zstandard.ZstdDecompressor().decompress(path.read_bytes(), max_output_size=1 << 26)
    path.write_bytes(zstandard.ZstdCompressor(write_checksum=True).compress(content))


def _write_pass(folder: Path) -> None:
    """Write the recording of a platform that passes a dipole."""
    time = np.arange(_SAMPLES) / 20
    turns = Rotation.from_euler("zyx", np.stack([0.6 * np.sin(time / 3), 0.1 * np.sin(time), 0.2 * np.cos(time)], 1))
    array, matrix = read_array(folder / "array.yaml"), turns.as_matrix()
    places = np.outer(time, [1.5, 0, 0])[:, None] + np.einsum("nij,kj->nki", matrix, array.positions_m)
    world = np.array([1e-6, 21e-6, -43e-6]) + Dipole(np.array([15.0, 2.5, -2.3]), np.array([40.0, -60, 150])).field_T(
        places
    )
    fields = np.einsum("nji,nkj->nki", matrix, world) + 1e-9 * np.random.default_rng(30).normal(size=(_SAMPLES, 4, 3))
    readings = read_calibration(folder / "calibration.yaml").errors.distort(fields)
    write_recording(folder / "pass.csv", Recording(1.7e9 + time, readings, attitude=turns.as_quat()))


_COIL = {
    "recording": "coil.csv",
    "position_m": [2.4, -1.0, 0.46],
    "axis": [0.0, 0.6, 0.8],
    "ampere_turns": 708,
    "radius_m": 0.445,
    "frequency_Hz": 10,
}


def _write_coil(folder: Path) -> None:
    """Write the recording of an array that is turned beside a coil with an alternating current."""
    array, errors = read_array(folder / "array.yaml"), read_calibration(folder / "calibration.yaml").errors
    center, axis, radius = (np.array(_COIL[key]) for key in ("position_m", "axis", "radius_m"))
    loop = Loop(center, _COIL["ampere_turns"] * area_of(float(radius)) * axis, float(radius))
    turns = Rotation.from_euler("z", np.arange(12)[:, None] * np.pi / 6)
    fields = np.array([turn.inv().apply(loop.field_T(turn.apply(array.positions_m))) for turn in turns])
    time, pose = np.arange(12 * 150) / 100, np.repeat(np.arange(12), 150)
    carrier = np.sin(2 * np.pi * 10 * time)[:, None, None]
    earth = turns.inv().apply([1e-6, 21e-6, -43e-6])[:, None]
    noise = 1e-9 * np.random.default_rng(31).normal(size=(len(time), 4, 3))
    readings = errors.distort(earth[pose] + carrier * fields[pose]) + noise
    write_recording(folder / "coil.csv", Recording(time, readings, attitude=turns.as_quat()[pose]))
    (folder / "coil.yaml").write_text(yaml.safe_dump(_COIL))


def _make_blind(folder: Path) -> None:
    """Make one case of the check on withheld effects, answered."""
    from tam_validation.blind.case import make_case
    from tam_validation.blind.case_plan import plan_cases
    from tam_validation.blind.folder import COMMITMENTS, KEYS, case_name, seal, write_case, write_json

    case, name = make_case(plan_cases(("single",), 1, 5)[0], 5, 1), case_name(1)
    (folder / "cases").mkdir()
    write_case(folder / "cases" / name, case)
    key, commitment = seal(case.key)
    write_json(folder / "cases" / KEYS, {name: key})
    write_json(folder / "cases" / COMMITMENTS, {name: commitment})
    write_json(folder / "cases" / name / "answer.json", {"verdict": "error", "why": "not tried"})
