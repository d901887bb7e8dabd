"""Batches on the workers of a dask scheduler: the same bits, also when one of them dies."""

from __future__ import annotations

import os
import signal
import sys

import numpy as np
import pytest

from gonio.trace.checkpoint import Checkpoint
from gonio.trace.measure import measure, run
from gonio.trace.measurement import Measurement
from gonio.validation import seed_from
from microgeometry.errors import InputError
from microgeometry.specimen import parse_specimen
from tests.trace.test_checkpoint import assert_same, specimen

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes of this machine."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp"
    ) as cluster:
        yield cluster


@pytest.mark.parametrize("options", [{"rays": 100_000}, {"rays": 400_000, "target_error": 0.15}])
def test_same_bits_as_here(cluster, options):
    here = measure(specimen(), seed=3, **options)
    assert_same(measure(specimen(), seed=3, dask=cluster.scheduler_address, **options), here)


def test_same_bits_when_a_worker_is_killed(cluster):
    """Killed in mid-run; the scheduler gives its batches to the other, and the nanny starts a new one."""
    options = {"rays": 2_000_000, "seed": 3}
    here = measure(specimen(), **options)
    killed = []

    def kill(fraction, _):
        if fraction > 0.25 and not killed:
            with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
                worker, pid = next(iter(client.run(os.getpid).items()))
            killed.append(worker)
            os.kill(pid, signal.SIGKILL)

    assert_same(measure(specimen(), progress=kill, dask=cluster.scheduler_address, **options), here)
    assert killed


def test_begun_here_and_ended_there(cluster, tmp_path):
    measurement = Measurement(specimen(), 100_000, 3)
    for _ in range(5):
        measurement.add_batch()
    Checkpoint(tmp_path / "t.h5", measurement).save()
    there = measure(specimen(), rays=100_000, seed=3, checkpoint=tmp_path / "t.h5", resume=True,
                    dask=cluster.scheduler_address)  # fmt: skip
    assert_same(there, measure(specimen(), rays=100_000, seed=3))


def test_ctrl_c_gives_up_what_is_under_way(cluster):
    measurement = Measurement(specimen(), 2_000_000, 3)

    def interrupt(fraction, _):
        if fraction > 0.2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(measurement, None, interrupt, None, cluster.scheduler_address)
    assert 0 < measurement.tally.batches < measurement.planned_batches
    straight = Measurement(specimen(), 2_000_000, 3)
    for _ in range(measurement.tally.batches):
        straight.add_batch()
    assert_same(measurement.table(), straight.table())


def test_a_height_map_travels_with_the_specimen(cluster, tmp_path):
    rng = np.random.default_rng(seed_from("travels"))
    np.save(tmp_path / "map.npy", rng.normal(size=(8, 8)) * 1e-8)
    spec = parse_specimen(
        {
            "surface": {"kind": "heightmap", "file": "map.npy", "units": "m", "size": [1e-6, 1e-6]},
            "material": {"kind": "mirror"},
            "grid": {"theta_step_deg": 15, "phi_step_deg": 30},
        },
        tmp_path,
    )
    here = measure(spec, rays=20_000)
    (tmp_path / "map.npy").unlink()
    assert_same(measure(spec, rays=20_000, dask=cluster.scheduler_address), here)


def test_nobody_at_the_address(monkeypatch):
    monkeypatch.setattr("gonio.trace.cluster._TIMEOUT", 0.5)
    for address in ("tcp://127.0.0.1:1", "nowhere", "tcp://"):
        with pytest.raises(InputError, match=r"dask: no scheduler answers at .*dask scheduler"):
            measure(specimen(), rays=1000, dask=address)


def test_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install gonio\[dask\]"):
        measure(specimen(), rays=1000, dask="tcp://127.0.0.1:1")


def test_another_version_on_the_workers_is_refused(cluster, monkeypatch):
    from gonio.trace import cluster as cluster_module

    versions = cluster_module.versions()
    monkeypatch.setattr(cluster_module, "versions", _Versions(versions))
    with pytest.raises(InputError, match=r"dask: worker .* has numba version .*, here it is 99\.0"):
        measure(specimen(), rays=1000, dask=cluster.scheduler_address)


class _Versions:
    """Other versions here than in the processes of the workers."""

    def __init__(self, versions):
        self._there, self._here = versions, os.getpid()

    def __call__(self):
        return {**self._there, "numba version": "99.0"} if os.getpid() == self._here else self._there


def test_no_workers():
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None, protocol="tcp") as empty,
        pytest.raises(InputError, match="has no workers"),
    ):
        measure(specimen(), rays=1000, dask=empty.scheduler_address)
