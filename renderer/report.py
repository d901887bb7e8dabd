"""A table's report: one HTML file with everything in it, to look at and to send."""

from __future__ import annotations

import base64
import html
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fitting.result import Fit
from gonio.files import atomic
from gonio.table.checks import check
from gonio.table.table import Table
from renderer import plots

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; } td, th { padding: .15em .8em; text-align: right; }
th { border-bottom: 1px solid #999; font-weight: 600; } td:first-child, th:first-child { text-align: left; }
img { max-width: 100%; } pre { background: #f4f4f4; padding: .8em; overflow-x: auto; }
.fail { color: #b00; font-weight: 600; }
"""

Section = tuple[str, str]


def write_report(
    table: Table, path: str | os.PathLike[str], fits: Mapping[str, Fit] | None = None,
    extra: Sequence[Section] = (), title: str = "",
) -> None:  # fmt: skip
    """Write the report of a table and of fits to it.

    Parameters
    ----------
    table : Table
    path : path
        The HTML file.
    fits : mapping of str to Fit, optional
        By the name to show.
    extra : sequence of (str, str)
        More sections: heading and HTML, shown first.
    title : str, optional
        Default: the specimen's name.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    fits = fits or {}
    name = title or str(table.provenance.get("name", "BRDF table"))
    overlays = {label: fit.table(table) for label, fit in fits.items()}
    sections = [
        *extra,
        ("Measurement", _measurement(table)),
        ("Checks", _checks(table)),
        ("Lobes in the plane of incidence", figure_html(plots.lobes(table, overlays))),
        ("Directional albedo", figure_html(plots.albedo(table, overlays))),
        ("Hemisphere", figure_html(plots.hemisphere(table))),
    ]
    if fits:
        sections.append(("Fits", _fits(fits)))
    if "specimen" in table.provenance:
        sections.append(("Specimen", f"<pre>{html.escape(str(table.provenance['specimen']))}</pre>"))
    body = "\n".join(f"<h2>{html.escape(heading)}</h2>\n{content}" for heading, content in sections)
    page = (
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{html.escape(name)}</title>'
        f"<style>{_STYLE}</style>\n<h1>{html.escape(name)}</h1>\n{body}\n</html>\n"
    )
    with atomic(path) as temporary:
        Path(temporary).write_text(page, encoding="utf-8")


def figure_html(figure: Figure) -> str:
    """A matplotlib figure as an image that stands in the page itself."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110, format="png")
    return image_html(buffer.getvalue())


def image_html(png: bytes) -> str:
    """A PNG's bytes as an image that stands in the page itself."""
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def rows_html(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """An HTML table of text."""
    cells = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{body}</table>"


def _measurement(table: Table) -> str:
    facts = table.provenance
    rows: list[tuple[str, str]] = [("cells", " x ".join(map(str, table.values.shape)))]
    if "paths_per_second" in facts:
        rows += [
            ("paths", f"{facts['paths'] / 1e6:.2f} M in {facts['batches']} batches"),
            ("realisations of the surface", str(facts["realisations"])),
            ("time", f"{facts['seconds']:.1f} s, {facts['paths_per_second'] / 1e6:.2f} M paths/s"),
            ("figure of merit", f"{facts['figure_of_merit']:.3g} per relative variance and second"),
            ("alpha, measured on the facets", f"{facts['surface']['alpha']:.4f}"),
            ("rms height, measured", f"{facts['surface']['rms_height'] * 1e6:.4g} um"),
        ]
    paths = table.ledger.get("paths", 0)
    rows += [(f"ledger: {k}", f"{v:.6g} ({v / paths:.4%})") for k, v in table.ledger.items() if paths]
    single = facts.get("realisations") == 1 and facts.get("surface", {}).get("alpha", 0) > 0
    note = (
        "<p>The surface is one fixed piece: error bars hold the noise of the rays on it, not how another "
        "piece of the same finish would differ.</p>"
        if single
        else ""
    )
    return rows_html(("", ""), rows) + note


def _checks(table: Table) -> str:
    report = check(table)
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
