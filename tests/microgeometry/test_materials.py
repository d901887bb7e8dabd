from pathlib import Path

import numpy as np
import pytest

from microgeometry.errors import InputError
from microgeometry.indices import refractive_index
from microgeometry.materials import (
    MATERIALS,
    Black,
    Coated,
    Conductor,
    Dielectric,
    Film,
    Lambert,
    Mirror,
    NoInterface,
    TableMaterial,
)
from microgeometry.specimen import parse_specimen

GREEN = {"wavelengths_nm": [500, 600]}
INDEX = "wavelength_nm,n,k\n400,1.5,0\n500,1.6,0.00001\n600,1.7,0.00003\n"
METAL = "wavelength_nm,n,k\n400,1,2\n800,2,3\n"


def build(material, grid=None, folder=Path(".")):
    return parse_specimen({"surface": {"kind": "flat"}, "material": material, "grid": grid or {}}, folder)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "index.csv").write_text(INDEX)
    (tmp_path / "metal.csv").write_text(METAL)
    (tmp_path / "clear.csv").write_text("wavelength_um,n\n0.4,1.5\n0.8,1.4\n")
    (tmp_path / "facet.h5").write_bytes(b"")
    return tmp_path


@pytest.mark.parametrize(
    ("kind", "material"), [("mirror", Mirror()), ("black", Black()), ("none", NoInterface())]
)
def test_materials_without_keys_are_grey(kind, material):
    specimen = build({"kind": kind})
    assert specimen.material == material
    assert specimen.material.kind == kind
    assert (specimen.grid.channels, specimen.grid.wavelengths_nm) == (("grey",), None)


def test_scalar_is_grey_and_broadcasts():
    assert build({"kind": "lambert", "albedo": 0.5}).material == Lambert((0.5,))
    assert build({"kind": "lambert", "albedo": 0.5}, {"channels": "rgb"}).material == Lambert((0.5,) * 3)
    conductor = build({"kind": "conductor", "eta": [0.2, 0.3], "k": 3}, GREEN).material
    assert conductor == Conductor((0.2, 0.3), (3.0, 3.0))
    assert build({"kind": "dielectric", "eta": 1.5}).material == Dielectric((1.5,))
    assert build({"kind": "dielectric", "eta": np.array(1.5)}).material == Dielectric((1.5,))


def test_three_values_are_rgb_in_that_order():
    specimen = build({"kind": "lambert", "albedo": [0.1, 0.5, 0.9]})
    assert specimen.material == Lambert((0.1, 0.5, 0.9))
    assert specimen.grid.channels == ("R", "G", "B")
    assert build({"kind": "dielectric", "eta": np.array((1.5, 1.6, 0.9))}).material.eta == (1.5, 1.6, 0.9)


def test_named_conductor_is_a_spectrum_for_rgb():
    specimen = build({"kind": "conductor", "name": "Au"})
    assert specimen.grid.channels == ("R", "G", "B")
    assert specimen.grid.wavelengths_nm is None
    n, k = refractive_index("Au", specimen.grid.samples_nm)
    assert specimen.material == Conductor(tuple(n), tuple(k), "Au")
    assert len(n) == specimen.grid.n_samples == 21


def test_wavelengths_name_the_channels():
    specimen = build({"kind": "conductor", "name": "Au"}, {"wavelengths_nm": [616.8, 548.6]})
    assert specimen.grid.channels == ("616.8 nm", "548.6 nm")
    assert specimen.material.eta == pytest.approx((0.21, 0.43))
    assert specimen.material.k == pytest.approx((3.272, 2.455))


def test_a_number_is_the_same_at_every_sample_of_a_spectrum():
    films = [{"eta": 1.5, "thickness_nm": 100}]
    over = {"kind": "conductor", "name": "Au"}
    film = build({"kind": "coated", "films": films, "over": over}).material.films[0]
    assert film.eta == (1.5,) * 21


def test_named_dielectric():
    # SCHOTT's data sheet: n_F = 1.52238, n_d = 1.51680, n_C = 1.51432.
    grid = {"wavelengths_nm": [486.1327, 587.5618, 656.2725]}
    bk7 = build({"kind": "dielectric", "name": "BK7"}, grid).material
    assert bk7.eta == pytest.approx((1.52238, 1.51680, 1.51432), abs=2e-5)
    assert bk7.name == "BK7"


def test_constants_from_a_file(folder):
    assert build({"kind": "dielectric", "file": "index.csv"}, GREEN, folder).material == Dielectric(
        (1.6, 1.7)
    )
    clear = build({"kind": "dielectric", "file": "clear.csv"}, GREEN, folder).material
    assert clear.eta == pytest.approx((1.475, 1.45))
    metal = build({"kind": "conductor", "file": "metal.csv"}, GREEN, folder).material
    assert metal == Conductor((1.25, 1.5), (2.25, 2.5))
    # A spectrum, like a name: rgb of it is a colour.
    assert build({"kind": "conductor", "file": "metal.csv"}, folder=folder).grid.n_samples == 21


