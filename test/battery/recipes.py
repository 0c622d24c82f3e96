"""The command lines that the battery spoils: of each what it reads and what it writes, in the folder of `material`."""

from dataclasses import dataclass

from tam_calibration.cli.main import subcommands
from tam_calibration.fit import METHODS

_ARRAY = ("--array", "array.yaml")
_CALIBRATION = ("--calibration", "calibration.yaml")


@dataclass(frozen=True)
class Recipe:
    """A command line that works.

    Parameters
    ----------
    name : str
        Tells lines of one command apart.
    line : tuple of str
        The words after ``tam``.
    reads : tuple of str
        Those of its words that name what is read.
    writes : tuple of str
        What is there when it has ended well.
    tells_after_writing : bool
        Whether it may print, or write outputs that hold, before it ends with a sentence and exit 1.
    ends : bool
        Whether it ends by itself; another is ended after some seconds, and that it runs until then is no fault.
    needs_nodes : bool
        Whether it refuses where no nodes run, as nowhere here.
    in_steps : bool
        Whether what is done stays when it is ended: each file whole, but not all of them.
    repeats : bool
        Whether its answer is the same each time, as what processes tell each other, and sealed keys, are not.
    """

    name: str
    line: tuple[str, ...]
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    tells_after_writing: bool = False
    ends: bool = True
    needs_nodes: bool = False
    in_steps: bool = False
    repeats: bool = True

    @property
    def command(self) -> str:
        """The first word, by which results are summed up."""
        return self.line[0]


BAGS = ("run.mcap", "run_sqlite3", "run_mcap", "run_zstd")


def _calibrate(recording: str) -> Recipe:
    line = ("calibrate", recording, *_ARRAY, "-o", "new.yaml", "--json", "new.json")
    return Recipe(f"calibrate {recording}", line, (recording, "array.yaml"), ("new.yaml", "new.json"))


def _correct(recording: str, output: str = "new.csv") -> Recipe:
    line = ("correct", recording, *_CALIBRATION, "-o", output)
    return Recipe(f"correct {recording} {output}", line, (recording, "calibration.yaml"), (output,))


def _calibrate_otherwise(name: str, recording: str, *words: str) -> Recipe:
    line = ("calibrate", recording, *_ARRAY, *words, "-o", "new.yaml")
    return Recipe(f"calibrate {name}", line, (recording, "array.yaml"), ("new.yaml",))


OTHERWISE = (
    *(_calibrate_otherwise(f"by {method}", "run.csv", "--method", method) for method in list(METHODS)[1:]),
    _calibrate_otherwise("with effects", "run.csv", "--effects", "temperature_drift,bias_jump"),
    _calibrate_otherwise("with attitude", "turned.csv", "--attitude-noise-deg", "estimate"),
    _calibrate_otherwise("with delays", "run.mcap", "--estimate-delays", "--tolerance-s", "0.001"),
    _calibrate_otherwise("at a place", "bare.csv", "--place", "48,11,2025-01-01"),
)
"""Other ways to calibrate than the usual one."""

FOREIGN = ("flight.ulg", "00000042.BIN", "ros1.bag", "european.csv", "laboratory.parquet")
"""Recordings of strangers, one for each reader (`foreign`)."""


def _inspect(recording: str, *words: str) -> Recipe:
    line = ("inspect", recording, *words, "--json", "new.json", "--write-map", "new.yaml")
    return Recipe(f"inspect {recording}", line, (recording,), ("new.json", "new.yaml"))


def _calibrate_foreign(recording: str) -> Recipe:
    line = ("calibrate", recording, "--array", f"{recording}.yaml", "-o", "new.yaml")
    return Recipe(f"calibrate {recording}", line, (recording,), ("new.yaml",))


_FOREIGN = (
    _inspect("run.csv"),
    _inspect("run_sqlite3"),
    *(_inspect(each, "--array", f"{each}.yaml") for each in FOREIGN),
    *(_calibrate_foreign(each) for each in FOREIGN[:-1]),
)

_INJECT = ("blind", "inject", "run.csv", *_ARRAY, "--effect", "bias_jump", "-o", "new.csv")

