"""Lists of samples: CSV, NPZ, ASTM E1392, OpenMATERIAL; and LightTools' blocks."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
import pytest

from gonio import formats
from gonio.core.directions import direction
from gonio.formats.cells import cells_around
from gonio.table.checks import check
from gonio.table.peak import Peak
from gonio.table.table import Table
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.formats.damage import refused, refused_after
from tests.formats.test_hdf5 import assert_same, full_table
from tests.table.tables import asymmetric, grid, make

THETA_I, THETA_R = np.radians([0.0, 30, 60]), np.radians(np.arange(0.0, 90, 10))
PHI = np.radians(np.arange(0.0, 360, 20))


def samples(phi_i=0.0):
    """Angles of all samples and asymmetric values, the detector's azimuth absolute."""
    i, r, p = (a.ravel() for a in np.meshgrid(THETA_I, THETA_R, PHI, indexing="ij"))
    values = asymmetric(direction(i, 0 * i), direction(r, p))
    return i, r, (p + phi_i) % (2 * np.pi), values


def check_asymmetric(table, channel=0, scale=1.0):
    """All cells against the function at their samples; on the normal every azimuth holds the same."""
    assert len(table.theta_i) == 3
    phi = np.radians(np.arange(0.0, 181, 20))
    for row, theta_i in enumerate(THETA_I):
        expected = asymmetric(direction(theta_i), direction(THETA_R[1:, None], phi))
        np.testing.assert_allclose(table.values[row, 1:, :, channel], scale * expected, rtol=1e-5)
    np.testing.assert_allclose(np.ptp(table.values[:, 0], axis=1), 0, atol=1e-12)


def test_cells_around_nodes():
    """A space begins and ends with a cell of the size, in sin^2 theta, of the node's cell beside it."""
    edges, source = cells_around(np.radians([0.0, 10, 20, 90]), np.pi / 2)
    u = np.sin(np.radians([15, 30, 80, 90])) ** 2
    beside = np.degrees(np.arcsin(np.sqrt([2 * u[1] - u[0], 2 * u[2] - u[3]])))
    np.testing.assert_allclose(np.degrees(edges), [0, 5, 15, 30, *beside, 80, 90])
    assert source.tolist() == [0, 1, 2, -1, -1, -1, 3]
    edges, source = cells_around(np.array([0.0, np.pi]), np.pi)
    np.testing.assert_allclose(np.degrees(edges), [0, 22.5, 45, 135, 157.5, 180])
    assert source.tolist() == [0, -1, -1, -1, 1]
    # beyond the last node a cell ends at the step before it, and without room for two a space is one cell
    edges, source = cells_around(np.radians([80.0, 82, 84]), np.pi / 2)
    np.testing.assert_allclose(np.degrees(edges[2:]), [78, 81, 83, 86, 90])
    assert source.tolist() == [-1, -1, 0, 1, 2, -1]


# --- CSV and NPZ -----------------------------------------------------------------------------------------


def test_csv_keeps_cells_error_bars_gaps_and_wavelengths(tmp_path):
    table = full_table().replace(channels=("630 nm", "π", "B"))
    lost = " ".join(table.save(tmp_path / "t.csv"))
    for what in ("transmission, L1", "paths in each cell", "provenance"):
        assert what in lost
    assert "error bars" not in lost
    again = Table.load(tmp_path / "t.csv")
    assert again.channels == table.channels
    assert again.wavelengths_nm == table.wavelengths_nm
    np.testing.assert_array_equal(again.gaps, table.gaps)
    known = ~table.gaps
    np.testing.assert_allclose(again.values[known], table.values[known], rtol=1e-8)
    np.testing.assert_allclose(again.std_error[known], table.std_error[known], rtol=1e-8)
    for name in ("theta_i", "theta_i_edges", "theta_r_edges", "delta_phi_edges", "row_albedo", "specular"):
        np.testing.assert_allclose(getattr(again, name), getattr(table, name), rtol=1e-12, err_msg=name)
    assert formats.convert(tmp_path / "t.csv", tmp_path / "t.npz").error < 1e-9


def test_csv_of_anyones_samples(tmp_path):
    i, r, p, values = samples()
    rows = zip(np.degrees(i), np.degrees(r), np.degrees(p), values, 2 * values, 0.1 + values, strict=True)
    text = "theta_r_deg,theta_i_deg,delta_phi_deg,red,red_std_error,blue\n"
    path = tmp_path / "mine.csv"
    path.write_text(text + "".join(f"{b},{a},{c},{v},{w},{x}\n" for a, b, c, v, x, w in rows))
    with pytest.raises(InputError, match="1 columns of error bars for 2 channels"):
        Table.load(path)
    path.write_text(path.read_text().replace("red_std_error", "green"))
    table = Table.load(path)
    assert table.channels == ("red", "green", "blue")
    check_asymmetric(table)
    check_asymmetric(table, 2, 2.0)
    assert check(table).passed


