"""Checkpoints: a run killed at any moment and resumed leaves the same table, bit for bit."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import sys
import time

import numpy as np
import pytest

from gonio import Table
from gonio.cli import main
from gonio.table.parts import walk
from gonio.trace import checkpoint as checkpoint_module
from gonio.trace.checkpoint import Checkpoint, fingerprint
from gonio.trace.measure import measure, run
from gonio.trace.measurement import Measurement
from gonio.validation import seed_from
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen

GAUSSIAN = {"kind": "gaussian", "alpha": 0.5, "samples": 64, "size": 8}
GRID = {"theta_step_deg": 10, "phi_step_deg": 20, "orders": 2}
SPEC = """
[surface]
kind = "gaussian"
alpha = 0.5
samples = 64
size = 8
[material]
kind = "conductor"
name = "Au"
[grid]
theta_step_deg = 10
phi_step_deg = 20
orders = 2
"""
RAYS = 100_000


def specimen(alpha=0.5, **keys):
    material = {"kind": "conductor", "name": "Au"}
    return parse_specimen(
        {"surface": {**GAUSSIAN, "alpha": alpha, **keys}, "material": material, "grid": GRID}
    )


def assert_same(a, b):
    """The same numbers, and the same provenance but for the time it took."""
    tables = [dict(walk(t)) | {"": t} for t in (a, b)]
    assert list(tables[0]) == list(tables[1])
    for name, one in tables[0].items():
        for field in ("values", "std_error", "hits", "row_albedo", "albedo_std_error", "specular"):
            same = np.array_equal(getattr(one, field), getattr(tables[1][name], field))
            assert same, f"{name} {field}"
    assert a.ledger == b.ledger
    timed = ("seconds", "paths_per_second", "figure_of_merit", "command", "interrupted")
    facts = [{k: v for k, v in t.provenance.items() if k not in timed} for t in (a, b)]
    assert facts[0] == facts[1]


def interrupted(path, batches, spec=None, save=True, **options):
    """What a measurement leaves that ends after so many batches."""
    measurement = Measurement(spec or specimen(), **{"rays": RAYS, "seed": 3, **options})
    for _ in range(batches):
        measurement.add_batch()
    checkpoint = Checkpoint(path, measurement)
    if save:
        checkpoint.save()
    return checkpoint


@pytest.mark.parametrize("batches", [1, 5, 31, 32])
def test_resumed_is_uninterrupted(tmp_path, batches):
    straight = measure(specimen(), rays=RAYS, seed=3)
    checkpoint = interrupted(tmp_path / "t.h5", batches)
    resumed = measure(specimen(), rays=RAYS, seed=3, checkpoint=tmp_path / "t.h5", resume=True)
    assert_same(resumed, straight)
    assert not checkpoint.path.exists()


def test_resumed_is_uninterrupted_with_a_target(tmp_path):
    """Rows have different numbers of passes by then, and plans for the batches to come."""
    options = {"rays": 400_000, "seed": 3, "target_error": 0.15}
    straight = measure(specimen(), **options)
    assert len(set(straight.provenance["paths_of_rows"])) > 1
    batches = straight.provenance["batches"]
    for stop in (33, (32 + batches) // 2, batches - 1):
        interrupted(tmp_path / "t.h5", stop, **options)
        assert_same(measure(specimen(), checkpoint=tmp_path / "t.h5", resume=True, **options), straight)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"alpha": 0.6}, r"another specimen \('alpha = 0.5' there, 'alpha = 0.6' here\)"),
        ({"seed": 4}, "begun with seed 3, not 4"),
        ({"rays": 2 * RAYS}, "begun with rays 100000, not 200000"),
        ({"seconds": 5.0, "rays": None}, "begun with rays 100000, not none"),
        ({"target_error": 0.1}, "begun with target error none, not 0.1"),
    ],
)
def test_another_measurement_is_refused_with_the_reason(tmp_path, changed, words):
    checkpoint = interrupted(tmp_path / "t.h5", 1)
    before = checkpoint.path.read_bytes()
    spec = specimen(changed.pop("alpha", 0.5))
    with pytest.raises(InputError, match=rf"t.h5.checkpoint: .*{words}.*delete"):
        measure(spec, **{"rays": RAYS, "seed": 3, "checkpoint": tmp_path / "t.h5", "resume": True, **changed})
    assert checkpoint.path.read_bytes() == before


def test_another_version_is_refused(tmp_path, monkeypatch):
    interrupted(tmp_path / "t.h5", 1)
    versions = checkpoint_module.versions()
    monkeypatch.setattr(checkpoint_module, "versions", lambda: {**versions, "numba version": "99.0"})
    with pytest.raises(InputError, match=r"begun with numba version .*, not 99\.0"):
        measure(specimen(), rays=RAYS, seed=3, checkpoint=tmp_path / "t.h5", resume=True)


def test_a_changed_file_is_another_specimen(tmp_path):
    rng = np.random.default_rng(seed_from("changed file"))
    np.save(tmp_path / "map.npy", rng.normal(size=(8, 8)) * 1e-8)
    surface = {"kind": "heightmap", "file": "map.npy", "units": "m", "size": [1e-6, 1e-6]}
    mapping = {"surface": surface, "material": {"kind": "mirror"}, "grid": GRID}
    spec = parse_specimen(mapping, tmp_path)
    interrupted(tmp_path / "t.h5", 1, spec)
    assert fingerprint(parse_specimen(mapping, tmp_path)) == fingerprint(spec)
    np.save(tmp_path / "map.npy", rng.normal(size=(8, 8)) * 1e-8)
    with pytest.raises(InputError, match="another specimen, or a file it names has changed"):
        measure(
            parse_specimen(mapping, tmp_path), rays=RAYS, seed=3, checkpoint=tmp_path / "t.h5", resume=True
        )


def test_a_comment_is_no_other_specimen():
    spec = specimen()
    assert fingerprint(spec) == fingerprint(type(spec)(spec.layers, spec.grid, "# better\n" + spec.text, "x"))
    assert fingerprint(spec) != fingerprint(specimen(alpha=0.5 + 1e-12))


def test_an_unfinished_measurement_is_not_thrown_away(tmp_path):
    checkpoint = interrupted(tmp_path / "t.h5", 1)
    with pytest.raises(InputError, match=r"t\.h5\.checkpoint: an unfinished .*--resume .*delete"):
        measure(specimen(), rays=RAYS, checkpoint=tmp_path / "t.h5")
    assert checkpoint.path.exists()


def test_temporary_files_of_killed_processes_are_removed(tmp_path):
    left = [".t-abcd1234.h5", ".t.h5-abcd1234.checkpoint"]
    others = [".t2-abcd1234.h5", ".t-abcd1234.txt", "t-abcd1234.h5"]
    for name in (*left, *others):
        (tmp_path / name).touch()
    measure(specimen(), rays=1000, checkpoint=tmp_path / "t.h5", every=0.0)
    assert {p.name for p in tmp_path.iterdir()} == set(others)


@pytest.mark.parametrize("damage", ["empty", "truncated", "foreign", "flipped", "other arrays"])
def test_a_damaged_checkpoint_is_refused(tmp_path, damage):
    checkpoint = interrupted(tmp_path / "t.h5", 1)
    whole = checkpoint.path.read_bytes()
    if damage == "other arrays":
        with open(checkpoint.path, "wb") as file:
            np.savez(file, a=np.zeros(3))
    else:
        middle = len(whole) // 2
        checkpoint.path.write_bytes(
            {
                "empty": b"",
                "truncated": whole[:middle],
                "foreign": b"not an archive at all",
                "flipped": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
            }[damage]
        )
    with pytest.raises(InputError, match=r"t\.h5\.checkpoint: damaged.*delete"):
        measure(specimen(), rays=RAYS, seed=3, checkpoint=tmp_path / "t.h5", resume=True)


def test_when_a_checkpoint_is_due(tmp_path, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(checkpoint_module.time, "monotonic", lambda: clock[0])
    measurement = Measurement(specimen(), rays=RAYS)
    checkpoint = Checkpoint(tmp_path / "t.h5", measurement)
    saved = []

    def save():
        saved.append(clock[0])
        clock[0] += 7.0  # a slow disk

    monkeypatch.setattr(checkpoint, "save", save)
    while clock[0] < 250:
        checkpoint.save_if_due()
        clock[0] += 1.0
    # after 30 s; then not before ten times what writing takes
    assert saved == [30.0, 107.0, 184.0]
    with pytest.raises(InputError, match="checkpoint: -1"):
        Checkpoint(tmp_path / "t.h5", measurement, -1.0)


def test_no_checkpoints_on_request(tmp_path):
    measurement = Measurement(specimen(), rays=RAYS)
    checkpoint = Checkpoint(tmp_path / "t.h5", measurement, 0.0)
    run(measurement, None, None, checkpoint)
    assert list(tmp_path.iterdir()) == []


def trace(folder, out, rays):
    """`gonio trace` with a checkpoint after every batch, in a process of its own."""
    arguments = f"spec.toml -o {out} --rays {rays} --seed 3 --checkpoint 1e-9 --resume"
    sys.argv = ["gonio", "trace", *arguments.split()]
    os.chdir(folder)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background processes ignore
    sys.stdout = sys.stderr = open(f"{out}.txt", "a", buffering=1)  # noqa: SIM115 (until the process ends)
    main()


@pytest.fixture(scope="module")
def spawn():
    """Starts such processes, forked from one that has everything imported: kills shall meet the run."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])

    def start(folder, out, rays=RAYS):
        (folder / "spec.toml").write_text(SPEC)
        process = context.Process(target=trace, args=(str(folder), out, rays))
        process.start()
        return process

    return start


