"""Materials: densities, weights, energy, and tables and fits against what they stand for."""

import numpy as np
import pytest

from fitting.result import Fit, FittedLobe
from gonio.core.directions import direction
from gonio.core.jit import kernel
from gonio.validation import validate
from microgeometry.errors import InputError
from renderer.materials import evaluate, sample
from renderer.pack_materials import diffuse_fresnel, pack_materials
from renderer.scene import Material
from tests.renderer.scenes import lambert_table, table_of
from tests.table.tables import ggx, grid, make

RGB = ("R", "G", "B")


def grey(**values):
    return {name: dict.fromkeys(RGB, value) for name, value in values.items()}


FIT = Fit(
    "two-lobe",
    (FittedLobe("ggx", {"alpha": 0.3}, grey(f0=0.6, f90=0.9)), FittedLobe("lambert", {}, grey(albedo=0.2))),
    RGB,
)
GLASS = Fit(
    "walter_ggx",
    (
        FittedLobe(
            "walter_ggx",
            {"alpha": 0.3, "eta": 1.5},
            grey(specular_reflectance=1.0, specular_transmittance=1.0),
        ),
        FittedLobe("lambert", {}, grey(albedo=0.1)),
    ),
    RGB,
)
GLOSSY = table_of(
    lambda i, r, p: 0.1 + 0.5 * np.exp(-((i - r) ** 2 + (np.pi - p) ** 2 * np.sin(i) * np.sin(r)) / 0.1),
    0.7,
    tint=(1.0, 0.8, 0.5),
)
MATERIALS = {
    "diffuse": Material(),
    "ggx": Material(
        "rough_conductor", {"alpha": 0.4, "distribution": "ggx", "eta": (0.2, 0.4, 1.4), "k": (3, 2, 2)}
    ),
    "beckmann": Material("rough_conductor", {"alpha": 0.4, "distribution": "beckmann"}),
    "plastic": Material("plastic", {"reflectance": (0.7, 0.3, 0.1)}),
    "tabulated": Material("tabulated", {"table": GLOSSY}),
    "analytic": Material("analytic", {"fit": FIT}),
}


@kernel
def _evaluate_many(materials, wi, wo, values, density):
    memory = np.zeros(6)
    for n in range(len(wi)):
        a, b = (wi[n, 0], wi[n, 1], wi[n, 2]), (wo[n, 0], wo[n, 1], wo[n, 2])
        r, g, b, density[n] = evaluate(materials, 0, a, b, memory)
        values[n, 0], values[n, 1], values[n, 2] = r, g, b


@kernel
def _sample_many(materials, wo, u, wi, weight, density):
    memory = np.zeros(6)
    for n in range(len(wo)):
        w, r, g, b, density[n] = sample(
            materials, 0, (wo[n, 0], wo[n, 1], wo[n, 2]), u[n, 0], u[n, 1], u[n, 2], memory
        )
        wi[n, 0], wi[n, 1], wi[n, 2] = w
        weight[n, 0], weight[n, 1], weight[n, 2] = r, g, b


