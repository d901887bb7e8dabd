"""Readers on damaged bytes: a table or one line of InputError, nothing else, and no memory out of proportion.

Small files of every format are mutated: bytes flipped, numbers exchanged for extreme ones, pieces cut out,
doubled or moved, ends cut off. A few hundred of each in every run, 100 000 in `slow`.
"""

from __future__ import annotations

import contextlib
import re
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest

import fitting.residual  # noqa: F401 - it adds its line to METHODS
from gonio.formats import merl
from gonio.formats import read_any as read
from gonio.formats.tensor_file import write_tensors
from gonio.table.anisotropic import AnisotropicTable
from gonio.table.compress import METHODS, compress
from gonio.table.peak import Peak
from gonio.validation import seed_from
from microgeometry.errors import InputError
from tests.formats.test_lists import write_astm, write_lighttools, write_openmaterial
from tests.formats.test_plane_csv import write as write_plane
from tests.formats.test_radiance_xml import QUARTER, document
from tests.formats.test_speos import write_anisotropic, write_brdf
from tests.formats.test_zemax import write_file
from tests.table.tables import asymmetric, grid, make, share

QUICK, SLOW = 300, 100_000
_MEMORY = 16 << 20  # for a file of a few kB

_EXTREMES = (
    b"0", b"-1", b"nan", b"inf", b"1e308", b"-1e308", b"1e-308", b"90", b"180.0001", b"1e9", b"4294967296",
    b"18446744073709551615", b"", b"{", b"}", b",", b"\n", b"1.5", b"2", b"x", b"\xff\xfe", b"[", b"\0",
)  # fmt: skip
_WORDS = (0, 1, 2, 3, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)


def small_anisotropic():
    edges = np.linspace(-np.pi / 2, np.pi / 2, 4)
    table = AnisotropicTable(
        np.full((2, 2, 3, 3, 1), 0.1), [0, 1], [0, np.pi], edges, edges, ("a",), np.ones((2, 2, 1))
    )
    return table.replace(parts={"transmission": table}, provenance={"seed": 1})


def small_table():
    table = make(asymmetric, grid(2, 2, 3))
    below = share(table, 0.25)  # as many parts as there are cost as many times more
    gaps = np.arange(12).reshape(2, 2, 3) % 5 == 4
    lit = np.where(gaps[..., None], 0.0, below.values)
    albedo = np.einsum("irpc,rp->ic", lit, below.projected_solid_angles) + below.specular
    below = below.replace(values=lit, gaps=gaps, row_albedo=albedo)
    table = table.replace(parts={"transmission": below})
    values = np.random.default_rng(seed_from("fuzz peak")).random((2, 2, 3, 3))
    peak = Peak(values, np.array([0, 0.1, 0.2]), np.linspace(0, np.pi, 4), 0.1 * values)
    return table.replace(std_error=0.1 * table.values, peak=peak, provenance={"seed": 1})


