"""The coefficients of the diagnosis' probabilities, from answers to recordings with known causes.

Run ``python benchmarks/gap_probabilities.py FOLDER …`` on folders that ``tam blind make`` wrote, or a world of others
with its truths in ``key.json``, and that ``tam blind answer`` answered. Of every cause that was named it takes what the
probability is made of, and whether the cause was right; it fits the logistic regression of
``tam_calibration.gap.causes``, leaves each folder out once, and prints the coefficients. It also prints the log
score on the folder left out, and that of a constant rate. It writes no file.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.optimize import minimize

from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.causes import features_of
from tam_calibration.model.units import FloatArray
from tam_validation.blind.folder import read_json, read_keys, read_outcomes
from tam_validation.blind.outcome import NO_GAP, UNEXPLAINED, Outcome

OTHER_NAMES = {
    "late_windows": "stale_samples",
    "interp_windows": "interpolated_samples",
    "gain_bursts": "gain_switching",
    "agc_gain": "gain_switching",
    "mux_crosstalk": "crosstalk",
    "filter_ringdown": "ringing",
}
"""What the library calls causes of other worlds."""

RIDGE = 1.0
"""Of the squared coefficients: as much as one case tells."""


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
def main(folders: tuple[Path, ...]) -> None:
    """Fit and print."""
    answered = [outcomes_of(folder) for folder in folders]
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


def outcomes_of(folder: Path) -> list[Outcome]:
    """Return keys and answers, of this check or of a world of others, whose keys say less."""
    if not (folder / "key.json").exists():
        return read_outcomes(folder, read_keys(folder, None), "answer.json")
    return read_outcomes(
        folder, {name: key_of(own) for name, own in read_json(folder / "key.json").items()}, "answer.json"
    )


def key_of(own: Mapping[str, Any]) -> dict[str, Any]:
    """Return the key of a case of another world as this check writes it."""
    names = [own["effect"]] if isinstance(own["effect"], str) else own["effect"] or []
    kinds = ("mixed", "withheld", "outside")
    kind = next((kind for kind in kinds if own.get(kind)), ("clean", "single", "pair")[len(names)])
    known = [OTHER_NAMES.get(name, name) for name in names]
    is_known = kind == "outside" and known[0] in installed_effects()
    effects = [{"effect": name, "visible_gap": own["gap"]} for name in known]
    return {
        "kind": "single" if is_known else kind,
        "effects": effects,
        "withheld_channel": str(own.get("withheld") or ""),
    }


def is_right(outcome: Outcome) -> bool:
    """Whether no gap, or an unknown cause, is the truth."""
    told = outcome.first_forecast
    return told is not None and told[1]


def causes_of(outcomes: Sequence[Outcome]) -> FloatArray:
    """Return of every named cause its features and whether it is right, (M, 6)."""
    rows = []
    for one in outcomes:
        considered = one.answer.get("considered") or ()
        evidence = {other["effect"]: (other.get("evidence") or {}).get("delta_bic", 0.0) for other in considered}
        rival = max((value for name, value in evidence.items() if name not in one.named), default=0.0)
        for cause in one.causes:
            own = evidence[cause["effect"]]
            departures, closed = len(one.answer["checks"]["departs"]), one.answer["gap"]["closed"]
            features = features_of(departures, cause["share"], own, rival, closed)
            rows.append((*features, cause["effect"] in {*one.truth, *one.other_names}))
    return np.array(rows, dtype=float).reshape(-1, 6)


def fitted(tables: Sequence[FloatArray]) -> FloatArray:
    """Return the coefficients (5,) of the logistic regression with a ridge."""
    joined = np.concatenate(tables)

    def cost(weights: FloatArray) -> float:
        logit = joined[:, :-1] @ weights
        return float(np.sum(np.logaddexp(0, logit) - joined[:, -1] * logit) + RIDGE * weights @ weights / 2)

    return np.asarray(minimize(cost, np.zeros(joined.shape[1] - 1)).x)


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
