"""The kernels that evaluate and sample tables, for arrays of directions.

They take the pool of an isotropic table and None, or None and that of an anisotropic one.
"""

from __future__ import annotations

from gonio.core.jit import kernel
from gonio.table.anisotropic_interpolation import (
    eval_anisotropic,
    pdf_anisotropic,
    row_quantities_anisotropic,
    sample_anisotropic,
)
from gonio.table.interpolation import eval_table, pdf_table, sample_table
from gonio.table.row_quantities import albedo_table, specular_table


@kernel(allocates=False)
def eval_many(plain, brushed, t, wi, wo, out):
    """BRDF for arrays of directions, shape (N, 3), into `out`, shape (N, C)."""
    for n in range(len(wi)):
        i, o = (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2])
        if plain is not None:
            eval_table(plain, t, i, o, out[n])
        if brushed is not None:
            eval_anisotropic(brushed, t, i, o, out[n])


@kernel(allocates=False)
def pdf_many(plain, brushed, t, wi, wo, out):
    """Density of samples for arrays of directions, shape (N, 3), into `out`, shape (N,)."""
    for n in range(len(wi)):
        i, o = (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2])
        if plain is not None:
            out[n] = pdf_table(plain, t, i, o)
        if brushed is not None:
            out[n] = pdf_anisotropic(brushed, t, i, o)


@kernel(allocates=False)
def sample_many(plain, brushed, t, wi, uniforms, wo, pdf):
    """Samples for arrays, `wi` and `uniforms` of shape (N, 3), into `wo` (N, 3) and `pdf` (N,)."""
    for n in range(len(wi)):
        i, u = (wi[n, 0], wi[n, 1], wi[n, 2]), (uniforms[n, 0], uniforms[n, 1], uniforms[n, 2])
        if plain is not None:
            wo[n], pdf[n] = sample_table(plain, t, i, u[0], u[1], u[2])
        if brushed is not None:
            wo[n], pdf[n] = sample_anisotropic(brushed, t, i, u[0], u[1], u[2])


@kernel(allocates=False)
def row_quantities_many(pool, t, cos_i, albedo, specular):
    """`albedo_table` and `specular_table` for cosines of shape (N,), into arrays of shape (N, C)."""
    for n in range(len(cos_i)):
        albedo_table(pool, t, cos_i[n], albedo[n])
        specular_table(pool, t, cos_i[n], specular[n])


@kernel(allocates=False)
def row_quantities_anisotropic_many(pool, t, wi, albedo, specular):
    """`row_quantities_anisotropic` for directions of shape (N, 3), into arrays of shape (N, C)."""
    for n in range(len(wi)):
        row_quantities_anisotropic(pool, t, (wi[n, 0], wi[n, 1], wi[n, 2]), albedo[n], specular[n])
