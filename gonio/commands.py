"""The instrument's commands: trace, info, check, compress, convert, bench."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

import click

from gonio import formats
from gonio.interrupt import uninterrupted
from gonio.progress import progress_bar
from gonio.summary import anisotropic_summary, anisotropic_summary_text, summary, summary_text
from gonio.table.table import Table
from gonio.trace.checkpoint import EVERY, Checkpoint
from gonio.trace.estimators import ESTIMATORS

_PATH = click.Path(path_type=Path)
_OUT = click.option("-o", "--out", required=True, type=_PATH, help="File to write.")
_JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")


@click.command()
@click.argument("spec", type=_PATH)
@_OUT
@click.option(
    "--rays", type=int, help="Paths to trace over all rows (default 20 million; next-event 2 million)."
)
@click.option("--time", "seconds", type=float, help="Trace for so many seconds instead.")
@click.option(
    "--target-error",
    type=float,
    help="Go on until the relative standard error of the cells that hold 99 % of the light is below this, and "
    "the albedo's below a tenth of it; or until --rays or --time is spent.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Same seed, same bits.")
@click.option("--threads", type=int, help="Default: all processors. Does not change the result.")
@click.option(
    "--estimator",
    type=click.Choice(ESTIMATORS),
    help="Default: the best that applies. analog bins every path, and does for all specimens.",
)
@click.option("--resume", is_flag=True, help="Go on from OUT.checkpoint, if an unfinished run left one.")
@click.option(
    "--checkpoint",
    "every",
    type=float,
    default=EVERY,
    show_default=True,
    help="Seconds between checkpoints; 0 for none.",
)
@click.option("--dask", metavar="ADDR", help="Let the workers of this dask scheduler trace the batches.")
def trace(
    spec: Path,
    out: Path,
    rays: int | None,
    seconds: float | None,
    target_error: float | None,
    seed: int,
    threads: int | None,
    estimator: str | None,
    resume: bool,
    every: float,
    dask: str | None,
) -> None:
    """Trace the specimen SPEC (a TOML file) to a BRDF table.

    Ctrl-C stops early and saves what has been traced. What is not complete, because of Ctrl-C or of worse,
    goes on with --resume, to the same table bit for bit.
    """
    from gonio.trace.measure import run, start
    from microgeometry.specimen import load_specimen

    formats.check_target(out)
    specimen = load_specimen(spec)
    if specimen.grid.anisotropic:
        formats.check_anisotropic_target(out)
    measurement = start(specimen, rays, seconds, seed, threads, target_error, estimator)
    checkpoint = Checkpoint(out, measurement, every)
    if checkpoint.begin(resume):
        click.echo(f"gonio: going on after {measurement.tally.batches} batches", err=True)
    elif resume:
        click.echo(f"gonio: no {checkpoint.path}: starting anew", err=True)
    interrupted = False
    with progress_bar(f"trace {spec.name}") as report:
        try:
            run(measurement, seconds, report, checkpoint, dask)
        except KeyboardInterrupt:
            if measurement.tally.batches == 0:
                raise
            interrupted = True
    with uninterrupted():
        if interrupted and every:
            checkpoint.save()
        table = measurement.table()
        command = " ".join(["gonio", *sys.argv[1:]])
        table = table.replace(provenance={**table.provenance, "command": command, "interrupted": interrupted})
        formats.write(table, out)
        if not interrupted:
            checkpoint.remove()
    click.echo(_one_line(table, out))
    if one := table.provenance.get("one_realisation"):
        click.echo(f"one realisation: {one}")
    if target_error is not None:
        met = "met" if table.provenance["target_met"] else "NOT met"
        click.echo(f"target {met}: {table.provenance['target_reached']}")
    if interrupted:
        planned = measurement.planned_batches
        of = "" if planned is None else f" of {planned}"
        further = "; --resume goes on" if every else ""
        click.echo(
            f"gonio: interrupted after {measurement.tally.batches}{of} batches; {out} holds what they gave{further}",
            err=True,
        )
        raise click.exceptions.Exit(130)


@click.command()
@click.argument("table", type=_PATH)
@_JSON
def info(table: Path, as_json: bool) -> None:
    """Say what is in a table: grid, channels, albedo, error bars, parts, ledger, provenance."""
    content = formats.read_any(table)
    if isinstance(content, Table):
        data = summary(content, table)
        text = summary_text(data)
    else:
        data = anisotropic_summary(content, table)
        text = anisotropic_summary_text(data)
    click.echo(json.dumps(data) if as_json else text)


@click.command()
@click.argument("table", type=_PATH)
@_JSON
def check(table: Path, as_json: bool) -> None:
    """Check a table: reciprocity, energy, parts, positivity, noise. Exit status 1 if it fails.

    Ends with a map of the noise, where the table has error bars; --json holds it too, and the energy of every
    theta_i.
    """
    from gonio.table.checks import check as run_checks
    from gonio.table.checks import noise_lines
    from gonio.table.checks.anisotropic import check_anisotropic

    content = formats.read_any(table)
    if isinstance(content, Table):
        report = run_checks(content)
        lines = report.lines() if content.std_error is None else [*report.lines(), *noise_lines(content)]
    else:
        report = check_anisotropic(content)
        lines = report.lines()
    click.echo(json.dumps(report.to_json()) if as_json else "\n".join(lines))
    if not report.passed:
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("table", type=_PATH)
@_OUT
@click.option(
    "--max-error",
    type=float,
    default=0.01,
    show_default=True,
    help="Largest relative error of any row and channel: cosine-weighted RMS of the cells, and albedo.",
)
@click.option(
    "--method", default="auto", show_default=True, help="Or one of those it names when it does not know one."
)
@_JSON
def compress(table: Path, out: Path, max_error: float, method: str, as_json: bool) -> None:
    """Compress a table and its parts within a bound on their error, and not below their own noise.

    By default all methods are tried quickly and the smallest is used.
    """
    from gonio.table.compress import compress as run_compression

    formats.check_target(out)
    report = run_compression(formats.read(table), out, max_error, method)
    if as_json:
        click.echo(json.dumps(asdict(report)))
        return
    click.echo(
        f"{out}: {report.method}, {report.bytes / 1e3:.0f} kB, {report.ratio:.0f}:1 against float32; error of a row "
        f"{report.error_median:.4f} (median), {report.error_worst:.4f} (worst); asked {report.max_error:g}, "
        f"the table's own noise {report.noise_median:.4f} (median), {report.noise_worst:.4f} (worst)"
    )


@click.command()
@click.argument("source", type=_PATH)
@click.argument("target", type=_PATH)
@click.option(
    "--part",
    help="Write only this part of the table, as a table of its own: transmission, or by number of bounces "
    "L1, transmission/L1, ...; `gonio info` names them.",
)
def convert(source: Path, target: Path, part: str | None) -> None:
    """Convert a table between formats, chosen by suffix.

    \b
    In and out:
      .h5          our own; keeps everything
      .binary      MERL
      .bsdf        RGL tensor file; .zemax.bsdf writes Zemax text (content tells them apart in reading)
      .xml         WINDOW/Radiance, Klems matrix; .tree.xml writes an isotropic tensor tree
      .csv, .npz   cells with error bars
    In only:
      .astm        ASTM E1392
      .csv         the plane of incidence (Incident_angle, Measure_angle, wavelengths)
      .brdf, .anisotropicbsdf  SPEOS
      .bsdf        LightTools
      .xompt       OpenMATERIAL 3D

    Says what is lost, and how far the file written, read again, is from the table.
    """  # noqa: D301
    done = formats.convert(source, target, part)
    click.echo(f"{target}: written" + "".join(f"\n  lost: {what}" for what in done.lost))
    if done.worst > 0:
        click.echo(
            f"  error: a row's cosine-weighted RMS {done.error:.2g} (median), {done.worst:.2g} (worst); "
            f"directional albedo {done.albedo_error:.2g} (mean)"
        )


@click.command()
@click.argument("names", nargs=-1)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
def bench(names: tuple[str, ...], as_json: bool) -> None:
    """Measure speed against error, as ratios within one run. NAMES default to all benchmarks."""
    from gonio.bench import run_benchmarks

    results = run_benchmarks(names, (lambda line: None) if as_json else click.echo)
    if as_json:
        click.echo(json.dumps(results))


COMMANDS = (trace, info, check, compress, convert, bench)


def _one_line(table: Table, path: Path) -> str:
    p = table.provenance
    merit = p["figure_of_merit"]
    return (
        f"{path}: {p['paths'] / 1e6:.1f} M paths in {p['seconds']:.1f} s ({p['paths_per_second'] / 1e6:.2f} M/s), "
        f"{p['batches']} batches, albedo {table.row_albedo.mean():.4f} +- {table.albedo_std_error.max():.1e}"
        + ("" if merit is None else f", merit {merit:.3g} / (relative variance x s)")
    )
