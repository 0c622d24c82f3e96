"""A comparison as rows of text and sentences, for the page and the terminal."""

import math
from collections.abc import Iterator
from itertools import islice

from tam_calibration.comparison import result
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.units import for_people, to_nanotesla
from tam_calibration.report.blocks import Block, Table, Text, join, number, sentence, with_error
from tam_calibration.report.gap_rows import closed_words, law_sentence, number_rows, percent, size_rows, valued

VERDICTS = {"same": "The same", "differs": "Different", "not_identifiable": "Cannot be told"}


def headline(comparison: result.Comparison) -> str:
    """Return the verdict by name in front of its sentence, once."""
    name = VERDICTS[comparison.verdict]
    return comparison.statement if comparison.statement.startswith(name) else f"{name}: {comparison.statement}"


def mistake_words(mistake: result.Mistake) -> str:
    """Return a gross mistake of the simulator, where it is, and what mends it."""
    return f"{sentence(mistake.what)} Where: {mistake.where}. Mend: {sentence(mistake.mend)}"


def mistake_blocks(comparison: result.Comparison) -> list[Block]:
    """Return the simulator's gross mistakes, and remarks on the two recordings."""
    sentences = (*(mistake_words(mistake) for mistake in comparison.mistakes), *comparison.remarks)
    return [Text(words, "doubt") for words in sentences]


def answer(comparison: result.Comparison) -> str:
    """Return the verdict, and the first difference where the verdict does not name it already."""
    verdict, first = headline(comparison), next(_difference_sentences(comparison), "")
    if comparison.mistakes:
        return f"{VERDICTS[comparison.verdict]}: {first}"
    return verdict if first.rstrip(".") in verdict else f"{verdict} {first}"


def summary_blocks(comparison: result.Comparison) -> list[Block]:
    """Return the differences behind the first, and remarks on the two recordings, a line each."""
    further = islice(_difference_sentences(comparison), 1, None)
    remarks = (Text(remark, "doubt") for remark in comparison.remarks)
    return [*law_blocks(comparison), *(Text(words) for words in further), *remarks]


def law_blocks(comparison: result.Comparison) -> list[Block]:
    """Return the laws that one of the two has and the other lacks, whatever causes them."""
    return [
        Text(f"Only the {name}: {law_sentence(law, side.gap, is_caused=True)}")
        for name, laws in comparison.laws_of_one.items()
        for side in [getattr(comparison, name)]
        for law in laws
    ]


def difference_blocks(comparison: result.Comparison) -> list[Block]:
    """Return the effects that one side lacks or has otherwise, with parameters; empty where there are none."""
    laws = law_blocks(comparison)
    rows = [
        (effect_name(each.effect), *words, _where(each, comparison), percent(each.probability), number(each.size))
        for each, words, _ in _differing(comparison)
    ]
    if not rows:
        return laws
    header = ("effect", "simulation", "recording", "where", "probability", "size (noise floors)")
    return [*laws, Table(header, rows, numeric=False), *_parameter_tables(comparison)]


def noise_blocks(comparison: result.Comparison) -> list[Block]:
    """Return in how many axes the noise differs, and that of each axis; empty where nothing was compared."""
    if not comparison.noise:
        return []
    others, axes = sum(each.differs for each in comparison.noise), len(comparison.noise)
    words = f"The noise of {others} of {axes} axes differs." if others else f"The noise of all {axes} axes is the same."
    header = ("noise of", "simulation (nT)", "recording (nT)", "colour: simulation", "colour: recording", "")
    rows = []
    for each in comparison.noise:
        sides = each.simulation, each.recording
        levels = (with_error(to_nanotesla(side.level_T), to_nanotesla(side.level_error_T), 3) for side in sides)
        standing = "differs" if each.differs else "the same"
        rows.append([axis_name(each.recording), *levels, *map(_colour, sides), standing])
    return [Text(words), Table(header, rows, "Standard deviation ± standard error", numeric=False)]


def closing_blocks(comparison: result.Comparison) -> list[Block]:
    """Return how far the mend closes the gap, and what stays open; empty where there is no gap."""
    closing = comparison.closing
    if closing is None or comparison.verdict == "same":
        return []
    header = ("gap to the recording, out of sample", "before", "after the mend")
    blocks: list[Block] = [
        Text("Each term was added to a twin of the simulation's run, or taken from it, and judged out of sample."),
        Table(header, _closing_rows(closing)),
    ]
    if words := closed_words(closing):
        blocks.append(Text(sentence(words)))
    if closing.steps:
        steps = [[step.added.replace("_", " "), number(step.left)] for step in closing.steps]
        blocks.append(Table(("each further term of the mend", "gap after it (noise floors)"), steps))
    if rows := _source_rows(closing):
        header = ("error of a source that is put in", "median (m)", "95 % interval (m)")
        blocks.append(Table(header, rows, "The same source put into each, located by tam locate"))
    if closing.left:
        blocks.append(Text(f"What stays open: {sentence(closing.left)}", "doubt"))
    return blocks


_Differing = tuple[result.EffectDifference, tuple[str, str], tuple[result.EffectDifference | None, ...]]
"""An effect, and what simulation and recording have of it: in words, and with parameters."""


def _differing(comparison: result.Comparison) -> list[_Differing]:
    """Return each effect that one side lacks or has otherwise."""
    others = comparison.other_parameters
    return [
        *((each, (_lacking(each), "has it"), (None, each)) for each in comparison.missing),
        *((each, ("has it", _lacking(each)), (each, None)) for each in comparison.surplus),
        *((each.recording, ("has it otherwise", "has it"), (each.simulation, each.recording)) for each in others),
    ]


