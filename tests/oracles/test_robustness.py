"""What must not matter, or must be refused: units, place, periods, thin and thick layers, bad meshes; reciprocity."""

from __future__ import annotations

import math
import subprocess
import sys
from math import radians

import numpy as np
import pytest
from scipy import stats

from gonio.table.table import Table
from gonio.trace.errors import TraceError
from tests.oracles import fresnel
from tests.oracles.measuring import (
    FLAT,
    INF,
    MIRROR,
    agrees,
    agrees_albedo,
    agrees_cells,
    batches_of,
    cell_means,
    gaussian,
    glass,
    groove,
    keeps_all_light,
    lambert,
    layer,
    ledger_adds_up,
    trace,
)

pytestmark = pytest.mark.compiled

ANGLES = [0, 40, 75]


# --- units and place ---


def paint(length, units):
    """Rough varnish over grooves with everything in it, all lengths times `length` in `units`."""
    medium = {
        "sigma_s": 0.3 / length, "sigma_a": 0.05 / length, "phase": "hg", "g": 0.4,
        "thickness": 6.0 * length, "units": units,
    }  # fmt: skip
    rough = gaussian(0.5, correlation_length=length, size=8 * length, units=units)
    return [layer(rough, glass(1.5), **medium), layer(groove(40, size=length, units=units), lambert(0.6))]


@pytest.mark.parametrize(("length", "units"), [(1e-9, "um"), (1e6, "um"), (1.0, "m"), (1e-6, "m")])
def test_scale(length, units):
    """The same paths, but for rounding: to 1e-5 of the light."""
    reference = trace(paint(1.0, "um"), 100_000, 5, theta_i_deg=ANGLES)
    scaled = trace(paint(length, units), 100_000, 5, theta_i_deg=ANGLES)
    assert scaled.row_albedo == pytest.approx(reference.row_albedo, rel=1e-5)
    assert scaled.ledger["absorbed: layer 1 medium"] == pytest.approx(
        reference.ledger["absorbed: layer 1 medium"], rel=1e-4
    )


def write_obj(path, vertices, faces):
    lines = ["v " + " ".join(f"{x:.17g}" for x in v) for v in vertices]
    lines += ["f " + " ".join(str(i + 1) for i in f) for f in faces]
    path.write_text("\n".join(lines) + "\n")


