"""The fitted (or hand-written) model: what the renderer evaluates, what stands in the JSON file."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.models import SIZE, Lobe, find_lobe, find_model
from gonio.files import atomic
from gonio.table.table import Table
from microgeometry.errors import InputError

Array = NDArray[np.float64]

SCHEMA = "gonio-fit/1"
"""Name and major version of the JSON file; a reader refuses another major version."""


SEVERAL = "gonio-fits/1"
"""The same of a file of several fits, see `fitting.compare`."""


class Terms(NamedTuple):
    """A model as the kernels take it: f_r of channel c = sum over k of weights[k, c] x lobe k.

    kinds, shape (K,); shapes, shape (K, SIZE), the packed lobes of `fitting.models.dispatch`; weights,
    shape (K, C), all >= 0. Terms of coefficient 0 in every channel are not listed.
    """

    kinds: NDArray[np.int64]
    shapes: Array
    weights: Array


@dataclass(frozen=True)
class FittedLobe:
    """A lobe with its numbers: `parameters` by name, `coefficients` by name and channel."""

    name: str
    parameters: Mapping[str, float]
    coefficients: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Fit:
    """An analytic model with its numbers and, where it was fitted, how well it describes the table.

    Parameters
    ----------
    model : str
        A name of `fitting.models.MODELS`.
    lobes : tuple of FittedLobe
        Lobes of that model; one may stand several times, or not at all.
    channels : tuple of str
    wavelengths_nm : tuple of float, optional
        One a channel.
    objective : str, optional
        What the fit minimised; None for a hand-written model, as all that follows.
    residuals : mapping of str to float
        Every metric of `fitting.metrics.metrics`, on the same cells.
    degrees_of_freedom : int, optional
        Values less parameters: what chi2 should come to if the model holds.
    goodness : mapping, optional
        chi2, its degrees of freedom, its standard deviation and its p-value; see `fitting.confidence`.
    criterion : float, optional
        Bayes' information criterion; smaller is better, for one objective on the same cells.
    confidence : mapping, optional
        level; parameters, one object each: lobe (its number), name, channel (None of a shape parameter),
        value, std_error, lower and upper end of the interval, at_bound; correlation, their matrix.
    evaluations : int
        Of the objective, both stages.
    seconds : float
    cells_used : int
    cells_left_out : mapping of str to int
        By reason.
    theta_limit_deg : float, optional
        Polar angles beyond were left out.
    albedo : mapping
        theta_i_deg; values, directional albedo by channel; largest; conserves_energy.
    reciprocity : mapping
        largest_difference, of f(i, o) and f(o, i) relative to their mean; reciprocal.
    notes : tuple of str
        What a reader of the numbers should know.
    provenance : mapping
        Of the table.
    versions : mapping of str to str
        Of the software.
    """

    model: str
    lobes: tuple[FittedLobe, ...]
    channels: tuple[str, ...]
    wavelengths_nm: tuple[float, ...] | None = None
    objective: str | None = None
    residuals: Mapping[str, float] = field(default_factory=dict)
    degrees_of_freedom: int | None = None
    goodness: Mapping[str, float] | None = None
    criterion: float | None = None
    confidence: Mapping[str, Any] | None = None
    evaluations: int = 0
    seconds: float = 0.0
    cells_used: int = 0
    cells_left_out: Mapping[str, int] = field(default_factory=dict)
    theta_limit_deg: float | None = None
    albedo: Mapping[str, Any] = field(default_factory=dict)
    reciprocity: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    def replace(self, **changes: Any) -> Fit:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)

    def terms(self) -> Terms:
        """The model packed for the kernels: one entry a term that is not 0."""
        kinds, shapes, weights = [], [], []
        for fitted in self.lobes:
            lobe = find_lobe(fitted.name)
            for index, term in enumerate(lobe.terms):
                by_channel = fitted.coefficients[term.coefficient]
                weight = term.factor(
                    np.array([by_channel[c] for c in self.channels]),
                    [fitted.parameters[q.name] for q in lobe.parameters],
                )
                if np.any(weight > 0):
                    kinds.append(lobe.kind)
                    shapes.append(lobe.pack(fitted.parameters, (1.0, 0.0) if index == 0 else (0.0, 1.0)))
                    weights.append(weight)
        count = len(kinds)
        return Terms(
            np.array(kinds, np.int64),
            np.array(shapes).reshape(count, SIZE),
            np.array(weights).reshape(count, len(self.channels)),
        )

    def table(self, grid_like: Table | None = None) -> Table:
        """The model as a table of cell averages; see `fitting.tabulate.tabulate`."""
        from fitting.tabulate import tabulate  # tabulate needs this class

        return tabulate(self, grid_like)

    def to_json(self) -> dict[str, Any]:
        """The content of the file, as plain JSON types."""
        return json.loads(self.dumps())

    def dumps(self, indent: int | None = None) -> str:
        """The content of the file, as text."""
        content = {"schema": SCHEMA, **dataclasses.asdict(self)}
        return json.dumps(content, indent=indent, allow_nan=False, default=_plain)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the JSON file; nothing half-written ever stands under its name.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        text = self.dumps(indent=2) + "\n"
        with atomic(path) as temporary:
            Path(temporary).write_text(text, encoding="utf-8")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Fit:
        """Read a JSON file, fitted or hand-written; `model` and `lobes` are all it must have.

        Raises
        ------
        InputError
            The file is missing, no JSON, of a newer schema, or a key or number in it is not allowed.
        """
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(f"{path}: no such file; a fit written by `gonio fit -o` is expected") from None
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise InputError(
                f"{path}: not a JSON file ({error}); a fit written by `gonio fit -o` is expected"
            ) from None
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; a file is expected") from None
        try:
            return fit_from_json(content)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def versions() -> dict[str, str]:
    """Versions of what a fit's numbers depend on."""
    out = {"python": platform.python_version()}
    for name in ("gonio", "numpy", "numba", "nlopt", "scipy"):
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "unknown"
    return out