def test_samples_on_no_grid_are_averaged(tmp_path):
    rng = np.random.default_rng(seed_from("scattered"))
    n = 3000
    i, r, p = rng.choice([10.0, 50.0], n), rng.uniform(0, 89, n), rng.uniform(-180, 180, n)
    path = tmp_path / "scattered.csv"
    lines = [f"{a},{b},{c},0.25,0.1" for a, b, c in zip(i, r, p, strict=True)]
    path.write_text("theta_i_deg,theta_r_deg,delta_phi_deg,Y,Y_std_error\n" + "\n".join(lines))
    table = Table.load(path)
    known = np.ones(table.values.shape[:3], bool) if table.gaps is None else ~table.gaps
    np.testing.assert_allclose(table.values[known], 0.25)
    # means of a few samples are better than one, and never certain
    assert np.all(table.std_error[known] <= 0.1 + 1e-12)
    assert 0.01 < table.std_error[known].mean() < 0.1
    assert table.values.size < n


def test_npz_keeps_everything(tmp_path):
    table = full_table()
    assert table.save(tmp_path / "t.npz") == []
    assert_same(table, Table.load(tmp_path / "t.npz"))


def test_npz_keeps_the_highlight(tmp_path):
    rng = np.random.default_rng(seed_from("npz peak"))
    table = make(asymmetric, grid(6, 7, 8))
    edges = np.array([0, 0.01, 0.03]), np.linspace(0, np.pi, 5)
    for error in (None, rng.random((6, 2, 4, 3))):
        peak = Peak(rng.random((6, 2, 4, 3)), *edges, error)
        part = table.replace(peak=peak)
        assert part.replace(parts={"transmission": part}).save(tmp_path / "t.npz") == []
        again = Table.load(tmp_path / "t.npz")
        for found in (again.peak, again.parts["transmission"].peak):
            for name in Peak.__dataclass_fields__:
                np.testing.assert_array_equal(getattr(found, name), getattr(peak, name), err_msg=name)
    rewrite(tmp_path / "t.npz", {"peak/psi_edges.npy": None})
    refused(tmp_path / "t.npz", "array peak/psi_edges is missing")


def test_csv_that_could_not_be_read_is_not_written(tmp_path):
    table = make(asymmetric, grid(90, 90, 90))
    gaps = np.ones(table.values.shape[:3], bool)
    gaps[:, 0, :3] = False
    path = tmp_path / "t.csv"
    for bad, message in (
        (table.replace(channels=("a", "b", "a")), "of one name"),
        (table.replace(gaps=gaps), "270 of 729000 cells are no gaps"),
    ):
        with pytest.raises(InputError, match=message):
            bad.save(path)
        assert not list(tmp_path.iterdir())


def test_csv_of_unknown_error_bars(tmp_path):
    table = make(asymmetric, grid(4, 4, 5))
    error = 0.1 * table.values
    error[1, 2, 3, 0] = np.inf
    table.replace(std_error=error).save(tmp_path / "t.csv")
    np.testing.assert_allclose(Table.load(tmp_path / "t.csv").std_error, error, rtol=1e-8)


def test_truncated_csv(tmp_path):
    """Wherever it was cut: between lines cells are missing, in the last number a digit is."""
    table = make(asymmetric, grid(4, 4, 5))
    path = tmp_path / "t.csv"
    table.save(path)
    whole = path.read_bytes()
    between = whole[:-1].rfind(b"\n") + 1
    for n in (between, between - 1, len(whole) - 1, len(whole) - 3):
        path.write_bytes(whole[:n])
        refused(path, "lines of cells, its line # lines says 80; it is truncated")
    path.write_bytes(whole)
    np.testing.assert_allclose(Table.load(path).values, table.values, rtol=1e-8)