def bumps(n=16, seed=3):
    """A periodic height field of random heights on n x n samples, as a mesh over [0, 1]^2."""
    heights = np.random.default_rng(seed).uniform(0, 0.1, (n, n))
    heights = np.pad(heights, ((0, 1), (0, 1)), mode="wrap")
    x = np.linspace(0, 1, n + 1)
    vertices = np.stack([*np.meshgrid(x, x, indexing="ij"), heights], axis=-1).reshape(-1, 3)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (q.ravel() for q in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


@pytest.mark.parametrize(
    ("scale", "shift"), [(1.0, (1e6, -1e6, 1e6)), (1e-9, (0, 0, 0)), (1e6, (1e6, 0, -1e6))]
)
@pytest.mark.parametrize("material", ["metal", "glass"])
def test_a_mesh_anywhere(tmp_path, scale, shift, material):
    vertices, faces = bumps()
    write_obj(tmp_path / "here.obj", vertices, faces)
    write_obj(tmp_path / "there.obj", vertices * scale + shift, faces)
    made_of = {"metal": {"kind": "conductor", "eta": 0.4, "k": 1.1}, "glass": glass(1.5)}[material]
    here, there = (
        trace(
            layer({"kind": "mesh", "file": f"{name}.obj"}, made_of), 100_000, 5, folder=tmp_path,
            theta_i_deg=ANGLES,
        )
        for name in ("here", "there")
    )  # fmt: skip
    # 1e6 + x in double precision knows x to 1e-10
    assert there.row_albedo == pytest.approx(here.row_albedo, rel=1e-5)


# --- layers over layers ---


def test_a_thick_layer_over_layers_of_another_period(seed):
    """10^4 tiles of clear glass between roughness and grooves: as if 20, and whatever their periods."""
    results = []
    for period, thickness in ((1.0, 20.0), (1.0, 8e4), (math.sqrt(2), 30.0), (0.01, 20.0)):
        layers = [
            layer(gaussian(0.3), glass(1.5), thickness=thickness),
            layer(groove(45, size=period), lambert(0.5)),
        ]
        table = trace(layers, 200_000, seed, theta_i_deg=ANGLES)
        ledger_adds_up(table)
        results.append(table)
    first = results[0]
    for other in results[1:]:
        error = np.hypot(first.albedo_std_error, other.albedo_std_error)
        agrees(other.row_albedo, error, first.row_albedo, batches_of(first), precision=6e-3)


@pytest.mark.parametrize("thickness", [1e-3, 1.0, 1e7])
def test_flat_over_flat_knows_no_thickness(thickness):
    """Neither clear glass of 1 nm nor of 10 m changes a single path."""
    reference = trace(
        [layer(FLAT, glass(1.5), thickness=1.0), layer(FLAT, lambert(0.5))], 50_000, 5, theta_i_deg=ANGLES
    )
    table = trace(
        [layer(FLAT, glass(1.5), thickness=thickness), layer(FLAT, lambert(0.5))],
        50_000,
        5,
        theta_i_deg=ANGLES,
    )
    assert table.row_albedo == pytest.approx(reference.row_albedo, rel=1e-12)


@pytest.mark.parametrize(("slope", "tau"), [(45, 0.0), (45, 0.3), (25, 0.0)])
def test_a_thin_conformal_coat_on_metal_grooves(seed, slope, tau):
    """Much thinner than the groove is deep, it makes each wall a plate over metal, s and p apart.

    Absorption counts along the wall's normal: vertical thickness times the cosine of its slope.
    """
    index, thickness = 0.4 + 1.1j, 1e-4
    walls = groove(slope)
    layers = [
        layer(walls, glass(1.5), sigma_a=tau / (thickness * math.cos(radians(slope))), thickness=thickness),
        layer(walls, {"kind": "conductor", "eta": index.real, "k": index.imag}),
    ]
    table = trace(layers, 600_000, seed, theta_i_deg=[0])
    bounces = 2 if slope == 45 else 1
    plate = fresnel.plate_over_metal(math.cos(radians(slope)), 1.5, index, tau)
    agrees_albedo(table, [(plate**bounces).mean()], precision=2e-3)
    ledger_adds_up(table)


def test_layers_that_cut_through_each_other_are_refused():
    layers = [layer(gaussian(0.5), glass(1.5), thickness=0.05), layer(gaussian(0.5), lambert(0.5))]
    with pytest.raises(TraceError, match=r"lost.*thickness"):
        trace(layers, 20_000, 1, theta_i_deg=ANGLES)


ABSORBER = """
from tests.oracles.measuring import *
table = trace(layer(gaussian(0.5), glass(1.5), sigma_a=1.0, thickness=INF), 50_000, 1, theta_i_deg=[0, 45])
assert table.hits.sum() == round(table.ledger["reflected"]), (table.hits.sum(), table.ledger["reflected"])
ledger_adds_up(table)
"""


def test_rough_glass_over_an_absorber_without_end():
    """What enters is absorbed, and is counted in no cell. In a process of its own: it has crashed."""
    done = subprocess.run([sys.executable, "-c", ABSORBER], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr or f"exit status {done.returncode}"


# --- meshes ---


def mushrooms():
    """A plane with a stalk and a wide cap over it: overhangs, closed."""
    cap, low, top, stalk = 0.45, 0.3, 0.5, 0.15
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    rings = [(stalk, 0.0), (stalk, low), (cap, low), (cap, top)]
    n = 8
    for radius, z in rings:
        for k in range(n):
            a = 2 * math.pi * (k + 0.5) / n
            vertices.append((0.5 + radius * math.cos(a), 0.5 + radius * math.sin(a), z))
    vertices.append((0.5, 0.5, top))
    at = lambda ring, k: 4 + ring * n + k % n  # noqa: E731
    faces = []
    for ring in range(3):
        for k in range(n):
            a, b, c, d = at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)
            faces += [(a, b, c), (a, c, d)]
    faces += [(at(3, k), at(3, k + 1), len(vertices) - 1) for k in range(n)]
    # the plane around the stalk: from corners to the foot's ring
    corner = {0: 2, 1: 2, 2: 3, 3: 3, 4: 0, 5: 0, 6: 1, 7: 1}  # nearest corner of each foot's edge
    for k in range(n):
        faces.append((at(0, k + 1), at(0, k), corner[k]))
    for k in (1, 3, 5, 7):
        faces.append((at(0, k + 1), corner[k], corner[(k + 1) % n]))
    return vertices, faces


@pytest.mark.parametrize("material", [MIRROR, lambert(1.0), glass(1.5)], ids=["mirror", "lambert", "glass"])
def test_overhangs(seed, tmp_path, material):
    write_obj(tmp_path / "mushrooms.obj", *mushrooms())
    surface = {"kind": "mesh", "file": "mushrooms.obj"}
    table = trace(layer(surface, material), 20_000, seed, folder=tmp_path, theta_i_deg=[0, 60, 89.9])
    keeps_all_light(table, trapped=1e-3 if material == glass(1.5) else 0.0)


@pytest.mark.parametrize("material", [MIRROR, lambert(0.5), glass(1.5)], ids=["mirror", "lambert", "glass"])
def test_a_mesh_with_a_hole_is_refused(tmp_path, material):
    vertices, faces = bumps()
    write_obj(tmp_path / "hole.obj", vertices, faces[7:])
    with pytest.raises(TraceError, match=r"lost.*close"):
        trace(layer({"kind": "mesh", "file": "hole.obj"}, material), 20_000, 1, folder=tmp_path)


@pytest.mark.parametrize("width", [1e-3, 1e-5, 1e-6])
def test_skinny_triangles(tmp_path, width):
    """A plane of slivers `width` wide, and wide triangles beside: a smooth mirror, or a lossless slab's face."""
    x = np.concatenate([np.arange(8) * width, np.linspace(0.5, 1, 4)])
    vertices = [(a, b, 0.0) for a in x for b in (0.0, 0.37, 1.0)]
    faces = []
    for k in range(len(x) - 1):
        for j in range(2):
            a, b = 3 * k + j, 3 * (k + 1) + j
            faces += [(a, b, b + 1), (a, b + 1, a + 1)]
    write_obj(tmp_path / "slivers.obj", vertices, faces)
    surface = {"kind": "mesh", "file": "slivers.obj"}
    mirror = trace(layer(surface, MIRROR), 100_000, 1, folder=tmp_path, theta_i_deg=[0, 60, 89.9])
    assert mirror.specular == pytest.approx(1.0, abs=1e-9)
    assert mirror.ledger["lost"] == 0
    window = trace(layer(surface, glass(1.5)), 100_000, 1, folder=tmp_path, theta_i_deg=[0, 60, 89.9])
    assert window.row_albedo + window.parts["transmission"].row_albedo == pytest.approx(1.0, abs=1e-9)
    assert window.ledger["lost"] == 0


# --- reciprocity ---


METAL = {"kind": "conductor", "eta": 0.4, "k": 1.1}
TURBID = {"sigma_s": 1.0, "sigma_a": 0.05, "thickness": INF}
SPECIMENS = {
    "rough glass over grey": [
        layer(gaussian(0.5), glass(1.5), sigma_a=0.05, thickness=6.0),
        layer(FLAT, lambert(0.7)),
    ],
    "metal": [layer(gaussian(0.7), METAL)],
    "cloud under rough glass": [layer(gaussian(0.3), glass(1.5), phase="hg", g=0.6, **TURBID)],
    "Rayleigh in glass": [layer(FLAT, glass(1.5), phase="rayleigh", **TURBID)],
    "coated grooves": [
        layer(
            groove(35),
            {"kind": "coated", "films": [{"eta": 1.5, "k": 0.1, "thickness_nm": 90}], "over": METAL},
        )
    ],
    "pits": [layer({"kind": "pits", "cover": 0.6, "depth": 0.5, "plane": lambert(0.2)}, lambert(0.9))],
}


@pytest.mark.parametrize("name", SPECIMENS)
def test_reciprocity(seed, name):
    """f(i, o) = f(o, i) within the joint error: chi^2 per degree of freedom near 1."""
    wavelengths = {"wavelengths_nm": [550.0]} if name == "coated grooves" else {}
    table = trace(SPECIMENS[name], 800_000, seed, theta_step_deg=10, phi_step_deg=30, **wavelengths)
    rows, rings = np.triu_indices(len(table.theta_i), 1)
    f, e, hits = table.values[..., 0], table.std_error[..., 0], table.hits
    both = (hits[rows, rings] >= 100) & (hits[rings, rows] >= 100)
    z = (f[rows, rings] - f[rings, rows])[both] / np.hypot(e[rows, rings], e[rings, rows])[both]
    assert z.size > 50
    # differences of two means over b batches: between b - 1 and 2 (b - 1) degrees of freedom
    freedom = batches_of(table) - 1
    assert np.abs(z).max() < stats.t.isf(1e-3 / 20_000, freedom)
    mean, spread = freedom / (freedom - 2), math.sqrt(2 / z.size) * 1.5
    assert np.mean(z**2) < mean + 5 * spread
    assert np.mean(z**2) > 1 - 5 * spread


# --- tables as facets ---


def lambert_table(rho, steps=9):
    edges = np.linspace(0, math.pi / 2, steps + 1)
    phi = np.linspace(0, math.pi, 7)
    return Table(
        values=np.full((steps, steps, 6, 1), rho / math.pi),
        theta_i=0.5 * (edges[1:] + edges[:-1]),
        theta_i_edges=edges,
        theta_r_edges=edges,
        delta_phi_edges=phi,
        channels=("grey",),
        row_albedo=np.full((steps, 1), rho),
    )


def test_facets_of_a_lambertian_table_are_lambertian(seed, tmp_path):
    lambert_table(0.7).save(tmp_path / "lambert.h5")
    facets = {"kind": "table", "file": "lambert.h5"}
    for surface in (FLAT, groove(50), gaussian(0.8)):
        tabulated = trace(layer(surface, facets), 300_000, seed, folder=tmp_path, theta_i_deg=[5, 40, 75])
        direct = trace(layer(surface, lambert(0.7)), 300_000, seed, theta_i_deg=[5, 40, 75])
        error = np.hypot(tabulated.albedo_std_error, direct.albedo_std_error)
        agrees(tabulated.row_albedo, error, direct.row_albedo, batches_of(direct), precision=4e-3)
        chosen = (tabulated.hits >= 200) & (direct.hits >= 200)
        error = np.hypot(tabulated.std_error, direct.std_error)
        agrees(tabulated.values[chosen], error[chosen], direct.values[chosen], batches_of(direct))
        ledger_adds_up(tabulated)


def test_a_flat_surface_of_a_traced_table_gives_that_table(seed, tmp_path):
    """Cell by cell, what the table itself says between its cells' centres; the delta term included."""
    metal = {"kind": "conductor", "eta": 0.4, "k": 1.1}
    half_smooth = {"kind": "pits", "cover": 0.6, "depth": 0.6, "segments": 24, "plane": metal}
    table = trace(layer(half_smooth, lambert(0.8)), 2_000_000, seed, theta_step_deg=5, phi_step_deg=15)
    table.save(tmp_path / "traced.h5")
    again = trace(
        layer(FLAT, {"kind": "table", "file": "traced.h5"}),
        1_000_000,
        seed,
        folder=tmp_path,
        theta_i_deg=[7, 44, 71],
    )
    for row, theta in enumerate(again.theta_i):
        wi = np.array([math.sin(theta), 0.0, math.cos(theta)])

        def f(_, mu_o, phi, wi=wi):
            mu_o, phi = np.broadcast_arrays(mu_o, phi)
            sin_o = np.sqrt(1 - mu_o**2)
            wo = np.stack([sin_o * np.cos(phi), sin_o * np.sin(phi), mu_o], axis=-1)
            return table.eval(np.broadcast_to(wi, wo.shape), wo)[..., 0]

        expected = np.zeros(again.values.shape[:3])
        expected[row] = cell_means(f, again, points=12)
        mask = np.zeros(expected.shape, bool)
        mask[row] = True
        agrees_cells(again, expected, where=mask)
    agrees_albedo(again, [float(np.ravel(table.albedo(t))[0]) for t in again.theta_i], precision=4e-3)
    ledger_adds_up(again)


# --- dispersion ---


def test_rough_dispersion_is_as_if_each_wavelength_were_traced_alone(seed):
    etas = [1.4, 1.5, 1.8]
    spectrum = {"wavelengths_nm": [450.0, 550.0, 650.0]}

    def layers(eta):
        return [
            layer(gaussian(0.5), glass(eta), sigma_a=0.03, thickness=6.0),
            layer(groove(30), lambert(0.7)),
        ]

    together = trace(layers(etas), 500_000, seed, theta_i_deg=ANGLES, **spectrum)
    for channel, eta in enumerate(etas):
        alone = trace(layers(eta), 300_000, seed + 1, theta_i_deg=ANGLES)
        error = np.hypot(together.albedo_std_error[:, channel], alone.albedo_std_error[:, 0])
        agrees(
            together.row_albedo[:, channel],
            error,
            alone.row_albedo[:, 0],
            batches_of(alone),
            precision=1.5e-2,
        )
    ledger_adds_up(together)