def _difference_sentences(comparison: result.Comparison) -> Iterator[str]:
    """Yield a sentence on each difference, the gravest kind first and the largest of a kind first."""
    yield from (mistake_words(mistake) for mistake in comparison.mistakes)
    begins = {"has it": "Only the simulation has {}.", "has it otherwise": "The parameters of {} are others."}
    told = [(begins.get(words[0], "The simulation lacks {}."), each) for each, words, _ in _differing(comparison)]
    for words, each in sorted(told, key=lambda one: ("parameters" in one[0], -one[1].size)):
        yield words.format(f"{effect_name(each.effect)} ({_where(each, comparison)})")
    for noise in comparison.noise:
        if noise.differs:
            levels = [f"{number(to_nanotesla(side.level_T))} nT" for side in (noise.simulation, noise.recording)]
            yield f"The noise of {axis_name(noise.recording)} is {levels[0]} in the simulation, {levels[1]} recorded."


def _where(each: result.EffectDifference, comparison: result.Comparison) -> str:
    sensor_count = 0 if comparison.recording is None else comparison.recording.array.sensor_count
    return sensors_in_words(each.sensors, sensor_count, each.axes)


def next_words(comparison: result.Comparison) -> str:
    """Return what to do next, in one sentence or two."""
    if comparison.mistakes:
        return "Mend that in the simulator, record the simulation again, and compare again: nothing else was compared."
    if comparison.verdict == "same":
        return "Nothing is to be mended."
    if comparison.verdict == "not_identifiable":
        wanted = "" if comparison.recording is None else comparison.recording.gap.next_recording
        return sentence(wanted or "record longer, and turn the array through more directions; then compare again")
    assert comparison.mend is not None
    removed = join([effect_name(name) for name in dict.fromkeys(comparison.mend.removed)])
    again = "record the simulation again, and compare again"
    if comparison.mend.added or any(one.differs for one in comparison.noise):
        begin = f"Take {removed} out of the simulator. " if removed else ""
        return (
            f"{begin}Write the mend into the simulator, {again}. The elements for Gazebo and MuJoCo and a function for "
            "plugins are on the page (--report) and in the JSON (--json); --mend writes the parameter file for "
            "tam simulate --from-comparison."
        )
    if removed:
        return f"Take {removed} out of the simulator, {again}."
    return "What differs is no effect of the library, and nothing can be written into the simulator: see where it is."


def effect_name(name: str) -> str:
    """Return the name of an effect for people."""
    return "an unknown effect" if name == result.UNKNOWN else name.replace("_", " ")


def axis_name(noise: AxisNoise) -> str:
    """Return "sensor 2 x" or "the scalar"."""
    return f"sensor {noise.sensor} {noise.axis}" if noise.sensor else "the scalar"


def _lacking(difference: result.EffectDifference) -> str:
    return "lacks it" if difference.is_shown_by_other_run else "could not show it"


def _parameter_tables(comparison: result.Comparison) -> list[Table]:
    """Return a table of the parameters of each difference that has some."""
    header = ("parameter", "simulation", "recording", "unit")
    tables = []
    for each, _, sides in _differing(comparison):
        theirs, own = map(_parameters, sides)
        rows = [[key[0], theirs.get(key, "–"), own.get(key, "–"), key[1]] for key in own | theirs]
        if rows:
            caption = sentence(f"{effect_name(each.effect)} of {_where(each, comparison)}")[:-1]
            tables.append(Table(header, rows, caption))
    return tables


def _parameters(difference: result.EffectDifference | None) -> dict[tuple[str, str], str]:
    """Return value ± standard error of each parameter by its name and unit."""
    if difference is None or difference.fitted is None:
        return {}
    return {(name, unit): value for name, value, unit in number_rows(difference.fitted, difference.units)}


def _colour(noise: AxisNoise) -> str:
    """Return the colour, with the knee or the band."""
    if noise.colour == "1/f" and math.isfinite(noise.knee_hz):
        return f"1/f below {number(noise.knee_hz, 2)} Hz"
    if noise.colour == "band" and noise.band_hz is not None:
        return f"band {number(noise.band_hz[0], 2)} to {number(noise.band_hz[1], 2)} Hz"
    return noise.colour


def _closing_rows(closing: result.Closing) -> list[list[str]]:
    """Return the gap before and after the mend in noise floors, nT, nT/m and metres."""
    before_m, after_m = closing.source_error_before_m, closing.source_error_after_m
    foretold = ["source error foretold wrongly by (m)", number(before_m), number(after_m)]
    return [*size_rows(closing), *([foretold] if math.isfinite(before_m) else [])]


def _source_rows(closing: result.Closing) -> list[list[str]]:
    """Return how far from a source ``tam locate`` ends in the recording, simulation and mended twin."""
    errors = {
        "simulation": closing.simulation_source,
        "mended simulation": closing.mended_source,
        "recording": closing.recording_source,
    }
    return [
        [name, number(error.median_m), f"{number(error.interval_m[0])} to {number(error.interval_m[1])}"]
        for name, error in errors.items()
        if error is not None
    ]


def figure_tables(comparison: result.Comparison) -> list[Table]:
    """Return a table of each group of figures, in units of files."""
    groups: dict[str, list[list[str]]] = {}
    for figure in comparison.figures:
        sides, name = (figure.simulation, figure.recording), figure.recording.name
        factor, unit = for_people(figure.recording.unit)
        values = (valued(factor * side.value, factor * side.standard_error) for side in sides)
        row = [name, *values, "" if unit == "1" else unit, number(figure.standard_errors, 2), figure.standing]
        groups.setdefault(figure.recording.group, []).append(row)
    header = ("figure", "simulation", "recording", "unit", "standard errors apart", "")
    return [Table(header, rows, sentence(group)[:-1]) for group, rows in groups.items()]