def rgl(path, wavelengths=()):
    rng = np.random.default_rng(seed_from("fuzz rgl"))
    fields = {
        "description": np.frombuffer(b"test", np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": np.array([0, 0.8, 1.57], np.float32),
        "ndf": np.ones((2, 3), np.float32),
        "sigma": np.ones((2, 3), np.float32),
        "vndf": rng.random((1, 3, 3, 3)).astype(np.float32) + 0.1,
        "jacobian": np.ones(1, np.uint8),
    }
    if wavelengths:
        fields["wavelengths"] = np.array(wavelengths, np.float32)
    spectra = rng.random((1, 3, len(wavelengths) or 3, 2, 2)).astype(np.float32)
    fields["spectra" if wavelengths else "rgb"] = spectra
    write_tensors(path, fields)


def openmaterial(path):
    def shorten(content):
        content["brdf"]["lookupTable"] = content["brdf"]["lookupTable"][:40]

    write_openmaterial(path, (4.5e-7,), shorten)


def astm(path):
    lines = write_astm(path).read_text().splitlines()
    path.write_text("\n".join(["NUM_POINTS 40", *lines[2:43]]))


SAMPLES = {
    "t.h5": lambda path: small_table().save(path),
    "anisotropic.h5": lambda path: small_anisotropic().save(path),
    "t.npz": lambda path: small_table().save(path),
    "t.csv": lambda path: small_table().save(path),
    **{f"{m}.h5": (lambda path, m=m: compress(small_table(), path, 0.4, m)) for m in METHODS},
    "plane.csv": write_plane,
    "rgl.bsdf": rgl,
    "spectral.bsdf": lambda path: rgl(path, (450.0, 500.0, 550.0, 600.0)),
    "zemax.bsdf": lambda path: write_file(
        path, asymmetric, azimuths=np.arange(0, 361, 120), radials=range(0, 181, 20)
    ),
    "lighttools.bsdf": lambda path: write_lighttools(path, tuple(range(0, 361, 120))),
    "t.brdf": lambda path: write_brdf(path, asymmetric, (1, 1), wavelengths=(550.0,)),
    "t.anisotropicbsdf": lambda path: write_anisotropic(path, asymmetric),
    "t.astm": astm,
    "t.xompt": openmaterial,
    "matrix.xml": lambda path: path.write_text(document("Columns", [QUARTER])),
    "tree.xml": lambda path: path.write_text(
        document(
            "TensorTree3",
            [
                (
                    "Visible",
                    "Reflection Front",
                    "LBNL/Shirley-Chiu",
                    "{{1}{2}{3}{4}{1 2 3 4 5 6 7 8}{6}{7}{8}}",
                ),
                ("Visible", "Transmission Front", "LBNL/Shirley-Chiu", "{ 0.5 }"),
            ],
        )
    ),
}


def mutate(data, rng):
    """One to four changes."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        if not data:
            break
        at = int(rng.integers(len(data)))
        n = int(2 ** rng.uniform(0, 7))
        kind = rng.integers(8)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at] = int(rng.integers(256))
        elif kind == 2:
            word = int(rng.choice(_WORDS)).to_bytes(8, "little")[: int(2 ** rng.integers(4))]
            data[at : at + len(word)] = word
        elif kind == 3:  # a number in text
            numbers = list(re.finditer(rb"[-+.\deE]+", data[at : at + 200]))
            if numbers:
                start, end = numbers[0].span()
                data[at + start : at + end] = _EXTREMES[rng.integers(len(_EXTREMES))]
        elif kind == 4:
            del data[at : at + n]
        elif kind == 5:
            data[at:at] = data[at : at + n]
        elif kind == 6:
            other = int(rng.integers(len(data)))
            data[at : at + n] = data[other : other + n]
        elif rng.random() < 0.3:
            del data[at:]
    return bytes(data)


def read_mutated(path, what, n, change):
    """Read the file after each of n changes: a table, or one line that names the file; some of either kind."""
    rng = np.random.default_rng(seed_from(f"fuzz {what}"))
    good = 0
    for trial in range(n):
        change(rng)
        try:
            read(path)
            good += 1
        except InputError as error:
            text = str(error)
            assert str(path) in text, (what, trial, text)
            assert "\n" not in text, (what, trial, text)
    assert 0 < good < n  # mutations are neither all fatal nor all harmless


def run(name, n, folder):
    path = folder / name
    SAMPLES[name](path)
    original = path.read_bytes()
    assert np.all(np.isfinite(read(path).row_albedo))  # the sample itself is good
    read_mutated(path, name, n, lambda rng: path.write_bytes(mutate(original, rng)))


@pytest.mark.parametrize("name", SAMPLES)
def test_mutated_files(name, tmp_path):
    run(name, QUICK, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLES)
def test_many_mutated_files(name, tmp_path):
    run(name, SLOW, tmp_path)


def run_records(method, n, folder):
    """What a checksum keeps from the decoders: the record of a compressed table, mutated before it is packed."""
    path = folder / "c.h5"
    compress(small_table(), path, 0.4, method)
    with h5py.File(path) as file:
        original = zlib.decompress(file["compressed"][()].tobytes())
    image = path.read_bytes()

    def change(rng):
        path.write_bytes(image)  # what is deleted leaves its space behind
        with h5py.File(path, "r+") as file:
            del file["compressed"]
            file["compressed"] = np.frombuffer(zlib.compress(mutate(original, rng), 1), np.uint8)

    read_mutated(path, f"record {method}", n, change)


@pytest.mark.parametrize("method", METHODS)
def test_mutated_records(method, tmp_path):
    run_records(method, QUICK, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_many_mutated_records(method, tmp_path):
    run_records(method, SLOW, tmp_path)


@pytest.mark.parametrize("name", SAMPLES)
def test_memory_stays_in_proportion(name, tmp_path):
    path = tmp_path / name
    SAMPLES[name](path)
    original = path.read_bytes()
    read(path)  # imports
    rng = np.random.default_rng(seed_from(f"memory {name}"))
    tracemalloc.start()
    try:
        for trial in range(60):
            path.write_bytes(mutate(original, rng))
            tracemalloc.reset_peak()
            with contextlib.suppress(InputError):
                read(path)
            assert tracemalloc.get_traced_memory()[1] < _MEMORY, trial
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("n", [QUICK, pytest.param(SLOW, marks=pytest.mark.slow)])
def test_mutated_merl_files(n, tmp_path, monkeypatch):
    """On a grid of 3 x 3 x 4 bins: the reader's own, of 35 MB, differ only in size."""
    for name, count in (("N_THETA_H", 3), ("N_THETA_D", 3), ("N_PHI_D", 4)):
        monkeypatch.setattr(merl, name, count)
    path = tmp_path / "t.binary"
    rng = np.random.default_rng(seed_from("fuzz merl"))
    original = np.array([3, 3, 4], "<i4").tobytes() + rng.random(108).astype("<f8").tobytes()
    for _ in range(n):
        path.write_bytes(mutate(original, rng))
        with contextlib.suppress(InputError):
            assert merl._read_bins(path).shape in ((3, 3, 4, 3), (3, 3, 8, 3))
