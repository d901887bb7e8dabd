"""The instrument: traces a specimen, estimates its BRDF and keeps it as a table."""

from gonio.table.table import Table
from gonio.trace.measure import measure

__all__ = ["Table", "measure"]
