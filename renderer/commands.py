"""Commands of the renderer."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import click

from gonio.files import check_writable
from gonio.progress import progress_bar
from microgeometry.errors import InputError
from renderer.mitsuba_xml import load_scene
from renderer.render import render


@click.command("render")
@click.argument("scene_path", metavar="SCENE.xml", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="EXR; a PNG goes beside it."
)
@click.option("--spp", type=int, help="Samples a pixel; the scene's sample_count by default.")
@click.option("--seed", type=int, default=0, show_default=True, help="Another seed, other noise.")
@click.option("--threads", type=int, help="All cores by default; the picture does not depend on it.")
@click.option("-D", "defines", metavar="NAME=VALUE", multiple=True, help="Value of a $name in the scene.")
def render_command(
    scene_path: Path,
    output: Path,
    spp: int | None,
    seed: int,
    threads: int | None,
    defines: tuple[str, ...],
) -> None:
    """Render a Mitsuba scene to an EXR with error bars and a tone-mapped PNG.

    Ctrl-C saves the picture as far as it is; a second one stops at once.
    """
    if output.suffix.lower() != ".exr":
        raise InputError(f"{output}: the picture is an EXR; a name that ends in .exr is needed")
    check_writable(output)
    scene = load_scene(scene_path, _parameters(defines))
    with _interruptible() as stop, progress_bar(f"Rendering {scene_path.name}") as report:
        image = render(scene, spp=spp, seed=seed, threads=threads, progress=report, stop=stop)
    image.save(output)
    image.save(output.with_suffix(".png"))
    facts = image.provenance
    wanted = scene.spp if spp is None else spp
    short = f" of {wanted}, interrupted" if facts["spp"] < wanted else ""
    click.echo(
        f"{output}: {scene.camera.width} x {scene.camera.height}, {facts['spp']} spp{short}, "
        f"{facts['seconds']:.1f} s, {facts['paths_per_second'] / 1e6:.2f} M paths/s, "
        f"noise {100 * image.noise:.2g} %"
    )


def _parameters(defines: tuple[str, ...]) -> dict[str, str]:
    parameters = {}
    for text in defines:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError(f"-D {text}: is not NAME=VALUE")
        parameters[name] = value
    return parameters


@contextmanager
def _interruptible() -> Iterator:
    """Ctrl-C makes the yielded function say True; a second Ctrl-C raises KeyboardInterrupt."""
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
        yield pressed.is_set
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if pressed.is_set():
            signal.default_int_handler(number, frame)
        pressed.set()

    previous = signal.signal(signal.SIGINT, handle)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, previous)


@click.command()
@click.argument("table", type=click.Path(path_type=Path))
@click.argument("fits", metavar="[FIT.json ...]", nargs=-1, type=click.Path(path_type=Path))
@click.option("-o", "--out", required=True, type=click.Path(path_type=Path), help="The HTML file.")
def report(table: Path, fits: tuple[Path, ...], out: Path) -> None:
    """Write what is in a table, and how fits describe it, as one HTML page with plots.

    Files that the specimen names (a height map, a mesh) are looked for beside the table.
    """
    from fitting.result import Fit
    from gonio import formats
    from renderer.report import write_report

    check_writable(out)
    with progress_bar(f"Report of {table.name}") as progress:
        write_report(
            formats.read(table) if fits else formats.read_any(table),
            out,
            {path.stem: Fit.load(path) for path in fits},
            folder=table.parent,
            progress=progress,
        )
    click.echo(f"{out}: written")


@click.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("gonio-demo"),
    show_default=True,
    help="Folder to fill.",
)
@click.option(
    "--specimen",
    type=click.Path(path_type=Path),
    help="A specimen (.toml), a mesh, or a measured height map, in place of the rough gold.",
)
def demo(out: Path, specimen: Path | None) -> None:
    """Run the whole pipeline once, small: trace, check, compress, fit, render, report.

    Traces a rough gold surface and a rough Lambertian one, and leaves tables, fits, pictures, plots, a
    report of each and summary.json in a folder.
    """
    from renderer.demo import Demo

    summary = Demo(out, specimen, click.echo).run()
    click.echo(f"{summary['seconds']:.0f} s in all; look at {summary['report']}")


COMMANDS: tuple[click.Command, ...] = (render_command, report, demo)
