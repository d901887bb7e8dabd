"""What happens to light at one facet of a stack of layers: reflection, refraction, absorption, diffusion.

Light is a Stokes vector (I, Q, U, V) a wavelength, against a unit vector e across the path (see
`gonio.core.stokes`). It comes in along v and meets a facet whose unit normal n is turned against it. Facets
of glass reflect or transmit it, one of both, with the probability of their energies; at an interface that
disperses, transmitted light goes on as a single wavelength, drawn by energy, that carries it all.
"""

from __future__ import annotations

from gonio.core.directions import combine, cosine_hemisphere, dot, frame, unit
from gonio.core.films import film_amplitudes
from gonio.core.jit import kernel
from gonio.core.optics import fresnel_amplitudes, fresnel_transmission, refract
from gonio.core.philox import uniforms
from gonio.core.stokes import mueller, perpendicular, rotation
from gonio.table.interpolation import eval_table, sample_table
from gonio.table.row_quantities import albedo_table, specular_table
from gonio.trace.stack import BLACK, CLEAR, LAMBERT, MIRROR, TABLE

# Rows of `scratch`: what a sample's interface does. In reflection, then in transmission: |a_s|^2, |a_p|^2, and
# a_s conj(a_p); the intensities.
R_S, R_P, R_RE, R_IM, T_S, T_P, T_RE, T_IM, I_R, I_T, SCRATCH_ROWS = range(11)


@kernel(allocates=False)
def interact(
    facets, tables, media, share, polarised, layer, material, front, v, n, e, light, scratch, path, event, seed, batch
):  # fmt: skip
    """Turn light at a facet into what leaves it.

    Parameters
    ----------
    facets : Facets
    tables : Pool or None
    media : Media
    share : ndarray, shape (S,)
        As in `gonio.trace.stack.Stack`; what is drawn is drawn by energy as it counts in the channels.
    polarised : bool
        Whether Q, U and V are kept; else they stay 0.
    layer, material : int
        The facet's layer, and row of `facets` for its material.
    front : bool
        Whether light comes from above the layer.
    v, n, e : direction
        Where light goes, the facet's normal with v.n < 0, and the axis of its Stokes vectors.
    light : ndarray, shape (S, 4)
        Changed in place; what it loses is absorbed, or is made up for by other paths.
    scratch : ndarray, shape (SCRATCH_ROWS, S)
    path, event, seed, batch : int
        Key and counter of the random numbers.

    Returns
    -------
    v, e : direction
        Of the light that leaves; where none is left, as they were.
    crossed : bool
        Whether it goes on beyond the facet.
    specular : bool
        Whether its direction follows from v and n alone.
    """
    kind = facets.kind[material]
    if kind == BLACK:
        light[:, :] = 0.0
        return v, e, False, True
    u0, u1, u2, _ = uniforms(path, path >> 32, event, 1, seed, batch)
    if kind == LAMBERT:
        for s in range(light.shape[0]):
            light[s, 0] *= facets.albedo[material, s]
            light[s, 1:] = 0.0
        a, b, c = cosine_hemisphere(u0, u1)
        x, y = frame(n)
        w = combine(a, x, b, y, c, n)
        return w, perpendicular(w, n), False, False
    if tables is not None and kind == TABLE:
        u3, _, _, _ = uniforms(path, path >> 32, event, 3, seed, batch)
        return _tabulated(tables, facets.table[material], share, v, n, e, light, scratch, u0, u1, u2, u3)
    across = perpendicular(v, n)
    if polarised:
        turn(light, rotation(e, v, across))
    if kind == MIRROR:
        if polarised:  # a perfect conductor: r_s = -1, r_p = 1
            for s in range(light.shape[0]):
                light[s, 2], light[s, 3] = -light[s, 2], -light[s, 3]
        return _reflect(v, n), across, False, True
    reflected, transmitted = split(facets, media, share, layer, material, front, v, n, light, scratch)
    if reflected + transmitted <= 0.0:
        light[:, :] = 0.0
        return v, e, False, True
    chance = reflected / (reflected + transmitted) if kind == CLEAR else 1.0
    if u0 < chance:
        apply_amplitudes(light, scratch, R_S, 1.0 / chance, polarised)
        return _reflect(v, n), across, False, True
    eta_i = media.eta[layer if front else layer + 1]
    eta_t = media.eta[layer + 1 if front else layer]
    sample = _one_of_many(eta_i, eta_t, share, scratch, u1 * transmitted)
    if sample < 0:
        apply_amplitudes(light, scratch, T_S, 1.0 / (1.0 - chance), polarised)
        sample = 0
        while scratch[I_T, sample] <= 0.0:
            sample += 1
    else:
        gain = transmitted / (share[sample] * scratch[I_T, sample] * (1.0 - chance))
        for s in range(light.shape[0]):
            if s != sample:
                light[s, :] = 0.0
        apply_amplitudes(light, scratch, T_S, gain, polarised)
    w, cos_t = refract(v, n, eta_t[sample] / eta_i[sample])
    if cos_t == 0.0:  # rounding, at the critical angle
        light[:, :] = 0.0
    return w, across, True, True


