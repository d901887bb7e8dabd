"""`gonio demo`: the whole pipeline once, small: trace, check, compress, fit, render, compare, report."""

from __future__ import annotations

import json
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from fitting.fit import fit
from fitting.result import Fit
from gonio import formats
from gonio.core import jit
from gonio.core.parallel import processors
from gonio.files import atomic
from gonio.progress import progress_bar
from gonio.resources import data_folder
from gonio.table.checks import check, relative_noise
from gonio.table.compress import compress
from gonio.table.table import Table
from gonio.trace.measure import measure
from microgeometry.errors import InputError
from microgeometry.specimen import Specimen, load_specimen, parse_specimen
from renderer import plots
from renderer.compare import Difference, side_by_side
from renderer.image import Image
from renderer.mitsuba_xml import load_scene
from renderer.page import image_html, rows_html
from renderer.render import render
from renderer.report import write_report
from renderer.scene import Scene

_WIDTH, _HEIGHT, _SPP = 480, 300, 96
_MESHES = (".obj", ".ply", ".stl", ".glb", ".gltf")

Say = Callable[[str], None]


@dataclass(frozen=True)
class Stage:
    """One stage of the demo: how long it took, how fast it went and how wrong its result is."""

    name: str
    seconds: float
    speed: str
    error: str


@dataclass(frozen=True)
class _Case:
    """A specimen, the folder that files it names are relative to, and the model that should describe it."""

    name: str
    specimen: Specimen
    folder: Path
    model: str