def test_coated(folder):
    films = [
        {"name": "TiO2", "thickness_nm": 50},
        {"eta": [1.4, 1.5], "k": 0.1, "thickness_nm": 0},
        {"file": "clear.csv", "thickness_nm": 1e4},
    ]
    material = {"kind": "coated", "films": films, "over": {"kind": "conductor", "eta": 2, "k": 3}}
    coated = build(material, GREEN, folder).material
    n, k = refractive_index("TiO2", [500, 600])
    assert coated.films == (
        Film(tuple(n), tuple(k), pytest.approx(50e-9, rel=1e-15), "TiO2"),
        Film((1.4, 1.5), (0.1, 0.1), 0.0),
        Film(pytest.approx((1.475, 1.45)), (0.0, 0.0), pytest.approx(1e-5, rel=1e-15)),
    )
    assert coated.over == Conductor((2.0, 2.0), (3.0, 3.0))


def test_films_are_coloured_whatever_they_are_made_of():
    # Their colour comes from the wavelength, not from the index.
    films = [{"eta": 1.3, "thickness_nm": 400}]
    specimen = build({"kind": "coated", "films": films, "over": {"kind": "dielectric", "eta": 1.5}})
    assert specimen.grid.to_channels is not None
    assert specimen.material.over.eta == (1.5,) * 21


def test_what_transmits_and_into_what():
    above = (1.2, 1.3)
    glass, metal, film = (
        Dielectric((1.5, 1.6)),
        Conductor((1.0, 1.0), (2.0, 2.0)),
        Film((2.0, 2.0), (0.0, 0.0), 1e-7),
    )
    for material, below in ((glass, glass.eta), (Coated((film,), glass), glass.eta), (NoInterface(), above)):
        assert material.transmits
        assert material.index_below(above) == below
    opaque = (
        Mirror(),
        Black(),
        Lambert((0.5, 0.5)),
        metal,
        Coated((film,), metal),
        TableMaterial(Path("/a.h5")),
    )
    for material in opaque:
        assert not material.transmits
        with pytest.raises(TypeError, match="opaque"):
            material.index_below(above)


def test_table(folder, monkeypatch):
    specimen = build({"kind": "table", "file": "facet.h5"}, folder=folder)
    assert specimen.material == TableMaterial(folder / "facet.h5")
    assert specimen.grid.channels == ("grey",)
    monkeypatch.chdir(folder)
    assert build({"kind": "table", "file": "facet.h5"}).material.file.is_absolute()


def test_registry():
    for kind, material in MATERIALS.items():
        assert material.kind == kind
        assert material.__dataclass_params__.frozen