@kernel(allocates=False)
def split(facets, media, share, layer, material, front, v, n, light, scratch):
    """What the interface does to each sample, into `scratch`; returns the energies reflected and transmitted."""
    cosine = min(1.0, -dot(v, n))
    clear = facets.kind[material] == CLEAR
    first, count = facets.film[material]
    if not front:
        first += count  # the films' mirror image follows them
    reflected = 0.0
    transmitted = 0.0
    for s in range(light.shape[0]):
        if light[s, 0] == 0.0:
            scratch[I_R, s] = 0.0
            scratch[I_T, s] = 0.0
            continue
        eta_i = media.eta[layer, s]
        eta_t, k_t = facets.eta_k[material, s]
        if not front:
            eta_i, eta_t = eta_t, eta_i
        if count > 0:
            r_s, r_p, t_s, t_p, cross = film_amplitudes(
                cosine, eta_i, facets.film_eta_k[s, first : first + count],
                facets.film_thickness[first : first + count], eta_t, k_t, facets.wavelength[s],
            )  # fmt: skip
        else:
            r_s, r_p = fresnel_amplitudes(cosine, eta_t / eta_i, k_t / eta_i)
        cross_r = r_s * r_p.conjugate()
        scratch[R_S, s] = r_s.real * r_s.real + r_s.imag * r_s.imag
        scratch[R_P, s] = r_p.real * r_p.real + r_p.imag * r_p.imag
        scratch[R_RE, s] = cross_r.real
        scratch[R_IM, s] = cross_r.imag
        scratch[I_R, s] = _intensity(light[s], scratch[R_S, s], scratch[R_P, s])
        reflected += share[s] * scratch[I_R, s]
        scratch[I_T, s] = 0.0
        if clear:
            if count == 0:
                t_s, t_p, cross_t = fresnel_transmission(cosine, eta_t / eta_i)
                cross = complex(cross_t, 0.0)
            scratch[T_S, s] = t_s
            scratch[T_P, s] = t_p
            scratch[T_RE, s] = cross.real
            scratch[T_IM, s] = cross.imag
            scratch[I_T, s] = max(0.0, _intensity(light[s], scratch[T_S, s], scratch[T_P, s]))
            transmitted += share[s] * scratch[I_T, s]
    return reflected, transmitted


@kernel(allocates=False)
def _one_of_many(eta_i, eta_t, share, scratch, threshold):
    """-1 if all samples refract alike; else one of them, drawn in proportion to its energy by a uniform threshold."""
    alike = True
    ratio = 0.0
    total = 0.0
    sample = -1
    for s in range(eta_i.shape[0]):
        intensity = scratch[I_T, s]
        if intensity <= 0.0:
            continue
        if ratio == 0.0:
            ratio = eta_t[s] / eta_i[s]
        alike = alike and eta_t[s] / eta_i[s] == ratio
        if total <= threshold:
            sample = s
        total += share[s] * intensity
    return -1 if alike else sample


@kernel(allocates=False)
def _tabulated(tables, t, share, v, n, e, light, scratch, u0, u1, u2, u3):
    """Reflection by a table: its delta term or a direction drawn from it. It depolarises."""
    x, y = frame(n)
    wi = (-dot(v, x), -dot(v, y), -dot(v, n))
    delta, diffuse, f = scratch[0], scratch[1], scratch[2]
    specular_table(tables, t, wi[2], delta)
    albedo_table(tables, t, wi[2], diffuse)
    mirrored = 0.0
    scattered = 0.0
    for s in range(light.shape[0]):
        light[s, 1:] = 0.0
        mirrored += share[s] * light[s, 0] * delta[s]
        scattered += share[s] * light[s, 0] * diffuse[s]
    chance = mirrored / (mirrored + scattered) if mirrored > 0.0 else 0.0
    if u3 < chance:
        for s in range(light.shape[0]):
            light[s, 0] *= delta[s] / chance
        w = _reflect(v, n)
        return w, perpendicular(w, n), False, True
    wo, pdf = sample_table(tables, t, wi, u0, u1, u2)
    if pdf <= 0.0:
        light[:, :] = 0.0
        return v, e, False, True
    eval_table(tables, t, wi, wo, f)
    for s in range(light.shape[0]):
        light[s, 0] *= f[s] * wo[2] / (pdf * (1.0 - chance))
    w = combine(wo[0], x, wo[1], y, wo[2], n)
    return w, perpendicular(w, n), False, False


@kernel(allocates=False)
def _reflect(v, n):
    return unit(combine(1.0, v, -2.0 * dot(v, n), n, 0.0, n))


@kernel(allocates=False)
def scale(stokes, factor):
    """Multiply a Stokes vector."""
    for i in range(4):
        stokes[i] *= factor


@kernel(allocates=False)
def turn(light, double_angle):
    """Refer Q and U of every sample to an axis turned by half the double angle, given as (cos, sin)."""
    c, s = double_angle
    for i in range(light.shape[0]):
        q, u = light[i, 1], light[i, 2]
        light[i, 1] = c * q + s * u
        light[i, 2] = c * u - s * q


@kernel(allocates=False)
def _intensity(stokes, a_s2, a_p2):
    return 0.5 * ((a_s2 + a_p2) * stokes[0] + (a_s2 - a_p2) * stokes[1])


@kernel(allocates=False)
def apply_amplitudes(light, scratch, first, gain, polarised):
    """Reflect (first = R_S) or transmit (T_S) every sample, and multiply by `gain`."""
    for s in range(light.shape[0]):
        if light[s, 0] == 0.0:
            continue
        a_s2, a_p2 = scratch[first, s], scratch[first + 1, s]
        if not polarised:
            light[s, 0] *= 0.5 * gain * (a_s2 + a_p2)
            continue
        cross = complex(scratch[first + 2, s], scratch[first + 3, s])
        i, q, u, v = mueller(light[s, 0], light[s, 1], light[s, 2], light[s, 3], a_s2, a_p2, cross)
        light[s, 0], light[s, 1], light[s, 2], light[s, 3] = gain * i, gain * q, gain * u, gain * v
