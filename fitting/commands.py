"""The command line of fitting: `gonio fit`, `gonio fit-merl`, `gonio tabulate`, and the benchmark `fit`."""

from __future__ import annotations

import json
import time
from pathlib import Path

import click
import numpy as np

from fitting import merl
from fitting.compare import Lobes, dumps, fit_lobes, fit_models, isotropic_models, save_fits
from fitting.fit import LATE
from fitting.models import find_model
from fitting.objectives import OBJECTIVES
from fitting.result import Fit
from fitting.samples import THETA_LIMIT_DEG, Samples
from fitting.tabulate import tabulate
from gonio import formats
from gonio.bench import BENCHMARKS
from gonio.files import atomic, check_writable
from gonio.progress import progress_bar
from microgeometry.errors import InputError

BENCHMARKS["fit"] = "fitting.bench"

_FILE = click.Path(path_type=Path, dir_okay=False)
_CHANNELS = 8  # told in words; of more the first, the middle one and the last


@click.command("fit")
@click.argument("tables", metavar="T...", type=_FILE, nargs=-1, required=True)
@click.option("--model", required=True, metavar="NAME", help="A model, a sum of lobes by +, or all.")
@click.option("--lobes", default="1", metavar="K", help="Glossy lobes: a number, several (1,2), or auto.")
@click.option(
    "--objective", metavar="NAME", help=f"{', '.join(OBJECTIVES)}; default chi2 if there are errors."
)
@click.option(
    "--theta-limit",
    type=float,
    default=THETA_LIMIT_DEG,
    show_default=True,
    metavar="DEG",
    help="Polar angles beyond are left out.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Where the search starts.")
@click.option("-o", "--output", type=_FILE, metavar="FIT.json", help="Where to write the fit, or the fits.")
@click.option("--json", "as_json", is_flag=True, help="Print what -o writes, as one JSON object.")
def fit_command(
    tables: tuple[Path, ...],
    model: str,
    lobes: str,
    objective: str | None,
    theta_limit: float,
    seed: int,
    output: Path | None,
    as_json: bool,
) -> None:
    """Fit analytic models to tables, weighted by their error bars where they have any.

    Several models, numbers of lobes or tables give a ranked list, the
    best first, and one JSON object of all fits.
    """
    if output is not None:
        check_writable(output)
    counts = _counts(lobes)
    names = isotropic_models() if model == "all" else [find_model(model).name]
    options = {"objective": objective, "seed": seed}
    if len(tables) == 1 and len(names) == 1 and len(counts) == 1:
        with progress_bar("fit") as progress:
            samples = Samples.of_table(formats.read(tables[0]), theta_limit)
            result = fit_lobes(samples, names[0], counts[0], progress=progress, **options)
        if output is not None:
            result.save(output)
        if as_json:
            click.echo(result.dumps(indent=None))
        else:
            _tell(result)
        return
    found: dict[str, list[Fit]] = {}
    for path in tables:
        with progress_bar(path.name) as progress:
            samples = Samples.of_table(formats.read(path), theta_limit)
            found[str(path)] = fit_models(samples, names, counts, progress=progress, **options)
        if not as_json:
            _rank(str(path), found[str(path)])
    if len(tables) > 1 and not as_json:
        _summary(found)
    if output is not None:
        save_fits(found, output)
    if as_json:
        click.echo(dumps(found))


def _counts(text: str) -> list[Lobes]:
    counts: list[Lobes] = []
    for part in text.split(","):
        if part == "auto":
            counts.append("auto")
        elif part.isdecimal() and int(part) > 0:
            counts.append(int(part))
        else:
            raise InputError(
                f"lobes: {part!r}; a number from 1, several joined by commas, or auto is allowed"
            )
    return counts


