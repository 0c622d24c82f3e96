"""What the calibrator does on ~/compare: it compares the stored samples with a simulator's, and writes results."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tam_calibration.comparison import compare
from tam_calibration.comparison.result import Comparison
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.libraries import require
from tam_calibration.model.recording import SampleSource
from tam_calibration.nodes.base import TamNode
from tam_calibration.nodes.node_parameters import Rule
from tam_calibration.recordings import provenance
from tam_calibration.recordings.fit_input import read_array_of, read_compared
from tam_calibration.report.comparison_rows import answer
from tam_calibration.results.comparison_json import Sources, write_comparison, write_mend

COMPARED = (
    Rule("simulation", "", "Recording of a simulator, bag or CSV, with which ~/compare compares.", read_only=False),
    Rule("simulation_array_file", "", "Array YAML of the simulation; empty for that of array_file.", read_only=False),
    Rule("comparison_file", "", "Comparison JSON: written by ~/compare where a file is named.", read_only=False),
    Rule("comparison_report_file", "", "HTML page: written by ~/compare where a file is named.", read_only=False),
    Rule("mend_file", "", "YAML of what the simulation lacks: written by ~/compare where named.", read_only=False),
)

WRITTEN_OF_COMPARISON = ("comparison_file", "comparison_report_file", "mend_file")
"""Parameters that name a file which ~/compare writes."""


def require_comparable(node: TamNode) -> None:
    """Check that a node names a simulation, and that what it shall write of the comparison can be made.

    Raises
    ------
    InputError
        When what makes pages is not installed.
    Refused
        When no simulation is named.
    """
    if not node.value("simulation"):
        raise Refused(f"no simulation is named: set the parameter simulation of {node.get_name()} to a bag or CSV file")
    if node.value("comparison_report_file"):
        require("report", "comparison_report_file")


def compare_with_simulation(
    node: TamNode,
    samples: SampleSource,
    remarks: tuple[str, ...],
    array: Array,
    progress: Callable[[str, float], None],
) -> str:
    """Compare stored samples with the simulation that a node names, and write what it names.

    Parameters
    ----------
    node : TamNode
        With the parameters of ``COMPARED``.
    samples : SampleSource
        That were collected.
    remarks : tuple of str
        On how they were joined.
    array : Array
        Of them.
    progress : callable
        Called with the stage and the part that is done.

    Returns
    -------
    str
        Verdict, first difference and what was written, on one line.

    Raises
    ------
    InputError
        When the simulation cannot be used, or a file cannot be written.
    Refused
        When more than half of the simulation's samples cannot be used.
    """
    path, array_path = Path(node.value("simulation")), node.value("simulation_array_file")
    simulated = read_array_of("simulation", Path(array_path), path) if array_path else array
    simulation, simulated_remarks = read_compared("simulation", path, simulated)
    comparison = compare(simulation, samples, array, array_of_simulation=simulated, progress=progress)
    comparison = replace(comparison, remarks=(*simulated_remarks, *remarks, *comparison.remarks))
    return answer(comparison) + _write(node, comparison, Sources(provenance(path)))


def _write(node: TamNode, comparison: Comparison, sources: Sources) -> str:
    def write_page(path: Path) -> None:
        from tam_calibration.report.comparison_report import write_comparison_report

        write_comparison_report(path, comparison, sources)

    mend = comparison.mend
    return node.write_files(
        comparison_file=lambda path: write_comparison(path, comparison, sources),
        comparison_report_file=write_page,
        **({} if mend is None else {"mend_file": lambda path: write_mend(path, mend)}),
    )