def kill_and_resume(spawn, folder, times, seed):
    """Kill runs at random moments, until there were so many kills; every run must end with the same table.

    Every other kill waits for a checkpoint first: on a busy machine a process takes long to start. Returns how many
    processes found one.
    """
    rays, chance = 400_000, random.Random(seed)
    for _ in range(2):  # once to compile
        started = time.monotonic()
        process = spawn(folder, "straight.h5", rays)
        process.join()
        whole = time.monotonic() - started
    straight = Table.load(folder / "straight.h5")
    killed = resumed = runs = 0
    while killed < times:
        runs += 1
        out = f"t{runs}.h5"
        checkpoint, log = folder / f"{out}.checkpoint", folder / f"{out}.txt"
        exitcode = None
        while exitcode != 0:
            found, said = checkpoint.exists(), log.read_text() if log.exists() else ""
            resumed += found
            process = spawn(folder, out, rays)
            aimed = killed % 2 == 1
            while aimed and process.is_alive() and not checkpoint.exists():
                time.sleep(0.005)
            process.join(chance.uniform(0.0, 0.2 * whole if aimed else whole))
            process.kill()
            process.join()
            exitcode = process.exitcode
            assert exitcode in (0, -signal.SIGKILL), log.read_text()
            killed += exitcode != 0
        assert ("going on after" in log.read_text()[len(said) :]) == found
        assert_same(Table.load(folder / out), straight)
        # neither checkpoints nor temporary files
        left = {p.name for p in folder.iterdir() if p.name.startswith((f"{out}.", f".{out[:-3]}"))}
        assert left == {f"{out}.txt"}
    return resumed


