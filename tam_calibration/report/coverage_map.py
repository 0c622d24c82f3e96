"""The map of the field directions that a recording visited."""

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from tam_calibration.fit.coverage import BANDS, SECTORS, Coverage, cell_of
from tam_calibration.report.style import AFTER_COLOR, MISSING_COLOR, STYLE, WIDTH_INCH
from tam_calibration.units import FloatArray, from_degrees

_SHADES = LinearSegmentedColormap.from_list("samples", ["#d3e3f1", AFTER_COLOR, "#0d2c4b"])
_MISSING = ListedColormap([MISSING_COLOR])
_PLACES = (
    ("forward", 0, 0),
    ("left", -90, 0),
    ("right", 90, 0),
    ("backward", -158, 0),
    ("backward", 158, 0),
    ("up", 0, 80),
    ("down", 0, -80),
)


@matplotlib.rc_context(STYLE)
def plot_coverage(coverage: Coverage) -> Figure:
    """Draw the samples in each cell of the sphere of field directions, equal in area (Hammer), seen from the array.

    Left of the array (+y) is left of the map; cells without a sample stand out.
    """
    figure = Figure(figsize=(1.3 * WIDTH_INCH, 3.8), layout="constrained")
    axes = figure.add_subplot(projection="hammer")
    longitude, latitude, cell = cells_on_map()
    samples = coverage.counts[cell]
    visited = np.ma.masked_where(samples == 0, samples)
    missing = np.ma.masked_where(samples > 0, samples)
    scale = LogNorm(1, max(10, int(coverage.counts.max())))
    mesh = axes.pcolormesh(longitude, latitude, visited, cmap=_SHADES, norm=scale, shading="nearest", rasterized=True)
    axes.pcolormesh(longitude, latitude, missing, cmap=_MISSING, shading="nearest", rasterized=True)
    draw_borders(axes)
    name_directions(axes)
    figure.colorbar(mesh, ax=axes, location="bottom", shrink=0.5, aspect=30, label="samples in a cell", format="%d")
    key = [Patch(color=MISSING_COLOR, label="no sample")]
    axes.legend(handles=key, loc="upper right", bbox_to_anchor=(1.02, 1.05), frameon=False)
    return figure


def cells_on_map() -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Return the map's longitude, to the right, its latitude, and the cell at each of its points."""
    longitude, latitude = np.linspace(-np.pi, np.pi, 721), np.linspace(-np.pi / 2, np.pi / 2, 361)
    azimuth, elevation = np.meshgrid(-longitude, latitude)
    level = np.cos(elevation)
    points = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
    return longitude, latitude, cell_of(points.reshape(-1, 3)).reshape(azimuth.shape)


def draw_borders(axes: Axes) -> None:
    """Draw the borders of the cells."""
    along = np.linspace(-1, 1, 181)
    for meridian in np.linspace(-np.pi, np.pi, SECTORS + 1)[1:-1]:
        axes.plot(np.full_like(along, meridian), along * np.pi / 2, color="white", linewidth=0.5)
    for parallel in np.arcsin(np.linspace(-1, 1, BANDS + 1)[1:-1]):
        axes.plot(along * np.pi, np.full_like(along, parallel), color="white", linewidth=0.5)
    axes.set_xticks([])
    axes.set_yticks([])


def name_directions(axes: Axes) -> None:
    """Write the names of directions on the map."""
    halo = [withStroke(linewidth=2.5, foreground="white")]
    for name, longitude, latitude in _PLACES:
        axes.text(from_degrees(longitude), from_degrees(latitude), name, ha="center", va="center", path_effects=halo)