CSV_DAMAGE = {
    "empty": ("", "empty"),
    "no angle": ("theta_i_deg,theta_r_deg,Y\n1,2,3\n", "0 columns delta_phi_deg"),
    "no channel": ("theta_i_deg,theta_r_deg,delta_phi_deg\n1,2,3\n", "columns of values"),
    "word": ("theta_i_deg,theta_r_deg,delta_phi_deg,Y\n1,2,3,x\n", "numbers are expected"),
    "infinite": ("theta_i_deg,theta_r_deg,delta_phi_deg,Y\n1,2,3,inf\n", "hold infinity"),
    "nan": ("theta_i_deg,theta_r_deg,delta_phi_deg,Y,Y_std_error\n1,2,3,4,nan\n", "NaN"),
    "short": ("theta_i_deg,theta_r_deg,delta_phi_deg,Y\n1,2,3\n", "other than 4 columns"),
    "nothing": ("theta_i_deg,theta_r_deg,delta_phi_deg,Y\n", "no samples"),
    "below": ("theta_i_deg,theta_r_deg,delta_phi_deg,Y\n1,120,3,4\n", "0 to 90 is allowed"),
    "json": ("# specular: [\ntheta_i_deg,theta_r_deg,delta_phi_deg,Y\n1,2,3,4\n", "no JSON"),
    "edges": ("# theta_r_edges: [0,90]\ntheta_i_deg,theta_r_deg,delta_phi_deg,Y\n1,2,3,4\n", "is missing"),
    "huge": (
        "# theta_i: [1]\n# theta_r_edges: [0,90]\n# delta_phi_edges: [0,180]\n"
        "theta_i_deg,theta_r_deg,delta_phi_deg,Y\n1,2,3,4\n",
        "angles that are not those",
    ),
}


@pytest.mark.parametrize("name", CSV_DAMAGE)
def test_damaged_csv(name, tmp_path):
    text, message = CSV_DAMAGE[name]
    path = tmp_path / "bad.csv"
    path.write_text(text)
    refused(path, message)


def test_channel_that_is_no_column(tmp_path):
    table = make(asymmetric, grid(3, 3, 4), tint=(1.0,)).replace(channels=("a,b",))
    with pytest.raises(InputError, match="cannot be a column"):
        table.save(tmp_path / "t.csv")