class Demo:
    """One run of the demo; `stages` fills as it goes.

    Parameters
    ----------
    folder : Path
        Where everything is left; made if missing.
    specimen : Path, optional
        A specimen's TOML, a mesh or a measured height map to take the place of the rough gold; a mesh or
        map is given facets of gold.
    say : callable
        Called with a line now and then.
    """

    def __init__(self, folder: Path, specimen: Path | None = None, say: Say = lambda line: None) -> None:
        self.folder = folder
        self.say = say
        self.stages: list[Stage] = []
        examples = data_folder() / "specimens"
        first = (
            _Case("gold", load_specimen(examples / "gold.toml"), examples, "cook_torrance_beckmann")
            if specimen is None
            else _users_case(specimen)
        )
        second = load_specimen(examples / "rough_lambert.toml")
        lambertian = _Case("rough_lambert", second, examples, "oren_nayar")
        self._cases = (first, lambertian)
        folder.mkdir(parents=True, exist_ok=True)

    def run(self) -> dict[str, Any]:
        """Run all stages; returns, and leaves in summary.json, what each measured."""
        begun = time.perf_counter()
        main, other = self._cases
        self._compile()
        table, fitted = self._measure_and_fit(main)
        compressed = self._compress(main, table)
        difference = self._render(main)
        pictures = image_html((self.folder / f"{main.name}_compared.png").read_bytes())
        other_table, other_fit = self._measure_and_fit(other)
        with self._stage("report") as result:
            sections = [
                ("Rendered with the table, the compressed table and the fit", pictures),
                ("Speed and error of each stage", rows_html(("stage", "s", "speed", "error"), self._rows())),
            ]
            self._report(main, table, fitted, sections, {"compressed": compressed})
            self._report(other, other_table, other_fit, [], {})
            result.update(speed="", error="")
        summary = {
            "report": str(self.folder / f"{main.name}_report.html"),
            "seconds": time.perf_counter() - begun,
            "stages": [asdict(stage) for stage in self.stages],
            "fits": {c.name: f.to_json() for c, f in ((main, fitted), (other, other_fit))},
            "surface": table.provenance["surface"],
            "renders": {name: asdict(d) for name, d in difference.items()},
        }
        with atomic(self.folder / "summary.json") as temporary:
            temporary.write_text(json.dumps(summary, indent=2, default=float) + "\n")
        return summary

    def _compile(self) -> None:
        """Use every kernel once on next to nothing, so that the other stages' times are theirs alone."""
        with self._stage("compile") as result, tempfile.TemporaryDirectory() as name:
            with _meanwhile(_render_black, Path(name)):
                for case in self._cases:
                    grid = replace(case.specimen.grid, theta_step_deg=10, phi_step_deg=20, theta_i_deg=None)
                    table = measure(replace(case.specimen, grid=grid), seconds=1e-3)
                    fitted = fit(table, case.model)
                    fitted.table(table)
            table.save(Path(name, "table.h5"))
            fitted.save(Path(name, "fit.json"))
            for kind, file in (("tabulated", "table.h5"), ("analytic", "fit.json")):
                render(_scene(Path(name, file), kind, 16, 16), spp=1)
            result.update(speed="once a machine", error="")

    def _measure_and_fit(self, case: _Case) -> tuple[Table, Fit]:
        path = self.folder / f"{case.name}.h5"
        with self._stage(f"trace {case.name}") as result, progress_bar(f"trace {case.name}") as report:
            table = measure(case.specimen, progress=report)
            table.save(path)
            facts = table.provenance
            result.update(
                speed=f"{facts['paths_per_second'] / 1e6:.2f} M paths/s",
                error=f"albedo ± {table.albedo_std_error.max():.1e}, cell ± {relative_noise(table).mean():.0%}",
            )
        with self._stage(f"check {case.name}") as result:
            checks = check(table)
            result.update(speed="", error="passed" if checks.passed else "FAILED: see the report")
        with self._stage(f"fit {case.name}") as result, progress_bar(f"fit {case.name}") as report:
            fitted = fit(table, case.model, progress=report)
            fitted.save(self.folder / f"{case.name}_{case.model}.json")
            relative = fitted.residuals["relative_ngan_l2"]
            result.update(
                speed=f"{fitted.evaluations} evaluations in {fitted.seconds:.1f} s",
                error=f"relative L2 {relative:.3f} on cells, noise included; {_shape(fitted)}",
            )
        return table, fitted

    def _compress(self, case: _Case, table: Table) -> Table:
        path = self.folder / f"{case.name}_compressed.h5"
        with self._stage("compress") as result:
            report = compress(table, path, method="tree")  # which "auto" would choose, after trying all
            result.update(
                speed=f"{report.ratio:.0f}:1, {report.bytes / 1e3:.0f} kB",
                error=f"{report.error_median:.3f} of a row, its noise {report.noise_median:.3f}",
            )
        return formats.read(path)

    def _render(self, case: _Case) -> dict[str, Difference]:
        sources = {
            "table": ("tabulated", f"{case.name}.h5"),
            "compressed table": ("tabulated", f"{case.name}_compressed.h5"),
            "fit": ("analytic", f"{case.name}_{case.model}.json"),
        }
        images: dict[str, Image] = {}
        for seed, (label, (kind, file)) in enumerate(sources.items()):
            with self._stage(f"render {label}") as result, progress_bar(f"render {label}") as report:
                scene = _scene(self.folder / file, kind, _WIDTH, _HEIGHT)
                image = images[label] = render(scene, spp=_SPP, seed=seed, progress=report)
                stem = self.folder / f"{case.name}_{label.replace(' ', '_')}"
                image.save(stem.with_suffix(".exr"))
                image.save(stem.with_suffix(".png"))
                result.update(
                    speed=f"{image.provenance['paths_per_second'] / 1e6:.2f} M paths/s",
                    error=f"noise {image.noise:.1%} of a pixel",
                )
        differences = side_by_side(
            images, self.folder / f"{case.name}_compared.png", title=case.specimen.name
        )
        for label, d in differences.items():
            self.say(
                f"  {label} against table: relative RMSE {d.relative_rmse:.2%} (noise explains {d.noise_rmse:.2%}), "
                f"bias {d.bias:+.2%}"
            )
        return differences

    def _report(
        self, case: _Case, table: Table, fitted: Fit, sections: list, overlays: dict[str, Table]
    ) -> None:
        report = self.folder / f"{case.name}_report.html"
        overlays = {**overlays, case.model: plots.overlay(fitted)}
        title, fits = case.specimen.name, {case.model: fitted}
        write_report(table, report, fits, sections, title, overlays, case.folder)
        for name, figure in (
            ("lobes", plots.lobes(table, overlays)),
            ("albedo", plots.albedo(table, overlays)),
            ("hemisphere", plots.hemisphere(table)),
        ):
            with atomic(self.folder / f"{case.name}_{name}.png") as temporary:
                figure.savefig(temporary, dpi=120, format="png")

    def _rows(self) -> list[tuple[str, str, str, str]]:
        return [(s.name, f"{s.seconds:.1f}", s.speed, s.error) for s in self.stages]

    @contextmanager
    def _stage(self, name: str) -> Iterator[dict[str, str]]:
        """Time a stage; the block puts `speed` and `error` in words into the dictionary it is given."""
        begun = time.perf_counter()
        result: dict[str, str] = {}
        yield result
        stage = Stage(name, time.perf_counter() - begun, result["speed"], result["error"])
        self.stages.append(stage)
        self.say(f"{stage.name:26s} {stage.seconds:6.1f} s  {stage.speed:28s} {stage.error}")


