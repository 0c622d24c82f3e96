"""Calibrations with known figures, made from the truth instead of a fit; pages that are read."""

import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import Provenance
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors, measure_residuals, noise_floor

INTENSITY_T = 50e-6


def make_recording(array: Array, errors: SensorErrors, samples: int, scalar: bool) -> Recording:
    """Return readings in a uniform field of random directions, with the array's noise."""
    rng = np.random.default_rng(7)
    field = rng.normal(size=(samples, 3))
    field *= INTENSITY_T / np.linalg.norm(field, axis=1, keepdims=True)
    noise = rng.normal(size=(samples, array.sensor_count, 3)) * array.vector_noise_T[:, None]
    reference = np.full(samples, INTENSITY_T) + rng.normal(0, array.scalar_noise_T, samples)
    return Recording(np.arange(samples) * 0.01, errors.distort(field) + noise, reference if scalar else None)


def make_errors(sensor_count: int) -> SensorErrors:
    """Return errors of the usual sizes; sensor 1's frame is the array's."""
    rng = np.random.default_rng(3)
    shape = (sensor_count, 3)
    misalignment = np.vstack([np.zeros(3), rng.normal(0, 0.02, (sensor_count - 1, 3))])
    scale = 1 + rng.normal(0, 0.02, shape)
    return SensorErrors(scale, rng.normal(0, 0.01, shape), rng.normal(0, 7e-7, shape), misalignment)


@pytest.fixture
def make() -> Callable[..., tuple[Calibration, Recording]]:
    """Return a maker of a calibration and its recording."""

    def make(array: Array | None = None, samples: int = 400, scalar: bool = True, **changes) -> tuple:
        array = array or Array.cross(0.5, 1e-9, 1e-10)
        errors = make_errors(array.sensor_count)
        recording = make_recording(array, errors, samples, scalar)
        calibration = Calibration(
            method="maximum_likelihood",
            array=array,
            noise_is_estimated=False,
            errors=errors,
            covariance=np.eye(12 * array.sensor_count) * 1e-24,
            has_scalar_reference=scalar,
            intensity_T=INTENSITY_T,
            before=measure_residuals(SensorErrors.none(array.sensor_count), array, recording, INTENSITY_T),
            in_sample=measure_residuals(errors, array, recording, INTENSITY_T),
            floor=noise_floor(errors, array, 1e-10),
            samples=samples,
            time_span_s=(0.0, float(recording.time_s[-1])),
            coverage=1.0,
            reduced_chi_square={"differential": 1.01, "common_mode": 0.98},
            source=Provenance("tumble_4.csv", 123456, "ab" * 32),
        )
        return replace(calibration, **{"held_out": calibration.in_sample, **changes}), recording

    return make


@pytest.fixture
def one_sensor() -> Array:
    """Return the array of one sensor, which has no gradient."""
    return Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10)


VOID = {"meta", "img"}


class Page(HTMLParser):
    """A page: its text, its headings, its references, and whether its tags are balanced."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html = html
        self.open: list[str] = []
        self.references: list[str] = []
        self.headings: list[str] = []
        self.words: list[str] = []
        self.feed(html)
        self.close()
        self.text = re.sub(r"\s+", " ", " ".join(self.words))

    def handle_starttag(self, tag, attributes):
        self.references += [value for name, value in attributes if name in ("src", "href", "srcset", "data", "action")]
        assert tag not in ("script", "link", "iframe", "object", "embed", "b")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.words.append(data)
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


@pytest.fixture(scope="session")
def read_page():
    """Return a function that reads a page, which is whole: its tags are balanced, and it fetches nothing."""

    def read(path) -> Page:
        page = Page(path.read_text(encoding="utf-8"))
        assert page.open == []
        assert all(reference.startswith("data:image/svg+xml;base64,") for reference in page.references)
        assert not re.search(r"url\(|@import|https?://", page.html)
        return page

    return read
