"""The demo's second process, which compiles while the first does."""

from __future__ import annotations

import multiprocessing
import os

import pytest

from gonio.core import jit
from renderer import demo


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, on a machine of two processors."""
    monkeypatch.setattr(jit, "disabled", False)
    monkeypatch.setattr(jit, "cache_directory", lambda package: tmp_path)
    monkeypatch.setattr(demo, "processors", lambda: 2)
    return tmp_path


def _fail_when_told(pipe):
    pipe.read_text()
    pipe.with_name("used").touch()
    raise OSError("no room on the disk")


def test_the_second_process_is_waited_for_and_tells_its_error(cache, capfd):
    os.mkfifo(cache / "pipe")
    with demo._meanwhile(_fail_when_told, cache / "pipe"):
        (cache / "pipe").write_text("go on")
    assert (cache / "used").exists()
    assert "no room on the disk" in capfd.readouterr().err


def test_ctrl_c_ends_the_second_process(cache):
    os.mkfifo(cache / "pipe")
    with pytest.raises(KeyboardInterrupt), demo._meanwhile(_fail_when_told, cache / "pipe"):
        raise KeyboardInterrupt
    assert multiprocessing.active_children() == []
    assert not (cache / "used").exists()


@pytest.mark.parametrize("why", ["compiled", "one processor", "NUMBA_DISABLE_JIT"])
def test_there_is_no_second_process_where_it_helps_nobody(cache, monkeypatch, why):
    if why == "compiled":
        (cache / "kernel.nbi").touch()
    elif why == "one processor":
        monkeypatch.setattr(demo, "processors", lambda: 1)
    else:
        monkeypatch.setattr(jit, "disabled", True)
    monkeypatch.setattr(
        demo.multiprocessing, "get_context", lambda method: pytest.fail("a process was started")
    )
    with demo._meanwhile(_fail_when_told, cache / "pipe"):
        pass
