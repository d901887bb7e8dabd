"""A table's report: one HTML file with everything in it, to look at and to send."""

from __future__ import annotations

import html
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from fitting.result import Fit
from gonio.files import atomic
from gonio.progress import Report
from gonio.table.anisotropic import AnisotropicTable
from gonio.table.checks import check
from gonio.table.checks.anisotropic import check_anisotropic
from gonio.table.checks.report import CheckReport
from gonio.table.parts import TRANSMISSION, orders_of
from gonio.table.table import Table
from renderer import anisotropic_plots, part_plots, plots
from renderer.page import figure_html, rows_html
from renderer.specimen_section import specimen_html

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; } td, th { padding: .15em .8em; text-align: right; }
th { border-bottom: 1px solid #999; font-weight: 600; } td:first-child, th:first-child { text-align: left; }
img { max-width: 100%; } pre { background: #f4f4f4; padding: .8em; overflow-x: auto; }
.fail { color: #b00; font-weight: 600; }
.pictures { display: flex; flex-wrap: wrap; gap: 1em 2em; } figure { margin: 0; width: 480px; max-width: 100%; }
figcaption { font-size: 13px; color: #555; }
.bar { background: #7d99b5; height: .7em; min-width: 1px; }
"""

Section = tuple[str, str]


def write_report(
    table: Table | AnisotropicTable, path: str | os.PathLike[str], fits: Mapping[str, Fit] | None = None,
    extra: Sequence[Section] = (), title: str = "", overlays: Mapping[str, Table] | None = None,
    folder: str | os.PathLike[str] = ".", progress: Report | None = None,
) -> None:  # fmt: skip
    """Write the report of a table and of fits to it.

    Parameters
    ----------
    table : Table or AnisotropicTable
    path : path
        The HTML file.
    fits : mapping of str to Fit, optional
        By the name to show; of an isotropic table.
    extra : sequence of (str, str)
        More sections: heading and HTML, shown first.
    title : str, optional
        Default: the specimen's name.
    overlays : mapping of str to Table, optional
        What the plots show beside the table; default: the fits as tables.
    folder : path, optional
        What files named in the specimen are relative to.
    progress : callable, optional
        Called before each section.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    fits = fits or {}
    name = title or str(table.provenance.get("name", "BRDF table"))
    if overlays is None:
        overlays = {label: plots.overlay(fit) for label, fit in fits.items()}
    sections = list(extra)
    builders = _sections(table, fits, overlays, Path(folder))
    for number, (heading, build) in enumerate(builders):
        if progress is not None:
            progress(number / len(builders), heading)
        sections.append((heading, build()))
    body = "\n".join(f"<h2>{html.escape(heading)}</h2>\n{content}" for heading, content in sections)
    page = (
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{html.escape(name)}</title>'
        f"<style>{_STYLE}</style>\n<h1>{html.escape(name)}</h1>\n{body}\n</html>\n"
    )
    with atomic(path) as temporary:
        Path(temporary).write_text(page, encoding="utf-8")


def _sections(
    table: Table | AnisotropicTable, fits: Mapping[str, Fit], overlays: Mapping[str, Table], folder: Path
) -> list[tuple[str, Callable[[], str]]]:
    """Headings of the sections that this table has, and what writes each."""
    text = table.provenance.get("specimen")
    sections: list[tuple[str, Callable[[], str]]] = []
    if text is not None:
        sections.append(("Surface", lambda: specimen_html(str(text), folder)))
    sections.append(("Measurement", lambda: _measurement(table)))
    if isinstance(table, AnisotropicTable):
        sections += _anisotropic_sections(table)
    else:
        sections += _isotropic_sections(table, fits, overlays)
    if text is not None:
        sections.append(("Specimen", lambda: f"<pre>{html.escape(str(text))}</pre>"))
    return sections


def _isotropic_sections(
    table: Table, fits: Mapping[str, Fit], overlays: Mapping[str, Table]
) -> list[tuple[str, Callable[[], str]]]:
    sections: list[tuple[str, Callable[[], str]]] = []
    if table.ledger.get("paths", 0) or TRANSMISSION in table.parts:
        sections.append(("Where the light went", lambda: _energy(table)))
    sections.append(("Checks", lambda: _checks(check(table))))
    sections.append(("Lobes in the plane of incidence", lambda: _lobes(table, overlays)))
    if any(orders_of(part) for part in _hemispheres(table).values()):
        sections.append(("By number of bounces", lambda: _orders(table)))
    sections.append(("Directional albedo", lambda: figure_html(plots.albedo(table, overlays))))
    sections.append(("Hemisphere", lambda: _hemisphere(table)))
    if fits:
        sections.append(("Fits", lambda: _fits(fits)))
    return sections


def _anisotropic_sections(table: AnisotropicTable) -> list[tuple[str, Callable[[], str]]]:
    return [
        ("Where the light went", lambda: _ledger(table.ledger)),
        ("Checks", lambda: _checks(check_anisotropic(table))),
        ("Hemisphere", lambda: figure_html(anisotropic_plots.hemispheres(table))),
        ("Lobes in the plane of incidence", lambda: figure_html(anisotropic_plots.lobes(table))),
        ("Directional albedo", lambda: figure_html(anisotropic_plots.albedo(table))),
    ]


def _hemispheres(table: Table) -> dict[str, Table]:
    """Light that was reflected, and that was transmitted if there is any."""
    both = {"Reflected": table}
    if TRANSMISSION in table.parts:
        both["Transmitted"] = table.parts[TRANSMISSION]
    return both


def _lobes(table: Table, overlays: Mapping[str, Table]) -> str:
    return _titled(
        {
            side: figure_html(
                plots.lobes(part, overlays if part is table else {}, transmitted=part is not table)
            )
            for side, part in _hemispheres(table).items()
        }
    )


def _hemisphere(table: Table) -> str:
    return _titled(
        {
            side: figure_html(plots.hemisphere(part, transmitted=part is not table))
            for side, part in _hemispheres(table).items()
        }
    )


def _orders(table: Table) -> str:
    return _titled(
        {
            side: figure_html(part_plots.orders_albedo(part, part is not table))
            + figure_html(part_plots.orders_lobes(part, transmitted=part is not table))
            for side, part in _hemispheres(table).items()
            if orders_of(part)
        }
    )


def _titled(sides: Mapping[str, str]) -> str:
    """What is reflected needs no title where nothing is transmitted."""
    if len(sides) == 1:
        return "".join(sides.values())
    return "".join(f"<h3>{side}</h3>{content}" for side, content in sides.items())


def _measurement(table: Table | AnisotropicTable) -> str:
    facts = table.provenance
    cells = table.energy if isinstance(table, AnisotropicTable) else table.values
    rows: list[tuple[str, str]] = [("cells", " x ".join(map(str, cells.shape)))]
    if "paths_per_second" in facts:
        rows += [
            ("paths", f"{facts['paths'] / 1e6:.2f} M in {facts['batches']} batches"),
            ("realisations of the surface", str(facts["realisations"])),
            ("time", f"{facts['seconds']:.1f} s, {facts['paths_per_second'] / 1e6:.2f} M paths/s"),
            ("estimator", facts["estimator"]),
            ("alpha, measured on the facets", f"{facts['surface']['alpha']:.4f}"),
            ("rms height, measured", f"{facts['surface']['rms_height'] * 1e6:.4g} um"),
        ]
        if facts["figure_of_merit"] is not None:
            merit = f"{facts['figure_of_merit']:.3g} per relative variance and second"
            rows.append(("figure of merit", merit))
    one = facts.get("one_realisation")
    return rows_html(("", ""), rows) + (f"<p>One realisation: {one}.</p>" if one else "")


def _energy(table: Table) -> str:
    """The ledger with a bar for each share, and what becomes of the light over theta_i."""
    figure = figure_html(part_plots.energy(table)) if TRANSMISSION in table.parts else ""
    return _ledger(table.ledger) + figure


def _ledger(ledger: Mapping[str, float]) -> str:
    paths = ledger.get("paths", 0)
    if not paths:
        return ""
    inner = [name for name, energy in ledger.items() if name.startswith("absorbed: ") and energy]
    rows = []
    for name in (name for name in ledger if name != "paths" and not name.startswith("absorbed: ")):
        rows.append(_bar(name, ledger[name] / paths, 0.8))
        if name == "absorbed":
            rows += [_bar(i.removeprefix("absorbed: "), ledger[i] / paths, 2.3) for i in inner]
    head = "<tr><th>all rows together, mean of the channels</th><th>energy</th><th></th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _bar(what: str, share: float, indent: float) -> str:
    return (
        f'<tr><td style="padding-left: {indent}em">{html.escape(what)}</td><td>{share:.4%}</td>'
        f'<td style="width: 20em"><div class="bar" style="width: {max(share, 0.0):.3%}"></div></td></tr>'
    )


def _checks(report: CheckReport) -> str:
    verdict = "all passed" if report.passed else '<span class="fail">failed</span>'
    return f"<p>{verdict}</p><pre>{html.escape(chr(10).join(report.lines()))}</pre>"


def _fits(fits: Mapping[str, Fit]) -> str:
    parts = []
    metrics = sorted({m for fit in fits.values() for m in fit.residuals})
    parts.append(
        rows_html(
            ("fit", "minimised", *metrics, "evaluations", "s"),
            [
                (label, fit.objective, *(f"{fit.residuals.get(m, np.nan):.4g}" for m in metrics), fit.evaluations,
                 f"{fit.seconds:.2f}")
                for label, fit in fits.items()
            ],
        )
    )  # fmt: skip
    for label, fit in fits.items():
        rows = []
        for lobe in fit.lobes:
            rows += [(lobe.name, name, f"{value:.6g}") for name, value in lobe.parameters.items()]
            for name, channels in lobe.coefficients.items():
                rows.append((lobe.name, name, ", ".join(f"{c} {v:.5g}" for c, v in channels.items())))
        parts.append(f"<h3>{html.escape(label)}</h3>" + rows_html(("lobe", "parameter", "value"), rows))
        parts += [f"<p>{html.escape(note)}</p>" for note in fit.notes]
    return "".join(parts)
