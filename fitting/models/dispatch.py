"""One entry point for all lobes: kernels that branch on the integer kind, for the residual and the renderer.

The contract of directions, measures and the packed array `p` is in `fitting.models.contract`.
"""

from __future__ import annotations

import numpy as np

from fitting.models import (
    ashikhmin_shirley,
    cook_torrance,
    eon,
    hanrahan_krueger,
    lambert,
    modified_phong,
    oren_nayar,
    schlick,
    walter,
    ward,
)
from fitting.models.contract import VARIANTS
from gonio.core.jit import kernel

SIDE = 3
"""Most numbers a lobe needs of one direction alone."""

# Kernels take global integers and functions, not attributes of modules.
_VARIANTS = VARIANTS
_LAMBERT, _lambert_terms = lambert.FAMILY, lambert.terms
_cosine_sample, _cosine_pdf = lambert.sample, lambert.pdf
_OREN_NAYAR, _oren_nayar_terms, _oren_nayar_slopes = oren_nayar.FAMILY, oren_nayar.terms, oren_nayar.slopes
_eon_slopes, _ct_slopes, _as_slopes = eon.slopes, cook_torrance.slopes, ashikhmin_shirley.slopes
_ward_slopes, _schlick_slopes, _phong_slopes = ward.slopes, schlick.slopes, modified_phong.slopes
_walter_slopes, _hk_slopes = walter.slopes, hanrahan_krueger.slopes
_EON, _eon_terms, _eon_sample, _eon_pdf = eon.FAMILY, eon.terms, eon.sample, eon.pdf
_COOK_TORRANCE, _ct_terms = cook_torrance.FAMILY, cook_torrance.terms
_ct_sample, _ct_pdf = cook_torrance.sample, cook_torrance.pdf
_ct_side, _ct_terms_of_sides = cook_torrance.side, cook_torrance.terms_of_sides
_ASHIKHMIN_SHIRLEY, _as_terms = ashikhmin_shirley.FAMILY, ashikhmin_shirley.terms
_as_sample, _as_pdf = ashikhmin_shirley.sample, ashikhmin_shirley.pdf
_AS_DIFFUSE = ashikhmin_shirley.DIFFUSE.kind
_WARD, _ward_terms, _ward_sample, _ward_pdf = ward.FAMILY, ward.terms, ward.sample, ward.pdf
_SCHLICK, _schlick_terms = schlick.FAMILY, schlick.terms
_schlick_sample, _schlick_pdf = schlick.sample, schlick.pdf
_PHONG, _phong_terms = modified_phong.FAMILY, modified_phong.terms
_phong_sample, _phong_pdf = modified_phong.sample, modified_phong.pdf
_WALTER, _walter_terms = walter.FAMILY, walter.terms
_walter_sample, _walter_pdf = walter.sample, walter.pdf
_HANRAHAN_KRUEGER, _hk_terms = hanrahan_krueger.FAMILY, hanrahan_krueger.terms


