"""What a page is made of: figures, images and tables as HTML that stands in the page itself."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence

from matplotlib.figure import Figure


def figure_html(figure: Figure) -> str:
    """A matplotlib figure as an image."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110, format="png")
    return image_html(buffer.getvalue())


def image_html(png: bytes, alt: str = "") -> str:
    """A PNG's bytes as an image; `alt` says what it shows to those who cannot see it."""
    return f'<img alt="{html.escape(alt)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def rows_html(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """An HTML table of text."""
    cells = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{body}</table>"
