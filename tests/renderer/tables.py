"""Tables with parts, made by hand."""

from gonio.table.table import Table
from tests.renderer.scenes import lambert_table


def with_parts(reflected=(0.2, 0.1, 0.05), transmitted=(0.15, 0.1), delta=0.08, **fields) -> Table:
    """Lambertian light by number of bounces, and of it a delta term in the first part transmitted.

    Shares of each number of bounces, of what is reflected and of what is transmitted without its delta term.
    """

    def parts(shares, speculars):
        names = [*(f"L{n}" for n in range(1, len(shares))), f"L{len(shares)}+"]
        tables = [lambert_table(a, specular=s) for a, s in zip(shares, speculars, strict=True)]
        return dict(zip(names, tables, strict=True))

    below = lambert_table(sum(transmitted), specular=delta).replace(
        parts=parts(transmitted, [delta] + [0.0] * (len(transmitted) - 1))
    )
    above = lambert_table(sum(reflected))
    return above.replace(parts={"transmission": below, **parts(reflected, [0.0] * len(reflected))}, **fields)
