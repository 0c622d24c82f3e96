"""The course of a law drawn with its error."""

import matplotlib
from matplotlib.figure import Figure

from tam_calibration.gap.laws.law import Course
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report.style import BEFORE_COLOR, PAGE_WIDTH_INCH, STYLE


@matplotlib.rc_context(STYLE)
def plot_course(course: Course) -> Figure:
    """Draw the size of a law over time, and the band of two standard errors on either side."""
    factor, unit = (100.0, "%") if course.unit == "1" else (to_nanotesla(1.0), "nT")
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.2), layout="constrained")
    axes = figure.subplots()
    seconds, size, error = course.time_s - course.time_s[0], factor * course.size, factor * course.error
    axes.fill_between(seconds, size - 2 * error, size + 2 * error, color=BEFORE_COLOR, alpha=0.25, linewidth=0)
    axes.plot(seconds, size, color=BEFORE_COLOR)
    axes.set_xlabel("time, s")
    axes.set_ylabel(unit)
    return figure