def rewrite(path, changes):
    """An NPZ with some members replaced by these bytes, None to leave out."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members |= changes
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            if data is not None:
                archive.writestr(name, data)


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


HUGE = npy(np.zeros(3)).replace(b"(3,), }        ", b"(3000000000,), }", 1)
NPZ_DAMAGE = {
    "missing": ({"values.npy": None}, "array values is missing"),
    "no array": ({"values.npy": b"hello"}, "no numpy array"),
    "claim": ({"theta_i.npy": HUGE}, "does not fit"),
    "objects": ({"theta_i.npy": npy(np.zeros(3)).replace(b"'<f8'", b"'|O' ")}, "does not fit"),
    "text": ({"theta_i.npy": npy(np.array(["a", "b"]))}, "holds text"),
    "numbers": ({"channels.npy": npy(np.zeros(3))}, "no list of text"),
    "ledger": ({"ledger.npy": npy(np.array("[]"))}, "ledger is no JSON"),
    "shape": ({"row_albedo.npy": npy(np.zeros((2, 3)))}, "row_albedo: shape"),
    "bomb": ({"std_error.npy": b"\0" * 50_000_000}, "no numpy array|more than a file"),
    "part": ({"parts/L1/values.npy": None}, "parts/L1/values is missing"),
}


@pytest.mark.parametrize("name", NPZ_DAMAGE)
def test_damaged_npz(name, tmp_path):
    changes, message = NPZ_DAMAGE[name]
    path = tmp_path / "t.npz"
    full_table().save(path)
    rewrite(path, changes)
    refused(path, message)


def test_no_npz(tmp_path):
    (tmp_path / "t.npz").write_bytes(b"PK\3\4 not really")
    refused(tmp_path / "t.npz", "no NPZ file")


# --- ASTM E1392 ------------------------------------------------------------------------------------------


def write_astm(path, channels="Y", phi_i=0.7, scale=(1.0,)):
    i, r, p, values = samples(phi_i)
    lines = ["SAMPLE  paint", f"NUM_POINTS {len(i)}", f"VARS theta_i,phi_i,theta_s,phi_s,{channels}"]
    for a, b, c, v in zip(i, r, p, values, strict=True):
        lines.append(",".join(f"{x:.7f}" for x in (a, phi_i, b, c, *(s * v for s in scale))))
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def test_astm(tmp_path):
    table = Table.load(write_astm(tmp_path / "a.astm"))
    check_asymmetric_loosely(table)
    spectral = Table.load(write_astm(tmp_path / "b.astm", "400nm,700nm", scale=(1.0, 2.0)))
    assert spectral.wavelengths_nm == (400.0, 700.0)
    np.testing.assert_allclose(spectral.values[..., 1], 2 * spectral.values[..., 0], rtol=1e-3, atol=1e-6)
    white = Table.load(write_astm(tmp_path / "c.astm", "X,Y,Z", scale=(0.9504559, 1.0, 1.0890578)))
    assert white.channels == ("R", "G", "B")
    np.testing.assert_allclose(white.values[..., 0], white.values[..., 2], rtol=1e-3, atol=1e-6)
    assert check(table).passed


def check_asymmetric_loosely(table):
    """As `check_asymmetric`, for values of seven decimals."""
    phi = np.radians(np.arange(0.0, 181, 20))
    expected = asymmetric(direction(THETA_I[2]), direction(THETA_R[1:, None], phi))
    np.testing.assert_allclose(table.values[2, 1:9, :, 0], expected, rtol=1e-3)


ASTM_DAMAGE = {
    "no vars": (lambda t: t.replace("VARS", "VALS"), "no line VARS"),
    "names": (lambda t: t.replace("phi_s", "phi_r"), "VARS theta_i,phi_i,theta_s,phi_r"),
    "count": (lambda t: t.replace("NUM_POINTS 4", "NUM_POINTS 5"), "NUM_POINTS is 5"),
    "long": (lambda t: t[:-2] + ",1\r\n", "other than 5 numbers"),
    "word": (lambda t: t.replace("0.7000000", "zero", 1), "numbers are expected"),
    "degrees": (lambda t: t.replace("1.0471976,", "60,", 1), "0 to 90 is allowed"),
}


@pytest.mark.parametrize("name", ASTM_DAMAGE)
def test_damaged_astm(name, tmp_path):
    damage, message = ASTM_DAMAGE[name]
    refused_after(damage, write_astm(tmp_path / "a.astm"), message)


# --- OpenMATERIAL ----------------------------------------------------------------------------------------


def write_openmaterial(path, wavelengths=(4.5e-7, 6.5e-7), change=None):
    i, r, p, values = samples()
    rows = [
        [w, a, b, c, v / (1 + n)]
        for n, w in enumerate(wavelengths)
        for a, b, c, v in zip(i.tolist(), r.tolist(), p.tolist(), values.tolist(), strict=True)
    ]
    content = {"metadata": {"name": "test"}, "brdf": {"wavelengths": list(wavelengths), "lookupTable": rows}}
    if change:
        change(content)
    path.write_text(json.dumps(content))
    return path


def test_openmaterial(tmp_path):
    table = Table.load(write_openmaterial(tmp_path / "a.xompt"))
    assert table.wavelengths_nm == pytest.approx((450.0, 650.0))
    check_asymmetric(table)
    check_asymmetric(table, 1, 0.5)
    one = Table.load(write_openmaterial(tmp_path / "b.xompt", (0.0,)))
    assert one.channels == ("Y",)


def test_real_openmaterial(real_data):
    """Asphalt: for a camera only along the normal, for a lidar only in the plane of incidence, from 86 degrees."""
    folder = real_data / "openmaterial" / "examples"
    camera = Table.load(folder / "example_material_camera_brdf.xompt")
    assert camera.values.shape[0] == 59
    assert len(camera.wavelengths_nm) == 32
    assert np.all(camera.values[:, 0, :, 0] == pytest.approx(1.4e-5, abs=2e-6))
    assert np.all(camera.gaps[:, 1:])
    assert not np.any(camera.gaps[:, 0])
    lidar = Table.load(folder / "example_material_lidar_brdf.xompt")
    assert lidar.wavelengths_nm == pytest.approx((905.0,))
    assert lidar.values.max() == pytest.approx(1.3255e-3)
    assert np.all(lidar.gaps[:, 1:, 1:-1])
    assert not np.any(lidar.gaps[:, :, [0, -1]])
    # interpolated over the gaps they were half and an eighth of the file's
    mirror = lidar.eval(direction(np.radians(88)), direction(np.radians(60), np.pi))
    assert mirror[0] == pytest.approx(lidar.values[2, 61, -1, 0], rel=1e-3)
    assert camera.eval(direction(0.5), direction(0.0))[0] == pytest.approx(1.4e-5, abs=2e-6)
    assert check(camera).passed
    assert check(lidar).passed


OPENMATERIAL_DAMAGE = {
    "brdf": (lambda c: c.pop("brdf"), "'brdf' is missing"),
    "rows": (lambda c: c["brdf"].__setitem__("lookupTable", [[1, 2]]), "five numbers"),
    "text": (lambda c: c["brdf"]["lookupTable"][0].__setitem__(4, "x"), "numbers are expected"),
    "nested": (lambda c: c["brdf"]["lookupTable"][0].__setitem__(4, [1]), "numbers are expected"),
    "wavelength": (lambda c: c["brdf"]["lookupTable"].pop(), "the same directions"),
}


@pytest.mark.parametrize("name", OPENMATERIAL_DAMAGE)
def test_damaged_openmaterial(name, tmp_path):
    change, message = OPENMATERIAL_DAMAGE[name]
    refused(write_openmaterial(tmp_path / "a.xompt", change=change), message)


def test_openmaterial_that_is_no_json(tmp_path):
    for text in ("{", "[" * 100_000, "\xff"):
        (tmp_path / "a.xompt").write_bytes(text.encode("latin-1"))
        refused(tmp_path / "a.xompt", "no JSON")


# --- LightTools ------------------------------------------------------------------------------------------


def write_lighttools(
    path, azimuths=tuple(range(0, 361, 20)), kinds=("BRDF", "BTDF"), colour="Monochrome", pois=(0,)
):
    radials = np.degrees(THETA_R)
    lines = ["# a comment", "Symmetry Asymmetric", f"SpectralContent {colour}"]
    lines += [f"ScatterAzimuth {len(azimuths)}", " ".join(map(str, azimuths))]
    lines += [f"ScatterRadial {len(radials)}", " ".join(map(str, radials)), "DataBegin"]
    stimuli = {"X": 0.9504559, "Y": 1.0, "Z": 1.0890578} if colour == "XYZ" else {"": 1.0}
    for n, kind in enumerate(kinds):
        for aoi in THETA_I:
            for poi in pois:
                for stimulus, factor in stimuli.items():
                    said = f"TristimulusValue {stimulus}" if stimulus else ""
                    lines.append(
                        f"AOI {np.degrees(aoi)} POI {poi} Side Front Wavelength 555 ScatterType {kind} {said} TIS 0.5"
                    )
                    for azimuth in azimuths:
                        wo = direction(THETA_R, np.radians(azimuth - 90.0 - poi))
                        values = asymmetric(direction(aoi)[None], wo) * factor / (1 + n)
                        lines.append(" ".join(f"{v:.8e}" for v in values))
    path.write_text("\n".join([*lines, "DataEnd"]))
    return path


@pytest.mark.parametrize(
    "azimuths", [tuple(range(0, 361, 10)), tuple(range(0, 360, 10)), tuple(range(90, 271, 10))]
)
def test_lighttools(azimuths, tmp_path):
    table = Table.load(write_lighttools(tmp_path / "a.bsdf", azimuths))
    assert table.wavelengths_nm == (555.0,)
    assert table.provenance["format"] == "LightTools"
    wo = direction(THETA_R[1:, None], table.delta_phi)
    for row, theta_i in enumerate(THETA_I):
        expected = asymmetric(direction(theta_i), wo)
        np.testing.assert_allclose(table.values[row, 1:9, :, 0], expected, rtol=0.01)
        np.testing.assert_allclose(
            table.parts["transmission"].values[row, 1:9, :, 0], expected / 2, rtol=0.01
        )
    assert check(table).passed


def test_lighttools_colours_and_rotations(tmp_path):
    white = Table.load(write_lighttools(tmp_path / "a.bsdf", colour="XYZ", pois=(0, 40)))
    assert white.channels == ("R", "G", "B")
    np.testing.assert_allclose(white.values[..., 0], white.values[..., 2], rtol=1e-4)
    assert "2 azimuths of the light" in white.provenance["lost"][0]
    wo = direction(THETA_R[1:, None], white.delta_phi)
    np.testing.assert_allclose(white.values[2, 1:9, :, 0], asymmetric(direction(THETA_I[2]), wo), rtol=0.03)


LIGHTTOOLS_DAMAGE = {
    "end": (lambda t: t.replace("DataEnd", ""), "ends where DataEnd"),
    "begin": (lambda t: t.replace("DataBegin", ""), "ends where DataBegin"),
    "colour": (lambda t: t.replace("Monochrome", "Stereo"), "Monochrome or XYZ"),
    "radial": (lambda t: t.replace("ScatterRadial", "Scatter"), "ScatterRadial is missing"),
    "side": (lambda t: t.replace("Side Front", "Side Top"), "Side top"),
    "aoi": (lambda t: t.replace("AOI 0.0", "AOI 120"), "AOI 120; 0 to 90"),
    "poi": (lambda t: t.replace("POI 0", "POI nan"), "POI 'nan'; a number"),
    "word": (lambda t: t.replace("DataEnd", "Data DataEnd"), "'Data' where one of"),
}


@pytest.mark.parametrize("name", LIGHTTOOLS_DAMAGE)
def test_damaged_lighttools(name, tmp_path):
    damage, message = LIGHTTOOLS_DAMAGE[name]
    refused_after(damage, write_lighttools(tmp_path / "a.bsdf"), message)
