"""The kernels of `gonio.table.interpolation` for arrays of directions."""

from __future__ import annotations

from gonio.core.jit import kernel
from gonio.table.interpolation import eval_table, pdf_table, sample_table
from gonio.table.row_quantities import albedo_table, specular_table


@kernel(allocates=False)
def eval_many(pool, t, wi, wo, out):
    """`eval_table` for arrays of directions, shape (N, 3), into `out`, shape (N, C)."""
    for n in range(len(wi)):
        eval_table(pool, t, (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2]), out[n])


@kernel(allocates=False)
def pdf_many(pool, t, wi, wo, out):
    """`pdf_table` for arrays of directions, shape (N, 3), into `out`, shape (N,)."""
    for n in range(len(wi)):
        out[n] = pdf_table(pool, t, (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2]))


@kernel(allocates=False)
def sample_many(pool, t, wi, uniforms, wo, pdf):
    """`sample_table` for arrays, `wi` and `uniforms` of shape (N, 3), into `wo` (N, 3) and `pdf` (N,)."""
    for n in range(len(wi)):
        direction, density = sample_table(
            pool, t, (wi[n, 0], wi[n, 1], wi[n, 2]), uniforms[n, 0], uniforms[n, 1], uniforms[n, 2]
        )
        wo[n, 0], wo[n, 1], wo[n, 2] = direction
        pdf[n] = density


@kernel(allocates=False)
def row_quantities_many(pool, t, cos_i, albedo, specular):
    """`albedo_table` and `specular_table` for cosines of shape (N,), into arrays of shape (N, C)."""
    for n in range(len(cos_i)):
        albedo_table(pool, t, cos_i[n], albedo[n])
        specular_table(pool, t, cos_i[n], specular[n])
