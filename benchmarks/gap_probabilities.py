"""The coefficients of the diagnosis' probabilities, from answers to recordings with known causes.

Run ``python benchmarks/gap_probabilities.py FOLDER …`` on folders that ``tam blind make`` and ``tam blind answer``
wrote. Of every cause that was named it takes what the probability is made of, and whether the cause was right; it fits
the logistic regression of ``tam_calibration.gap.probability``, leaves each folder out once, and prints the coefficients
with the log score on what was left out beside that of the plain rate. Nothing is written.
"""

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np
from scipy.optimize import minimize

from tam_calibration.blind.folder import read_keys, read_outcomes
from tam_calibration.blind.outcome import NO_GAP, UNEXPLAINED, Outcome
from tam_calibration.gap.probability import features_of
from tam_calibration.gap.standing import Standing
from tam_calibration.units import FloatArray

RIDGE = 1.0
"""Of the squared coefficients: as much as one case tells."""


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
def main(folders: tuple[Path, ...]) -> None:
    """Fit and print."""
    answered = [read_outcomes(folder, read_keys(folder, None), "answer.json") for folder in folders]
    tables = [causes_of(outcomes) for outcomes in answered]
    click.echo(f"coefficients: {np.round(fitted(tables), 2).tolist()}, of {sum(len(one) for one in tables)} causes")
    for number, (folder, own) in enumerate(zip(folders, tables, strict=True)):
        others = [table for other, table in enumerate(tables) if other != number] or tables
        rate = np.concatenate(others)[:, -1].mean()
        told = score(own, chance(fitted(others), own))
        click.echo(f"{folder.name} left out: log score {told:.3f}, of the plain rate {score(own, rate):.3f}")
    for verdict in (NO_GAP, UNEXPLAINED):
        told_so = [is_right(one) for outcomes in answered for one in outcomes if one.verdict == verdict]
        click.echo(f"{verdict}: right {sum(told_so)} of {len(told_so)}")


def is_right(outcome: Outcome) -> bool:
    """Whether no gap, or an unknown cause, is the truth."""
    if outcome.verdict == NO_GAP:
        return not outcome.truth
    return outcome.kind in ("outside", "withheld")


def causes_of(outcomes: Sequence[Outcome]) -> FloatArray:
    """Return of every named cause its features and whether it is right, (M, 5)."""
    rows = []
    for one in outcomes:
        for cause in one.answer.get("causes", ()):
            told = cause["evidence"]
            standing = None
            if "gain" in told:
                standing = Standing(told["gain"], told["best_surrogate_gain"], told["rank_among_surrogates"])
            own = features_of(standing, one.answer["gap"]["closed"], cause["share"])
            rows.append((*own, cause["effect"] in {*one.truth, *one.other_names}))
    return np.array(rows, dtype=float).reshape(-1, 5)


def fitted(tables: Sequence[FloatArray]) -> FloatArray:
    """Return the coefficients (4,) of the logistic regression with a ridge; nothing that is told speaks against."""
    joined = np.concatenate(tables)

    def cost(weights: FloatArray) -> float:
        logit = joined[:, :-1] @ weights
        return float(np.sum(np.logaddexp(0, logit) - joined[:, -1] * logit) + RIDGE * weights @ weights / 2)

    bounds = [(None, None), *[(0.0, None)] * (joined.shape[1] - 2)]
    return np.asarray(minimize(cost, np.zeros(len(bounds)), bounds=bounds).x)


def chance(weights: FloatArray, table: FloatArray) -> FloatArray:
    """Return the probabilities (M,)."""
    told: FloatArray = 1 / (1 + np.exp(-table[:, :-1] @ weights))
    return told


def score(table: FloatArray, told: FloatArray | float) -> float:
    """Return the mean negative logarithm of the probability of what came true."""
    came = table[:, -1]
    return float(np.mean(-np.log(np.where(came > 0, told, 1 - np.asarray(told)))))


if __name__ == "__main__":
    main()