def fit_from_json(content: Any) -> Fit:
    """A fit from the object that `Fit.to_json` makes, or a file of fits of one table holds: its best.

    Raises
    ------
    InputError
        Something in it is missing, unknown or of the wrong kind.
    """
    _is(content, dict, "content", "an object with the keys model and lobes")
    if content.get("schema") == SEVERAL:
        tables = _is(content.get("tables"), dict, "tables", "an object")
        if len(tables) != 1 or not all(isinstance(fits, list) and fits for fits in tables.values()):
            raise InputError(
                f"tables: fits of {len(tables)} tables; those of one are expected, the first is taken"
            )
        return fit_from_json(next(iter(tables.values()))[0])
    allowed = ["schema", *(f.name for f in dataclasses.fields(Fit))]
    _known(content, allowed, "key")
    schema = content.get("schema", SCHEMA)
    if schema != SCHEMA:
        raise InputError(f"schema: {schema!r}; {SCHEMA!r} is expected, another version of gonio wrote this")
    for key in ("model", "lobes"):
        if key not in content:
            raise InputError(f"{key}: missing; a model needs the keys model and lobes")
    model = find_model(_is(content["model"], str, "model", "a name"))
    entries = _is(content["lobes"], list, "lobes", "a list with at least one lobe")
    if not entries:
        raise InputError("lobes: empty; a list with at least one lobe is expected")
    lobes = tuple(_lobe(entry, f"lobes[{i}]", model.lobes) for i, entry in enumerate(entries))
    named = [tuple(values) for lobe in lobes for values in lobe.coefficients.values()]
    channels = tuple(content.get("channels", named[0]))
    if not channels:
        raise InputError('channels: none; a coefficient is an object like {"R": 0.9, "G": 0.6, "B": 0.3}')
    for names in named:
        if set(names) != set(channels):
            raise InputError(
                f"coefficients: channels {list(names)} and {list(channels)}; all must be the same"
            )
    rest = {k: v for k, v in content.items() if k not in ("schema", "model", "lobes", "channels")}
    for key in ("notes", "wavelengths_nm"):
        if rest.get(key) is not None:
            rest[key] = tuple(_is(rest[key], list, key, "a list"))
    wavelengths = rest.get("wavelengths_nm")
    if wavelengths is not None and (
        len(wavelengths) != len(channels) or not all(_number(w) and w > 0 for w in wavelengths)
    ):
        raise InputError(
            f"wavelengths_nm: {list(wavelengths)}; {len(channels)} positive numbers are expected"
        )
    return Fit(model=model.name, lobes=lobes, channels=channels, **rest)


