"""The materials of MERL: the grid they are looked at on, their networks, what is printed of their fits."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from fitting import merl
from fitting.commands import fit_merl_command
from gonio.core.directions import direction

LINE = (
    "made-up = Aggregate(Lambertian(albedo = [0.3, 0.2, 0.1]), "
    "NganWard(albedo = [0.1, 0.1, 0.1], roughness = 0.2))\n"
)


def networks(folder: Path, *names: str) -> Path:
    """Networks of one colour: ln(1 + f) = 0.1 cos theta_d + 0.2."""
    arrays = {}
    for name in names:
        first, last = np.zeros((6, 21)), np.zeros((21, 3))
        first[5, 0], last[0] = 0.1, 1.0
        middle = np.eye(21)
        layers = (first, np.zeros(21), middle, np.zeros(21), last, np.full(3, 0.2))
        arrays |= {f"merl/{name}|{n}": a.astype(np.float32) for n, a in enumerate(layers)}
    np.savez(folder / merl.NETWORKS, **arrays)
    return folder


def test_pairs_are_cells_of_merl() -> None:
    theta_i, theta_r, delta_phi = merl.pairs()
    assert theta_i.shape == theta_r.shape == delta_phi.shape == (31_214,)
    assert max(theta_i.max(), theta_r.max()) <= np.radians(80.0)
    wi, wo = direction(theta_i), direction(theta_r, delta_phi)
    half = wi + wo
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    theta_h = np.degrees(np.arccos(np.minimum(1.0, half[:, 2])))
    theta_d = np.degrees(np.arccos(np.minimum(1.0, np.sum(wi * half, axis=1))))
    # MERL's index is 90 sqrt(theta_h / 90 degrees), and theta_d in degrees: ours are cells' centres, every fifth
    assert np.sqrt(theta_h / 90.0) * 90.0 % 1.0 == pytest.approx(0.5, abs=1e-4)
    assert theta_d % 5.0 == pytest.approx(0.5, abs=1e-4)
    # the azimuth of wi about the half vector: every sixth of a turn, as it is or, mirrored, its opposite
    along = half - half[:, 2:] * [0.0, 0.0, 1.0]
    across = np.cross([0.0, 0.0, 1.0], along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    y = np.abs(np.sum(wi * across, axis=1)) / np.sin(np.radians(theta_d))
    centres = np.sin(np.radians(np.arange(0.5, 180.0, 6.0)))
    assert np.min(np.abs(y[:, None] - centres), axis=1).max() < 1e-4


def test_a_network_by_hand(tmp_path: Path) -> None:
    with np.load(networks(tmp_path, "made-up") / merl.NETWORKS) as file:
        # retro-reflection: theta_d = 0; mirror at 60 degrees: theta_d = 60
        wi = direction(np.radians([60.0, 60.0]))
        found = merl.decode(file, "made-up", wi, direction(np.radians([60.0, 60.0]), np.array([0.0, np.pi])))
    assert found == pytest.approx(np.exp([[0.3] * 3, [0.25] * 3]) - 1.0, rel=1e-6)


@pytest.mark.compiled
def test_published_fits_are_judged_with_the_factors_of_the_channels(tmp_path: Path) -> None:
    (tmp_path / "ngan_ward.fit").write_text("# of Ward's model\n" + LINE)
    samples = merl.measurements(networks(tmp_path, "made-up"), "made-up")
    found = merl.published(tmp_path, "made-up", samples)
    assert list(found) == ["ngan_ward"]
    # the same numbers put together by hand: Ward's lobe and Lambert's, times 1, 1.15, 1.66
    theta_i, theta_r, delta_phi = merl.pairs()
    cos_d = np.cos(theta_i) * np.cos(theta_r) + np.sin(theta_i) * np.sin(theta_r) * np.cos(delta_phi)
    cos_h = (np.cos(theta_i) + np.cos(theta_r)) / np.sqrt(2.0 + 2.0 * cos_d)
    tan2 = 1.0 / cos_h**2 - 1.0
    ward = np.exp(-tan2 / 0.04) / (4 * np.pi * 0.04 * np.sqrt(np.cos(theta_i) * np.cos(theta_r)))
    factors = np.array([1.0, 1.15, 1.66])
    model = factors * (0.1 * ward[:, None] + np.array([0.3, 0.2, 0.1]) / np.pi)
    weight = (np.cos(theta_i) ** 2 * np.sin(theta_i) * np.sin(theta_r))[:, None]
    error = np.sum(weight * (model - samples.values) ** 2) / np.sum(weight * samples.values**2)
    assert found["ngan_ward"]["relative_ngan_l2"] == pytest.approx(np.sqrt(error), rel=1e-6)
    assert merl.published(tmp_path, "another", samples) == {}


def test_medians_and_what_is_printed_of_them() -> None:
    def metrics(error: float) -> dict[str, float]:
        return {"relative_ngan_l2": error, "low_log": 10 * error}

    found = {
        "a": {"ward": metrics(0.1), "lambert": metrics(0.9), "ngan_ward": metrics(0.2)},
        "b": {"ward": metrics(0.3), "lambert": metrics(0.7), "ngan_ward": metrics(0.6)},
        "c": {"ward": metrics(0.8), "lambert": metrics(0.8)},
    }
    assert merl.medians(found)["ward"] == (0.3, 3.0, 3)
    lines = [line.split() for line in merl.report(found)]
    assert [line[0] for line in lines[1:3]] == ["ward", "lambert"]
    # beside the published fits of two materials stand ours of the same two: (.1 + .3)/2
    assert lines[4] == ["ngan_ward", "2", "0.400", "0.200", "ward"]


@pytest.mark.compiled
def test_the_command_fits_every_model_to_a_folder_of_networks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ngan_ward.fit").write_text(LINE)
    # in this process, with two models, each with the numbers of lobes it can have
    monkeypatch.setattr(merl, "isotropic_models", lambda: ["lambert", "ward"])
    monkeypatch.setattr(merl, "ProcessPoolExecutor", InThisProcess)
    arguments = [networks(tmp_path, "made-up", "another"), "--published", tmp_path, "-o", tmp_path / "M.json"]
    result = CliRunner().invoke(fit_merl_command, [str(a) for a in arguments], standalone_mode=False)
    assert result.exception is None, result.exception
    assert "2 materials" in result.stdout
    content = json.loads((tmp_path / "M.json").read_text())
    assert set(content["made-up"]) == {"lambert", "ward", "ward+ward+lambert", "ngan_ward"}
    assert set(content["another"]) == {"lambert", "ward", "ward+ward+lambert"}
    assert content["made-up"]["ward"]["relative_ngan_l2"] <= content["made-up"]["lambert"]["relative_ngan_l2"]


class InThisProcess:
    """Stands in for a pool of processes, which would each compile and see no monkeypatch."""

    def __init__(self, *arguments: object) -> None:
        pass

    def __enter__(self) -> InThisProcess:
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def submit(self, task, *arguments: object) -> InThisProcess:
        done = InThisProcess()
        done.value = task(*arguments)
        return done

    def result(self):
        return self.value