@kernel(allocates=False)
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
        Both 0 unless both directions are above the horizon or the lobe transmits, and for an unknown kind.
    """
    family, variant = kind // _VARIANTS, kind % _VARIANTS
    if family == _WALTER:
        return _walter_terms(variant, p, wi, wo)
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0, 0.0
    if family == _LAMBERT:
        return _lambert_terms(p, wi, wo)
    if family == _COOK_TORRANCE:
        return _ct_terms(variant, p, wi, wo)
    if family == _OREN_NAYAR:
        return _oren_nayar_terms(variant, p, wi, wo)
    if family == _EON:
        return _eon_terms(p, wi, wo)
    if family == _ASHIKHMIN_SHIRLEY:
        return _as_terms(variant, p, wi, wo)
    if family == _WARD:
        return _ward_terms(variant, p, wi, wo)
    if family == _SCHLICK:
        return _schlick_terms(variant, p, wi, wo)
    if family == _PHONG:
        return _phong_terms(p, wi, wo)
    if family == _HANRAHAN_KRUEGER:
        return _hk_terms(p, wi, wo)
    return 0.0, 0.0


@kernel(allocates=False)
def lobe_side(kind, p, tangents, w, out):
    """What a lobe needs of one direction alone, once for many pairs of directions that share it.

    Parameters
    ----------
    kind, p, tangents
        As `lobe_slopes`; without rows where no derivatives are needed.
    w : tuple of 3 float
    out : ndarray, shape (SIDE,)
        Set, where the lobe has such a thing.
    """
    if kind // _VARIANTS == _COOK_TORRANCE:
        _ct_side(kind % _VARIANTS, p, tangents, w, out)


@kernel(allocates=False)
def lobe_terms_of_sides(kind, p, wi, wo, side_i, side_o):
    """As `lobe_terms`, of what `lobe_side` gives of each direction; both above the horizon or at it."""
    if kind // _VARIANTS == _COOK_TORRANCE and wi[2] > 0.0 and wo[2] > 0.0:
        return _ct_terms_of_sides(kind % _VARIANTS, p, wi, wo, side_i[0], side_o[0])
    return lobe_terms(kind, p, wi, wo)


@kernel(allocates=False)
def lobe_slopes(kind, p, tangents, wi, wo, values, side_i, side_o, out):
    """Derivatives of the two terms of an isotropic lobe by its shape parameters, both directions above.

    Parameters
    ----------
    kind, p, wi, wo
        As `lobe_terms`.
    tangents : ndarray, shape (parameters, SIZE)
        `Lobe.tangents`.
    values : tuple of 2 float
        What `lobe_terms` returns.
    side_i, side_o : ndarray, shape (SIDE,)
        Of `lobe_side`, with derivatives.
    out : ndarray, shape (2 x parameters,) at least
        Number 2 j + t is set to the derivative of term t by parameter j.
    """
    family, variant = kind // _VARIANTS, kind % _VARIANTS
    if family == _COOK_TORRANCE:
        _ct_slopes(variant, p, tangents, wi, wo, values, side_i, side_o, out)
    elif family == _OREN_NAYAR:
        _oren_nayar_slopes(variant, p, wi, wo, values, out)
    elif family == _EON:
        _eon_slopes(p, wi, wo, out)
    elif family == _ASHIKHMIN_SHIRLEY:
        _as_slopes(p, wi, wo, values, out)
    elif family == _WARD:
        _ward_slopes(p, wi, wo, values, out)
    elif family == _SCHLICK:
        _schlick_slopes(p, wi, wo, out)
    elif family == _PHONG:
        _phong_slopes(p, wi, wo, values, out)
    elif family == _WALTER:
        _walter_slopes(variant, p, wi, wo, values, out)
    elif family == _HANRAHAN_KRUEGER:
        _hk_slopes(p, wi, wo, values, out)


@kernel(allocates=False)
def lobe_eval(kind, p, wi, wo):
    """The lobe's f_r in 1/sr, without cosine: p[0] x its first term + p[1] x its second; as `lobe_terms`."""
    first, second = lobe_terms(kind, p, wi, wo)
    return p[0] * first + p[1] * second


@kernel(allocates=False)
def lobe_sample(kind, p, wi, u0, u1):
    """A direction `wo` for light from `wi`, from two uniform numbers in (0, 1).

    Where `lobe_pdf` is 0, below the horizon of a lobe that does not transmit, it is a sample to be
    discarded. `wi` must be above the horizon, of such a lobe.
    """
    family, variant = kind // _VARIANTS, kind % _VARIANTS
    if family == _COOK_TORRANCE:
        return _ct_sample(variant, p, wi, u0, u1)
    if family == _EON:
        return _eon_sample(p, wi, u0, u1)
    if family == _ASHIKHMIN_SHIRLEY and kind != _AS_DIFFUSE:
        return _as_sample(variant, p, wi, u0, u1)
    if family == _WARD:
        return _ward_sample(variant, p, wi, u0, u1)
    if family == _SCHLICK:
        return _schlick_sample(variant, p, wi, u0, u1)
    if family == _PHONG:
        return _phong_sample(p, wi, u0, u1)
    if family == _WALTER:
        return _walter_sample(variant, p, wi, u0, u1)
    return _cosine_sample(p, wi, u0, u1)


@kernel(allocates=False)
def lobe_pdf(kind, p, wi, wo):
    """Density of `lobe_sample` at `wo`, 1/sr.

    0 unless both directions are above the horizon or the lobe transmits: it integrates to the share of
    samples that are of use.
    """
    family, variant = kind // _VARIANTS, kind % _VARIANTS
    if family == _WALTER:
        return _walter_pdf(variant, p, wi, wo)
    if wi[2] <= 0.0 or wo[2] <= 0.0:
        return 0.0
    if family == _COOK_TORRANCE:
        return _ct_pdf(variant, p, wi, wo)
    if family == _EON:
        return _eon_pdf(p, wi, wo)
    if family == _ASHIKHMIN_SHIRLEY and kind != _AS_DIFFUSE:
        return _as_pdf(variant, p, wi, wo)
    if family == _WARD:
        return _ward_pdf(variant, p, wi, wo)
    if family == _SCHLICK:
        return _schlick_pdf(variant, p, wi, wo)
    if family == _PHONG:
        return _phong_pdf(p, wi, wo)
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