class Vectorised:
    """A material in the roles of the validation kit, whose known direction is here the camera's."""

    def __init__(self, material):
        self.packed = pack_materials([material])

    def both(self, wi, wo):
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        shape = wi.shape[:-1]
        values, density = np.empty((wi.size // 3, 3)), np.empty(wi.size // 3)
        _evaluate_many(
            self.packed, *(np.ascontiguousarray(a).reshape(-1, 3) for a in (wi, wo)), values, density
        )
        return values.reshape(*shape, 3), density.reshape(shape)

    def eval(self, camera, light):
        cosine = np.maximum(np.asarray(light)[..., 2:], 1e-300)
        return self.both(light, camera)[0] / cosine

    def pdf(self, camera, light):
        return self.both(light, camera)[1]

    def draw(self, camera, u):
        camera, u = (np.ascontiguousarray(a) for a in np.broadcast_arrays(camera, u))
        out, weight, density = np.empty_like(camera), np.empty_like(camera), np.empty(len(camera))
        _sample_many(self.packed, camera, u, out, weight, density)
        return out, weight, density

    def sample(self, camera, u):
        out, weight, density = self.draw(camera, u)
        kept = density > 0
        values = self.both(out[kept], np.broadcast_to(camera, out.shape)[kept])[0]
        np.testing.assert_allclose(weight[kept] * density[kept, None], values, rtol=1e-6, atol=1e-12)
        return out, np.where(out[:, 2] > 0, density, 0.0)


@pytest.mark.compiled
@pytest.mark.parametrize("name", MATERIALS)
def test_validation_kit(name):
    material = Vectorised(MATERIALS[name])
    report = validate(
        material.eval,
        material.sample,
        material.pdf,
        f"renderer {name}",
        theta_i=(0.2, 1.1),
        n=60_000,
        reciprocal=name != "tabulated",
    )
    lines = [line for line in report.lines() if line.startswith("FAIL")]
    if name == "plastic":  # its mirror samples are discarded here, so only the diffuse part's share is left
        lines = [line for line in lines if "weights" in line or "above" in line]
    assert not lines, lines


def test_tabulated_lambert_is_diffuse():
    u, wo = np.random.default_rng(1).random((50, 3)), np.array([[0.3, -0.2, np.sqrt(0.87)]])
    table = Vectorised(Material("tabulated", {"table": lambert_table(0.5)}))
    diffuse = Vectorised(Material())
    wi = diffuse.draw(wo, u)[0]
    np.testing.assert_allclose(table.eval(wo, wi), diffuse.eval(wo, wi), rtol=1e-5)
    np.testing.assert_allclose(table.pdf(wo, wi), diffuse.pdf(wo, wi), rtol=1e-5)


@pytest.mark.compiled
@pytest.mark.parametrize("theta", [0.3, 1.0])
def test_weights_of_a_smooth_reciprocal_table_are_its_albedo(theta):
    """But for the Lambertian twentieth: 1/0.95 where that has next to no share, less where it has one."""
    table = make(ggx(0.4, 0.9), grid(90, 90, 90))
    material = Vectorised(Material("tabulated", {"table": table}))
    wo = np.repeat(direction(theta)[None], 40_000, axis=0)
    wi, weight, density = material.draw(wo, np.random.default_rng(2).random((40_000, 3)))
    kept = (density > 0) & (wi[:, 2] > 0.1)  # at the horizon the rows' scaling to albedo breaks reciprocity
    ratio = weight[kept].mean(axis=1) / table.albedo(theta).mean()
    assert ratio.max() < 1.02 / 0.95
    assert np.median(ratio) > 1
    assert ratio[density[kept] > 0.1].std() < 0.05


def test_light_and_camera_are_not_confused():
    # a table that is not reciprocal: bright when lit from above, whatever the camera's angle
    rows = np.cos((np.arange(18) + 0.5) * np.pi / 36) ** 4
    table = table_of(lambda i, r, p: np.cos(i) ** 4 / np.pi + 0 * r, rows)
    material = Vectorised(Material("tabulated", {"table": table}))
    high, low = np.array([[0.1, 0, np.sqrt(0.99)]]), np.array([[-np.sqrt(0.91), 0, 0.3]])
    lit_from_above, lit_from_the_side = material.eval(low, high), material.eval(high, low)
    np.testing.assert_allclose(lit_from_above, table.eval(high, low), rtol=1e-6)  # Table.eval(wi, wo)
    assert not np.allclose(lit_from_above, lit_from_the_side, rtol=0.05)


def test_grey_table_has_one_channel():
    one = Vectorised(Material("tabulated", {"table": lambert_table(0.5, tint=(1.0,), specular=0.2)}))
    wo = np.array([[0.0, 0.6, 0.8]])
    values, _ = one.both(np.array([[0.6, 0.0, 0.8]]), wo)
    assert values[0] == pytest.approx([0.8 * 0.5 / np.pi] * 3, rel=1e-5)
    wi, weight, density = one.draw(np.repeat(wo, 4, axis=0), np.array([[0.01, 0.5, 0.5]] * 4))
    assert density[0] == 0
    np.testing.assert_allclose(wi[0], [0, -0.6, 0.8], atol=1e-12)
    assert weight[0] == pytest.approx([0.2 / (0.2 / 0.7)] * 3)  # the delta term over its chance


def test_two_channels_are_refused():
    with pytest.raises(InputError, match=r"T\.h5: has 2 channels without wavelengths; one"):
        pack_materials(
            [Material("tabulated", {"table": lambert_table(0.5, tint=(1.0, 0.5)), "filename": "T.h5"})]
        )


def test_two_sided():
    wi, wo = np.array([[0.6, 0.0, -0.8]]), np.array([[0.0, 0.6, -0.8]])
    assert np.all(Vectorised(Material()).both(wi, wo)[0] == 0)
    both = Vectorised(Material(two_sided=True))
    assert both.both(wi, wo)[0][0] == pytest.approx([0.5 * 0.8 / np.pi] * 3)
    assert both.draw(wo, np.array([[0.5, 0.5, 0.5]]))[0][0, 2] < 0


def test_refraction_follows_snell_and_scales_radiance():
    glass = Vectorised(Material("dielectric", {"eta": 1.5}))
    wo = np.array([[0.6, 0.0, 0.8]])
    wi, weight, density = glass.draw(wo, np.array([[0.999, 0.5, 0.5]]))
    np.testing.assert_allclose(wi[0], [-0.4, 0, -np.sqrt(1 - 0.16)], atol=1e-12)
    assert weight[0] == pytest.approx([1 / 2.25] * 3)
    assert density[0] == 0
    # from inside at 60 degrees all is reflected
    wi, weight, _ = glass.draw(np.array([[np.sqrt(0.75), 0, -0.5]]), np.array([[0.999, 0.5, 0.5]]))
    assert wi[0, 2] < 0
    assert weight[0] == pytest.approx([1, 1, 1])


@pytest.mark.compiled
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("through", [False, True])
def test_rough_glass_from_both_sides(side, through):
    glass = Vectorised(Material("analytic", {"fit": GLASS}))
    rng = np.random.default_rng(9)
    wo = np.tile([0.6, 0.0, side * 0.8], (40_000, 1))
    wi, weight, density = glass.draw(wo, rng.random((40_000, 3)))
    kept = density > 0
    values, again = glass.both(wi[kept], wo[kept])
    np.testing.assert_allclose(weight[kept] * density[kept, None], values, rtol=1e-9)
    np.testing.assert_allclose(density[kept], again, rtol=1e-9)
    # light of radiance 1 from one side: the samples' mean against the integral over that side
    lit = np.where(kept & ((wi[:, 2] * side < 0) == through), weight[:, 0], 0.0)
    x, w = np.polynomial.legendre.leggauss(200)
    theta, phi = np.meshgrid(0.25 * np.pi * (x + 1), np.pi * (x + 1), indexing="ij")
    z = np.cos(theta) * (-side if through else side)
    light = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), z], axis=-1)
    there = glass.both(light, np.broadcast_to(wo[0], light.shape))[0][..., 0]
    integral = np.einsum("tp,tp,t,p->", there, np.sin(theta), w, w) * 0.25 * np.pi**2
    assert abs(lit.mean() - integral) < 4 * lit.std() / 200 + 1e-4 * integral
    # seen from inside, refracted radiance is up to 2.25 times what shines in from outside, never the reverse
    assert 0.02 < integral < (2.25 if through and side < 0 else 1.1)


def test_anisotropic_models_are_refused():
    fit = Fit(
        "ward_anisotropic",
        (FittedLobe("ward_anisotropic", {"alpha_x": 0.1, "alpha_y": 0.3}, grey(rho_s=0.5)),),
        RGB,
    )
    with pytest.raises(InputError, match="analytic: lobe ward_anisotropic is anisotropic"):
        pack_materials([Material("analytic", {"fit": fit})])


@pytest.mark.parametrize(("eta", "expected"), [(1.5, 0.0918), (1 / 1.5, 0.5963)])
def test_diffuse_fresnel(eta, expected):
    # Egan & Hilgeman 1979, as quoted by d'Eon & Irving 2011: 0.092 into, 0.596 out of glass
    assert diffuse_fresnel(eta) == pytest.approx(expected, abs=2e-4)
