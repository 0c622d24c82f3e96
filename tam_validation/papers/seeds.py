"""Simulations of a paper with many seeds, on all cores."""

import os
from collections.abc import Callable
from importlib import import_module
from multiprocessing import get_context

import numpy as np

from tam_calibration.fleet.batch import processes, submit_all
from tam_validation.papers.row import Draws


def simulate(paper: str, seeds: int, as_published: bool, progress: Callable[[int], None]) -> Draws:
    """Return what the simulations of a paper give, by findings.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``; its module has a function ``simulate(seed, as_published)``.
    seeds : int
        How many.
    as_published : bool
        Whether the text of the paper is followed to the letter, also where it cannot give its numbers.
    progress : callable
        Called with the number of seeds that are done.
    """
    with processes(os.cpu_count() or 1, get_context("spawn")) as pool:
        results = []
        for task in submit_all(pool, _simulate, [(paper, seed, as_published) for seed in range(seeds)]):
            results.append(task.result())
            progress(len(results))
    return {name: np.array([np.ravel(result[name]) for result in results]) for name in results[0]}


def _simulate(task: tuple[str, int, bool]) -> Draws:
    paper, seed, as_published = task
    simulated: Draws = import_module(f"tam_validation.papers.{paper}").simulate(seed, as_published)
    return simulated
