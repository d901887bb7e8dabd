"""Imports go one way, and each foreign library has one gateway."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FLOORS = ("microgeometry", "gonio", "fitting", "renderer")
GATEWAYS = {
    "embreex": {"gonio/core/embree.py", "gonio/bench/trace.py"},  # the benchmark measures embreex itself
    "numba": {"gonio/core/jit.py", "gonio/core/embree.py"},
    "llvmlite": {"gonio/core/embree.py"},
    "nlopt": {"fitting/"},
    "OpenEXR": {"renderer/image.py"},
    "h5py": {"gonio/formats/hdf5"},  # hdf5.py and its helpers
    "hdf5plugin": {"gonio/table/compress/codecs.py"},
}


def imports_of(source: str) -> set[str]:
    """Top-level packages a module imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {name.name.partition(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").partition(".")[0])
    return found


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("package", FLOORS)
def test_imports_go_down(package: str) -> None:
    above = set(FLOORS[FLOORS.index(package) + 1 :])
    wrong = {
        f"{s.relative_to(ROOT)} imports {up}"
        for s in sources(package)
        for up in imports_of(s.read_text()) & above
    }
    assert not wrong


@pytest.mark.parametrize("library", GATEWAYS)
def test_one_gateway(library: str) -> None:
    users = {
        s.relative_to(ROOT).as_posix()
        for p in FLOORS
        for s in sources(p)
        if library in imports_of(s.read_text())
    }
    stray = {u for u in users if not any(u.startswith(gate) for gate in GATEWAYS[library])}
    assert not stray
    assert users, f"nobody imports {library}: this test has lost its subject"


def test_imports_are_seen() -> None:
    source = "import a.b\nfrom c.d import e\ndef f():\n    from g import h\nfrom . import local\n"
    assert imports_of(source) == {"a", "c", "g"}