def _tell(result: Fit) -> None:
    """A fit in words."""
    sure = iter([] if result.confidence is None else result.confidence["parameters"])

    def number(name: str, value: float) -> str:
        of = next(sure, None)
        if of is None or of["at_bound"] or of["lower"] is None or of["upper"] is None:
            return f"{name} {value:.6g}"
        return f"{name} {value:.6g} ({of['lower']:.6g} to {of['upper']:.6g})"

    # intervals stand in the order of the unknowns: shape parameters of all lobes first
    shapes = [[number(k, v) for k, v in lobe.parameters.items()] for lobe in result.lobes]
    for lobe, shape in zip(result.lobes, shapes, strict=True):
        click.echo(f"{lobe.name}{': ' + ', '.join(shape) if shape else ''}")
        for name, by_channel in lobe.coefficients.items():
            values = [number(c, v) for c, v in by_channel.items()]
            if len(values) > _CHANNELS:
                values = [values[0], "...", values[len(values) // 2], "...", values[-1]]
            click.echo(f"  {name}: " + ", ".join(values))
    click.echo(
        f"minimised {result.objective}; " + ", ".join(f"{k} {v:.4g}" for k, v in result.residuals.items())
    )
    if result.goodness is not None:
        ratio = result.goodness["chi2"] / result.goodness["degrees_of_freedom"]
        click.echo(
            f"chi2 per degree of freedom {ratio:.3f}, residuals of neighbours correlate by "
            f"{result.goodness['neighbours']:.1f} sigma: p = {result.goodness['p_value']:.2g}"
        )
    left = ", ".join(f"{n} {reason}" for reason, n in result.cells_left_out.items()) or "none"
    click.echo(f"{result.cells_used} cells used; left out: {left}")
    energy = "at most 1" if result.albedo["conserves_energy"] else "above 1: the fit creates energy"
    click.echo(f"largest albedo {result.albedo['largest']:.4f}, {energy}")
    if not result.reciprocity["reciprocal"]:
        click.echo(f"not reciprocal: differs by {result.reciprocity['largest_difference']:.2g}")
    for note in result.notes:
        click.echo(f"note: {note}")
    click.echo(f"{result.evaluations} evaluations, {result.seconds:.2f} s")


def _rank(name: str, fits: list[Fit]) -> None:
    """The fits of one table as lines, the best first."""
    best = fits[0].criterion
    width = max(len(each.model) for each in fits)
    click.echo(f"{name}: {fits[0].cells_used} cells, minimised {fits[0].objective}")
    click.echo(
        f"{'':>4}  {'model':{width}}{'BIC - best':>12}{'ngan_l2 (rel.)':>16}{'low_log':>11}{'albedo':>9}{'s':>7}"
    )
    for rank, each in enumerate(fits, 1):
        above = 0.0 if each.criterion is None or best is None else each.criterion - best
        click.echo(
            f"{rank:4}  {each.model:{width}}{above:12.4g}{each.residuals['relative_ngan_l2']:16.4f}"
            f"{each.residuals['low_log']:11.4g}{each.albedo['largest']:9.3f}{each.seconds:7.2f}"
            + ("" if each.albedo["conserves_energy"] else "  creates energy")
            + ("  time limit" if LATE in each.notes else "")
        )


def _summary(found: dict[str, list[Fit]]) -> None:
    """Medians over tables, by model."""
    names = {each.model for fits in found.values() for each in fits}
    medians = {}
    for name in names:
        of = [e.residuals["relative_ngan_l2"] for fits in found.values() for e in fits if e.model == name]
        medians[name] = float(np.median(of)), len(of)
    click.echo(f"all {len(found)} tables: median relative ngan_l2")
    width = max(map(len, names))
    for name, (value, count) in sorted(medians.items(), key=lambda item: item[1]):
        click.echo(
            f"{'':6}{name:{width}}{value:12.4f}" + (f"  ({count} tables)" if count < len(found) else "")
        )


@click.command("fit-merl")
@click.argument("networks", metavar="NETWORKS", type=click.Path(path_type=Path))
@click.option(
    "--published",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER",
    help="Published fits (ngan_ward.fit and others) to be judged by the same code.",
)
@click.option(
    "-o", "--output", type=_FILE, metavar="OUT.json", help="Where to write all metrics, by material."
)
def fit_merl_command(networks: Path, published: Path | None, output: Path | None) -> None:
    """Fit every model, with one and two lobes, to the materials of the MERL database, and print medians.

    NETWORKS is nbrdf_weights.npz, the materials as neural networks, or the folder that holds it. Each material
    is looked at in 31 214 cells of MERL's grid, angles above 80 degrees left out.
    """
    if output is not None:
        check_writable(output)
    began = time.perf_counter()
    with progress_bar("fit-merl") as progress:
        count = len(merl.materials(networks))
        found = merl.fit_all(
            networks, published, lambda name, left: progress((count - left) / count, f"{name}, {left} left")
        )
    for line in merl.report(found):
        click.echo(line)
    click.echo(f"{len(found)} materials, {time.perf_counter() - began:.0f} s")
    if output is not None:
        with atomic(output) as temporary:
            Path(temporary).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


@click.command("tabulate")
@click.argument("fit_file", metavar="FIT.json", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, metavar="T.h5", help="Where to write the table.")
def tabulate_command(fit_file: Path, output: Path) -> None:
    """Write a fitted or hand-written model as a table of 1-degree cells.

    The least a file must hold: {"model": "lambert", "lobes": [{"name": "lambert", "coefficients":
    {"albedo": {"R": 0.5}}}]}.
    """
    formats.check_target(output)
    model = Fit.load(fit_file)
    with progress_bar("tabulate") as progress:
        table = tabulate(model, progress=progress)
    for loss in table.save(output):
        click.echo(f"{output}: {loss}", err=True)


COMMANDS: tuple[click.Command, ...] = (fit_command, fit_merl_command, tabulate_command)
