"""The verdict in one sentence, its reasons, and the figures behind it."""

from tam_calibration.report.evidence import Evidence
from tam_calibration.report.formatting import number, ratio
from tam_calibration.report.page import Block, Points, Section, Text
from tam_calibration.report.verdict import best_evidence, judge
from tam_calibration.units import to_nanotesla


def build(evidence: Evidence) -> Section:
    """Return the section."""
    verdict = judge(evidence.calibration, evidence.coverage)
    blocks: list[Block] = [Text(verdict.sentence, "doubt" if verdict.doubts else "good"), Text(_figures(evidence))]
    if verdict.doubts:
        blocks.append(Points([doubt.detail for doubt in verdict.doubts]))
    if verdict.limits:
        blocks += [Text("What limits this verdict:"), Points(verdict.limits)]
    return Section("Verdict", blocks)


def _figures(evidence: Evidence) -> str:
    calibration = evidence.calibration
    residuals = best_evidence(calibration)
    worst = int((residuals.sensor_intensity_T / calibration.floor.sensor_intensity_T).argmax())
    states = (calibration.before, residuals, calibration.floor)
    before, after, floor = (to_nanotesla(float(state.sensor_intensity_T[worst])) for state in states)
    sensor = f"sensor {worst + 1}, the worst," if calibration.errors.sensor_count > 1 else "the sensor"
    samples = "samples that the fit did not see" if calibration.held_out else "the samples that were fitted"
    return (
        f"|B| of {sensor} differs from {evidence.reference_name} by {number(before)} nT before and {number(after)} nT "
        f"after, {ratio(after / floor)} × the noise floor. The field visited {100 * evidence.coverage.fraction:.0f} % "
        f"of the sphere of directions. Figures after calibration are root mean squares over {samples}."
    )
