"""One entry point for all lobes: kernels that branch on the integer kind, for the residual and the renderer.

The contract of directions, measures and the packed array `p` is in `fitting.models.contract`.
"""

from __future__ import annotations

import numpy as np

from fitting.models import ashikhmin_shirley, cook_torrance, lambert, oren_nayar
from gonio.core.jit import kernel

# Kernels take global integers and functions, not attributes of objects.
_LAMBERT = lambert.LOBE.kind
_OREN_NAYAR = oren_nayar.LOBE.kind
_BECKMANN = cook_torrance.BECKMANN.kind
_GGX = cook_torrance.GGX.kind
_V_CAVITY = cook_torrance.V_CAVITY.kind
_AS_SPECULAR = ashikhmin_shirley.SPECULAR.kind
_AS_DIFFUSE = ashikhmin_shirley.DIFFUSE.kind

_lambert_terms, _cosine_sample, _cosine_pdf = lambert.terms, lambert.sample, lambert.pdf
_oren_nayar_terms = oren_nayar.terms
_beckmann_terms, _ggx_terms = cook_torrance.beckmann_terms, cook_torrance.ggx_terms
_v_cavity_terms = cook_torrance.v_cavity_terms
_ggx_sample, _ggx_pdf = cook_torrance.sample, cook_torrance.pdf
_as_terms, _as_diffuse_terms = ashikhmin_shirley.terms, ashikhmin_shirley.diffuse_terms
_as_sample, _as_pdf = ashikhmin_shirley.sample, ashikhmin_shirley.pdf


@kernel
def lobe_terms(kind, p, wi, wo):
    """The lobe's two terms, 1/sr, without the weights p[0] and p[1].

    Parameters
    ----------
    kind : int
        `Lobe.kind`.
    p : ndarray, shape (SIZE,)
        Packed lobe.
    wi, wo : tuple of 3 float
        To the light and to the detector, local frame.

    Returns
    -------
    tuple of 2 float
        Both 0 unless both directions are above the horizon, and for an unknown kind.
    """
    if kind == _LAMBERT:
        return _lambert_terms(p, wi, wo)
    if kind == _OREN_NAYAR:
        return _oren_nayar_terms(p, wi, wo)
    if kind == _BECKMANN:
        return _beckmann_terms(p, wi, wo)
    if kind == _GGX:
        return _ggx_terms(p, wi, wo)
    if kind == _V_CAVITY:
        return _v_cavity_terms(p, wi, wo)
    if kind == _AS_SPECULAR:
        return _as_terms(p, wi, wo)
    if kind == _AS_DIFFUSE:
        return _as_diffuse_terms(p, wi, wo)
    return 0.0, 0.0


@kernel
def lobe_eval(kind, p, wi, wo):
    """The lobe's f_r in 1/sr, without cosine: p[0] x its first term + p[1] x its second; as `lobe_terms`."""
    first, second = lobe_terms(kind, p, wi, wo)
    return p[0] * first + p[1] * second


@kernel
def lobe_sample(kind, p, wi, u0, u1):
    """A direction `wo` for light from `wi`, from two uniform numbers in (0, 1).

    It may fall below the horizon, where lobe and density are 0: a sample to be discarded. `wi` must be
    above it.
    """
    if kind in (_BECKMANN, _GGX, _V_CAVITY):
        return _ggx_sample(p, wi, u0, u1)
    if kind == _AS_SPECULAR:
        return _as_sample(p, wi, u0, u1)
    return _cosine_sample(p, wi, u0, u1)


@kernel
def lobe_pdf(kind, p, wi, wo):
    """Density of `lobe_sample` at `wo`, 1/sr.

    0 unless both directions are above the horizon: it integrates to the share of samples that are.
    """
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0
    if kind in (_BECKMANN, _GGX, _V_CAVITY):
        return _ggx_pdf(p, wi, wo)
    if kind == _AS_SPECULAR:
        return _as_pdf(p, wi, wo)
    return _cosine_pdf(p, wi, wo)


@kernel
def eval_many(kind, p, wi, wo):
    """`lobe_eval` for arrays of directions, shape (N, 3) each; returns shape (N,)."""
    out = np.empty(len(wo))
    for n in range(len(wo)):
        out[n] = lobe_eval(kind, p, (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2]))
    return out


@kernel
def sample_many(kind, p, wi, u):
    """`lobe_sample` for arrays, `wi` of shape (N, 3) and `u` of shape (N, 2); returns `wo`, shape (N, 3)."""
    out = np.empty((len(wi), 3))
    for n in range(len(wi)):
        out[n, 0], out[n, 1], out[n, 2] = lobe_sample(
            kind, p, (wi[n, 0], wi[n, 1], wi[n, 2]), u[n, 0], u[n, 1]
        )
    return out


@kernel
def pdf_many(kind, p, wi, wo):
    """`lobe_pdf` for arrays of directions, shape (N, 3) each; returns shape (N,)."""
    out = np.empty(len(wo))
    for n in range(len(wo)):
        out[n] = lobe_pdf(kind, p, (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2]))
    return out