@contextmanager
def _meanwhile(use: Callable[[Path], None], folder: Path) -> Iterator[None]:
    """Let a second process compile what `use` needs into the cache on disk, where nothing is there yet.

    Should it fail, it says so, and this process compiles what is missing.
    """
    fresh = not jit.disabled and not any(jit.cache_directory("renderer").rglob("*.nbi"))
    if not fresh or processors() < 2:
        yield
        return
    process = multiprocessing.get_context("spawn").Process(target=use, args=(folder,), daemon=True)
    process.start()
    try:
        yield
        process.join()
    finally:  # Ctrl-C ends both
        process.terminate()
        process.join()


def _render_black(folder: Path) -> None:
    """Use the renderer's kernels, more than a third of what there is to compile."""
    Fit("lambert", (), ("R", "G", "B")).table().save(folder / "black.h5")
    render(_scene(folder / "black.h5", "tabulated", 16, 16), spp=1)


def _scene(file: Path, kind: str, width: int, height: int) -> Scene:
    """The demo's spheres with a material from a file."""
    parameters = {"table": str(file.resolve()), "kind": kind, "width": str(width), "height": str(height)}
    return load_scene(data_folder() / "scenes" / "spheres.xml", parameters)


def _users_case(path: Path) -> _Case:
    """A specimen from a TOML file, or gold facets on a mesh or a measured height map."""
    if path.suffix.lower() == ".toml":
        specimen = load_specimen(path)
        if specimen.grid.anisotropic:
            raise InputError(
                f"{path}: the demo fits and compresses, which is for isotropic tables; leave out anisotropic = true, "
                "or use gonio trace and gonio render"
            )
        rough = specimen.material.kind == "lambert"
        return _Case(path.stem, specimen, path.parent, "oren_nayar" if rough else "cook_torrance_beckmann")
    if not path.is_file():
        raise InputError(
            f"{path}: no such file; a specimen (.toml), a mesh or a measured height map is expected"
        )
    kind = "mesh" if path.suffix.lower() in _MESHES else "heightmap"
    surface = {"kind": kind, "file": str(path.resolve()), "tiling": "mirror"}
    if kind == "heightmap":
        surface["holes"] = "fill"
    specimen = parse_specimen(
        {"surface": surface, "material": {"kind": "conductor", "name": "Au"}}, path.parent
    )
    return _Case(path.stem, specimen, path.parent, "cook_torrance_beckmann")


def _shape(fitted: Fit) -> str:
    return ", ".join(f"{n} {v:.4f}" for lobe in fitted.lobes for n, v in lobe.parameters.items())