def coated(film=None, **keys):
    over = {"kind": "conductor", "eta": 1, "k": 2}
    films = [{"eta": 1.5, "thickness_nm": 100} if film is None else film]
    return {"kind": "coated", "films": films, "over": over, **keys}


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ({"kind": "miror"}, "must be one of 'mirror', 'black', .*'table' .did you mean 'mirror'"),
        ({}, "kind: missing"),
        ({"kind": ["mirror"]}, "kind = .*must be one of"),
        ({"kind": "mirror", "albedo": 1}, "albedo = 1: unknown key"),
        ({"kind": "black", "albedo": 0}, "albedo = 0: unknown key"),
        ({"kind": "none", "eta": 1}, "eta = 1: unknown key"),
        ({"kind": "lambert"}, "albedo: missing"),
        ({"kind": "lambert", "albedo": 1.01}, "albedo = 1.01: .*finite number, at least 0 and at most 1"),
        ({"kind": "lambert", "albedo": -0.01}, "at least 0 and at most 1"),
        ({"kind": "lambert", "albedo": [0.5, float("nan"), 0.5]}, "finite"),
        ({"kind": "lambert", "albedo": True}, "finite number"),
        ({"kind": "lambert", "albedo": "white"}, "finite number"),
        ({"kind": "lambert", "albedo": []}, "empty"),
        ({"kind": "lambert", "albedo": [0.1, 0.2]}, "2 values for 1 channel"),
        ({"kind": "lambert", "albdo": 0.5}, "did you mean 'albedo'"),
        ({"kind": "conductor"}, "name: missing; add name .*eta = ... and k = ..., or file"),
        ({"kind": "conductor", "eta": 0.2}, "k: missing"),
        ({"kind": "conductor", "k": 0.2}, "eta: missing"),
        ({"kind": "conductor", "eta": 0, "k": 3}, "eta = 0: .*above 0"),
        ({"kind": "conductor", "eta": 0.2, "k": -3}, "k = -3: .*at least 0"),
        ({"kind": "conductor", "eta": [0.2, 0.2, 0.2], "k": [1, 2]}, "2 values for 3 channel"),
        ({"kind": "conductor", "eta": 0.2, "k": 3, "name": "Au"}, "give name or eta, not both"),
        ({"kind": "conductor", "k": 3, "file": "metal.csv"}, "give file or k, not both"),
        ({"kind": "conductor", "name": "Au", "file": "metal.csv"}, "give name or file, not both"),
        ({"kind": "conductor", "name": 79}, "must be text"),
        ({"kind": "conductor", "name": "gold"}, "unknown name"),
        ({"kind": "conductor", "file": "none.csv"}, "there is no file .*none.csv; paths are relative"),
        ({"kind": "conductor", "file": "clear.csv"}, "no column k"),
        ({"kind": "dielectric"}, "name: missing; add name .*eta = ..., or file"),
        ({"kind": "dielectric", "eta": 0}, "eta = 0: .*above 0"),
        ({"kind": "dielectric", "eta": -1.5}, "above 0"),
        ({"kind": "dielectric", "eta": 1.5, "k": 0}, "k = 0: a dielectric is clear; .*conductor.*sigma_a"),
        ({"kind": "dielectric", "eta": 1.5, "name": "BK7"}, "give name or eta, not both"),
        ({"kind": "dielectric", "eta": [1.5, 1.4]}, "2 values for 1 channel"),
        ({"kind": "dielectric", "name": "Si"}, r"'Si': k = 0.261 at 405 nm.*conductor.*sigma_a .* = 8.1"),
        ({"kind": "dielectric", "file": "metal.csv"}, "file = 'metal.csv': k = 2.76 at 705 nm"),
        ({"kind": "dielectric", "name": "main/TiO2/Devore-o"}, "no data at 405 nm, only from 430"),
        ({"kind": "dielectric", "file": "index.csv"}, "no data at 615 nm, only from 400 to 600 nm"),
        ({"kind": "coated", "films": [{"eta": 1.5, "thickness_nm": 1}]}, "over: missing"),
        ({"kind": "coated", "over": {"kind": "conductor", "name": "Au"}}, "films: missing"),
        (coated(films=[]), "films = .*at least one table"),
        (coated(films={"eta": 1.5}), "films = .*list of at least one table"),
        (coated(films=[3]), "films 1 = '3': must be a table"),
        (coated({"eta": 1.5}), r"\[material films 1\] thickness_nm: missing"),
        (coated({"thickness_nm": 5}), r"\[material films 1\] name: missing; add"),
        (coated({"eta": 1.5, "thickness_nm": -5}), "thickness_nm = -5: .*at least 0"),
        (coated({"eta": 1.5, "thickness_nm": float("inf")}), "thickness_nm = inf: .*finite"),
        (coated({"eta": 1.5, "thickness": 5}), "did you mean 'thickness_nm'"),
        (coated({"eta": -1, "thickness_nm": 5}), "eta = -1: .*above 0"),
        (coated({"eta": 1, "k": -1, "thickness_nm": 5}), "k = -1: .*at least 0"),
        (
            coated({"eta": [1, 1.1, 1.2], "thickness_nm": 5}),
            "3 values, where colours come from spectra at 21",
        ),
        (coated({"name": "Glas", "thickness_nm": 5}), "unknown name"),
        (
            coated(over={"kind": "lambert", "albedo": 1}),
            r"\[material over\] kind = 'lambert': must be one of",
        ),
        (coated(over="Au"), "material over = 'Au': must be a table"),
        (coated(over={"kind": "conductor", "name": "au"}), "did you mean 'Au'"),
        ({"kind": "table"}, "file: missing"),
        ({"kind": "table", "file": "none.h5"}, "there is no file .*none.h5"),
        ({"kind": "table", "file": ""}, "must be text"),
    ],
)
def test_bad_materials(folder, material, message):
    with pytest.raises(InputError, match=message) as caught:
        build(material, folder=folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "material",
    [{"kind": "conductor", "name": "Au"}, {"kind": "dielectric", "file": "clear.csv"}, coated()],
    ids=["name", "file", "films"],
)
def test_spectra_need_wavelengths(folder, material):
    with pytest.raises(InputError, match="needs wavelengths; set wavelengths_nm"):
        build(material, {"channels": "grey"}, folder)


def test_a_list_beside_a_spectrum():
    surface = {"kind": "pits", "cover": 0.5, "plane": {"kind": "conductor", "name": "Au"}}
    material = {"kind": "lambert", "albedo": [0.8, 0.5, 0.2]}
    with pytest.raises(
        InputError, match="3 values, where colours come from spectra at 21 wavelengths; give one"
    ):
        parse_specimen({"surface": surface, "material": material})


@pytest.mark.parametrize(("k", "clear"), [(0.99e-4, True), (1.01e-4, False)])
def test_what_is_clear_enough(folder, k, clear):
    (folder / "k.csv").write_text(f"wavelength_nm,n,k\n500,1.5,{k}\n")
    material = {"kind": "dielectric", "file": "k.csv"}
    if clear:
        assert build(material, {"wavelengths_nm": [500]}, folder).material.eta == (1.5,)
    else:
        # 4 pi 1.01e-4 / 0.5 um
        with pytest.raises(InputError, match=r"sigma_a = 4 pi k / lambda = 0\.00254 per um"):
            build(material, {"wavelengths_nm": [500]}, folder)