_RECIPES = (
    Recipe(
        "simulate",
        ("simulate", "scenario.yaml", "-o", "new.csv"),
        ("scenario.yaml",),
        ("new.csv", "new.array.yaml", "new.truth.yaml"),
    ),
    Recipe(
        "simulate a bag",
        ("simulate", "scenario.yaml", "-o", "new.mcap", "--seed", "3"),
        ("scenario.yaml",),
        ("new.mcap", "new.array.yaml", "new.truth.yaml"),
    ),
    Recipe(
        "simulate a twin",
        ("simulate", "--from-calibration", "calibration.yaml", "--recording", "run.csv", "-o", "new.csv"),
        ("calibration.yaml", "run.csv"),
        ("new.csv", "new.array.yaml"),
    ),
    _calibrate("run.csv"),
    *(_calibrate(bag) for bag in BAGS),
    Recipe(
        "calibrate with a page",
        ("calibrate", "run.csv", *_ARRAY, "-o", "new.yaml", "--report", "new.html"),
        ("run.csv", "array.yaml"),
        ("new.yaml", "new.html"),
    ),
    Recipe(
        "calibrate with a source",
        ("calibrate", "run.csv", *_ARRAY, "--source", "coil.yaml", "-o", "new.yaml"),
        ("run.csv", "array.yaml", "coil.yaml"),
        ("new.yaml",),
    ),
    *OTHERWISE,
    *_FOREIGN,
    Recipe(
        "locate at once",
        ("locate", "pass.csv", *_CALIBRATION, "--attitude-noise-deg", "0.01"),
        ("pass.csv", "calibration.yaml"),
    ),
    Recipe(
        "locate a coil",
        ("locate", "coil.csv", *_CALIBRATION, "--frequency", "10", "--json"),
        ("coil.csv", "calibration.yaml"),
    ),
    Recipe(
        "diagnose",
        ("diagnose", "run.csv", *_ARRAY, "--json", "new.json"),
        ("run.csv", "array.yaml"),
        ("new.json",),
    ),
    Recipe(
        "diagnose a bag",
        ("diagnose", "run.mcap", *_ARRAY, *_CALIBRATION, "--json", "new.json"),
        ("run.mcap", "array.yaml", "calibration.yaml"),
        ("new.json",),
    ),
    Recipe(
        "compare",
        ("compare", "simulator.csv", "run.mcap", *_ARRAY, "--json", "new.json", "--mend", "new.yaml"),
        ("simulator.csv", "run.mcap", "array.yaml"),
        ("new.json", "new.yaml"),
    ),
    Recipe(
        "plan",
        ("plan", *_ARRAY, "--turntable", "60", "--place", "47.37,8.54,2025-06-30", "--poses", "9"),
        ("array.yaml",),
    ),
    Recipe(
        "plan after a recording",
        ("plan", "run.csv", *_ARRAY, "--turntable", "90", "--place", "47.37,8.54,2025-06-30", "--poses", "2", "--json"),
        ("run.csv", "array.yaml"),
    ),
    _correct("run.csv"),
    *(_correct(bag) for bag in BAGS),
    _correct("run.mcap", "new.mcap"),
    _correct("run_sqlite3", "new"),
    Recipe(
        "locate",
        ("locate", "pass.csv", *_CALIBRATION, "--velocity", "1.5,0,0", "--json", "--report", "new.html"),
        ("pass.csv", "calibration.yaml"),
        ("new.html",),
    ),
    Recipe(
        "batch",
        ("batch", "missions/*/*", *_ARRAY, "--output", "new", "--jobs", "1"),
        ("array.yaml",),
        ("new",),
        in_steps=True,
    ),
    Recipe("nodes", ("nodes", *_ARRAY, *_CALIBRATION), ("array.yaml", "calibration.yaml"), (), True, False),
    Recipe(
        "nodes with parameters", ("nodes", "--params-file", "parameters.yaml"), ("parameters.yaml",), (), True, False
    ),
    Recipe("play", ("play", "run.mcap", "--rate", "1000"), ("run.mcap",)),
    Recipe("play sqlite3", ("play", "run_sqlite3", "--rate", "1000"), ("run_sqlite3",)),
    Recipe("call", ("call", "calibrator/calibrate"), needs_nodes=True),
    Recipe("demo", ("demo", "--output", "new"), (), ("new",), True, in_steps=True, repeats=False),
    Recipe("blind inject", _INJECT, ("run.csv", "array.yaml"), ("new.csv", "new.key.json")),
    Recipe(
        "blind make",
        ("blind", "make", "new", "--cases", "2", "--seed", "7", "--jobs", "1"),
        (),
        ("new",),
        repeats=False,
    ),
    Recipe("blind score", ("blind", "score", "cases", "--json", "new.json"), ("cases",), ("new.json",)),
    Recipe(
        "reproduce",
        ("reproduce", "chi2017", "--output", "."),
        (),
        ("reproduce_chi2017.csv",),
        tells_after_writing=True,
    ),
    Recipe(
        "export",
        ("export", "calibration.yaml", "--to", "ardupilot", "-o", "new.param"),
        ("calibration.yaml",),
        ("new.param",),
    ),
    Recipe("recover", ("recover", "cut.mcap", "-o", "new.mcap"), ("cut.mcap",), ("new.mcap",)),
)

RECIPES = {recipe.name: recipe for recipe in _RECIPES if recipe.command in subcommands()}
"""By their names, of the commands that there are."""
