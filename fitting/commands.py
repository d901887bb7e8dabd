"""The command line of fitting: `gonio fit` and `gonio tabulate`."""

from __future__ import annotations

from pathlib import Path

import click

from fitting.fit import fit
from fitting.models import find_model
from fitting.result import Fit
from fitting.tabulate import tabulate
from gonio.progress import progress_bar
from gonio.table.table import Table

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.command("fit")
@click.argument("table", metavar="T", type=_FILE)
@click.option("--model", required=True, metavar="NAME", help="Which model; an unknown name lists them all.")
@click.option("-o", "--output", type=_FILE, metavar="FIT.json", help="Where to write the fit.")
@click.option("--json", "as_json", is_flag=True, help="Print the fit as one JSON object.")
def fit_command(table: Path, model: str, output: Path | None, as_json: bool) -> None:
    """Fit an analytic model to a table, weighted by its error bars where it has any.

    Angles above 80 degrees are left out.
    """
    find_model(model)  # before a long load
    with progress_bar("fit") as progress:
        result = fit(Table.load(table), model, progress=progress)
    if output is not None:
        result.save(output)
    if as_json:
        click.echo(result.dumps(indent=None))
        return
    for lobe in result.lobes:
        shape = ", ".join(f"{name} {value:.6g}" for name, value in lobe.parameters.items())
        click.echo(f"{lobe.name}{': ' + shape if shape else ''}")
        for name, by_channel in lobe.coefficients.items():
            click.echo(f"  {name}: " + ", ".join(f"{c} {v:.6g}" for c, v in by_channel.items()))
    click.echo(
        f"minimised {result.objective}; " + ", ".join(f"{k} {v:.4g}" for k, v in result.residuals.items())
    )
    if "chi2" in result.residuals and result.degrees_of_freedom:
        ratio = result.residuals["chi2"] / result.degrees_of_freedom
        click.echo(f"chi2 per degree of freedom {ratio:.3f}: near 1 where the model describes the table")
    left = ", ".join(f"{n} {reason}" for reason, n in result.cells_left_out.items()) or "none"
    click.echo(f"{result.cells_used} cells used; left out: {left}")
    energy = "at most 1" if result.albedo["conserves_energy"] else "above 1: the fit creates energy"
    click.echo(f"largest albedo {result.albedo['largest']:.4f}, {energy}")
    for note in result.notes:
        click.echo(f"note: {note}")
    click.echo(f"{result.evaluations} evaluations, {result.seconds:.2f} s")


@click.command("tabulate")
@click.argument("fit_file", metavar="FIT.json", type=_FILE)
@click.option("-o", "--output", type=_FILE, required=True, metavar="T.h5", help="Where to write the table.")
def tabulate_command(fit_file: Path, output: Path) -> None:
    """Write a fitted or hand-written model as a table of 1-degree cells.

    The least a file must hold: {"model": "lambert", "lobes": [{"name": "lambert", "coefficients":
    {"albedo": {"R": 0.5}}}]}.
    """
    model = Fit.load(fit_file)
    with progress_bar("tabulate") as progress:
        table = tabulate(model, progress=progress)
    for loss in table.save(output):
        click.echo(f"{output}: {loss}", err=True)


COMMANDS: tuple[click.Command, ...] = (fit_command, tabulate_command)
