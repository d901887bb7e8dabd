"""Which model, and how many lobes: fits of several, ranked by an information criterion."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from fitting.fit import fit
from fitting.models import MODELS, Model, find_model
from fitting.result import SEVERAL, Fit
from fitting.samples import Samples
from gonio.files import atomic
from gonio.progress import Report
from gonio.table.table import Table
from microgeometry.errors import InputError

MOST_LOBES = 4
"""Where the automatic choice stops at the latest."""

Lobes = int | Literal["auto"]


def isotropic_models() -> list[str]:
    """Names of the models a table of an isotropic surface can tell apart."""
    return [name for name, model in MODELS.items() if all(lobe.isotropic for lobe in model.lobes)]


def with_lobes(model: Model, count: int) -> Model:
    """The model with each of its glossy lobes `count` times, its diffuse ones once.

    Raises
    ------
    InputError
        A count below 1, or above 1 of a model without glossy lobes.
    """
    if count < 1:
        raise InputError(f"lobes: {count}; a number from 1, or auto, is allowed")
    if count == 1:
        return model
    glossy = [lobe for lobe in model.lobes if not lobe.diffuse]
    if not glossy:
        raise InputError(f"lobes: {count}; {model.name} has no glossy lobe, 1 is allowed")
    lobes = [lobe for lobe in model.lobes for _ in range(1 if lobe.diffuse else count)]
    return Model("+".join(lobe.name for lobe in lobes), tuple(lobes), f"{model.name}, {count} lobes")


def fit_lobes(
    data: Table | Samples, model: str, lobes: Lobes = 1, *, progress: Report | None = None, **options: Any
) -> Fit:
    """Fit a model with so many glossy lobes, or with as many as the criterion asks for.

    Parameters
    ----------
    data : Table or Samples
    model : str
    lobes : int or "auto"
        "auto" adds lobes until the criterion no longer falls, `MOST_LOBES` at most.
    progress : callable, optional
    options
        Of `fitting.fit.fit`.

    Raises
    ------
    InputError
        As `fit`, or a number of lobes that is not allowed.
    """
    chosen = find_model(model)
    if lobes != "auto":
        return fit(data, with_lobes(chosen, lobes), progress=progress, **options)
    samples = data if isinstance(data, Samples) else Samples.of_table(data)
    best = fit(samples, chosen, progress=progress, **options)
    if all(lobe.diffuse for lobe in chosen.lobes):
        return best
    for count in range(2, MOST_LOBES + 1):
        more = fit(samples, with_lobes(chosen, count), progress=progress, **options)
        if not _below(more, best):
            break
        best = more
    return best


def fit_models(
    data: Table | Samples,
    models: Sequence[str],
    lobes: Sequence[Lobes] = (1,),
    *,
    progress: Report | None = None,
    **options: Any,
) -> list[Fit]:
    """Fit several models, and rank them by the criterion, the best first.

    A model without glossy lobes is fitted once, whatever the numbers of lobes; two that come to the same number,
    as "auto" may to another, are one.
    """
    samples = data if isinstance(data, Samples) else Samples.of_table(data)
    tasks = []
    for name in models:
        plain = all(lobe.diffuse for lobe in find_model(name).lobes)
        tasks += [(name, count) for count in ([1] if plain else lobes)]
    fits = []
    for n, (name, count) in enumerate(tasks):
        fits.append(fit_lobes(samples, name, count, **options))
        if progress is not None:
            progress((n + 1) / len(tasks), f"{n + 1} of {len(tasks)}: {fits[-1].model}")
    once = {f.model: f for f in reversed(fits)}.values()
    return sorted(once, key=lambda f: float("inf") if f.criterion is None else f.criterion)


def _below(one: Fit, other: Fit) -> bool:
    return one.criterion is not None and other.criterion is not None and one.criterion < other.criterion


def save_fits(fits: Mapping[str, Sequence[Fit]], path: str | os.PathLike[str]) -> None:
    """Write fits of several tables, by name, as one JSON file; nothing half-written ever stands there."""
    with atomic(path) as temporary:
        Path(temporary).write_text(dumps(fits, indent=2) + "\n", encoding="utf-8")


def dumps(fits: Mapping[str, Sequence[Fit]], indent: int | None = None) -> str:
    """Fits of several tables as text: {"schema": ..., "tables": {name: [fit, ...]}}, the best first."""
    content = {
        "schema": SEVERAL,
        "tables": {name: [f.to_json() for f in each] for name, each in fits.items()},
    }
    return json.dumps(content, indent=indent, allow_nan=False)