@pytest.mark.compiled
def test_killed_and_resumed(spawn, tmp_path):
    assert kill_and_resume(spawn, tmp_path, 3, "a few") >= 1


@pytest.mark.slow
@pytest.mark.compiled
def test_killed_fifty_times_and_resumed(spawn, tmp_path):
    assert kill_and_resume(spawn, tmp_path, 50, "fifty") >= 20


@pytest.mark.compiled
def test_ctrl_c_saves_a_table_and_goes_on(spawn, tmp_path):
    """A real SIGINT in the middle; of a run so long that it is still there when a busy machine gets to it."""
    rays = 30_000_000
    process = spawn(tmp_path, "t.h5", rays)
    checkpoint = tmp_path / "t.h5.checkpoint"
    while not checkpoint.exists() and process.is_alive():
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGINT)
    process.join()
    said = (tmp_path / "t.h5.txt").read_text()
    assert process.exitcode == 130, said
    assert "--resume goes on" in said
    assert Table.load(tmp_path / "t.h5").provenance["interrupted"] is True
    assert checkpoint.exists()
    for name in ("t.h5", "straight.h5"):
        process = spawn(tmp_path, name, rays)
        process.join()
        assert process.exitcode == 0
    assert not checkpoint.exists()
    assert_same(Table.load(tmp_path / "t.h5"), Table.load(tmp_path / "straight.h5"))