def _lobe(entry: Any, where: str, allowed: tuple[Lobe, ...]) -> FittedLobe:
    _is(entry, dict, where, "an object with the keys name, parameters and coefficients")
    _known(entry, ["name", "parameters", "coefficients"], where)
    lobe = find_lobe(entry.get("name", ""), f"{where}.name")
    if lobe not in allowed:
        names = ", ".join(a.name for a in allowed)
        raise InputError(f"{where}.name: {lobe.name!r} is no lobe of this model; {names} is allowed")
    given = _is(entry.get("parameters", {}), dict, f"{where}.parameters", "an object")
    _complete(given, [q.name for q in lobe.parameters], f"{where}.parameters")
    parameters = {q.name: q.check(given[q.name], f"{where}.parameters") for q in lobe.parameters}
    given = _is(
        entry.get("coefficients"),
        dict,
        f"{where}.coefficients",
        f"an object with {', '.join(lobe.coefficients)}",
    )
    _complete(given, list(lobe.coefficients), f"{where}.coefficients")
    coefficients = {}
    for name in lobe.coefficients:
        values = _is(
            given[name], dict, f"{where}.coefficients.{name}", "an object, a number for each channel,"
        )
        for channel, value in values.items():
            if not _number(value) or not 0.0 <= value < np.inf:
                raise InputError(
                    f"{where}.coefficients.{name}.{channel}: {value!r}; a number >= 0 is allowed"
                )
        coefficients[name] = {str(c): float(v) for c, v in values.items()}
        _converges(lobe, parameters, name, coefficients[name], where)
    return FittedLobe(lobe.name, parameters, coefficients)


def _converges(
    lobe: Lobe, parameters: Mapping[str, float], name: str, values: Mapping[str, float], where: str
) -> None:
    """Refuse an albedo whose series of bounces has no sum."""
    for term in lobe.terms:
        if term.coefficient == name and term.feedback is not None:
            back = term.feedback(*parameters.values())
            for channel, value in values.items():
                if back * value >= 1.0:
                    raise InputError(
                        f"{where}.coefficients.{name}.{channel}: {value!r}; less than {1.0 / back:.4g} is "
                        "allowed, with more the bounces never end"
                    )


def _is(value: Any, kind: type, where: str, expected: str) -> Any:
    if not isinstance(value, kind):
        raise InputError(f"{where}: {value!r:.60}; {expected} is expected")
    return value


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _known(given: Mapping[str, Any], allowed: list[str], where: str) -> None:
    for key in given:
        if key not in allowed:
            raise InputError(f"{where}: unknown {key!r}; {', '.join(allowed) or 'none'} is allowed")


def _complete(given: Mapping[str, Any], names: list[str], where: str) -> None:
    _known(given, names, where)
    for name in names:
        if name not in given:
            raise InputError(f"{where}: {name} is missing; {', '.join(names)} is expected")


def _plain(value: Any) -> Any:
    """Numpy numbers and arrays in a provenance, as JSON."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return str(value)
