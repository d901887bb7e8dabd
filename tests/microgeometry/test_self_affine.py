import numpy as np
import pytest

from microgeometry.errors import InputError
from tests.microgeometry.conftest import z_score


@pytest.mark.parametrize("keys", [{"samples": 128}, {"samples": 129, "size": 5, "cutoff_length": 0.4}])
def test_expected_statistic_of_the_mesh_is_the_one_asked_for(specimen_of, keys):
    surface = specimen_of("self_affine", hurst=0.7, alpha=0.3, **keys).surface
    z, relative = z_score([surface.realise(seed).statistics().alpha ** 2 for seed in range(40)], 0.09)
    assert z < 4
    assert relative < 0.02
    surface = specimen_of("self_affine", hurst=0.7, rms_height=0.3, rolloff_length=1, **keys).surface
    squares = [surface.realise(seed).statistics().rms_height ** 2 for seed in range(40)]
    assert z_score(squares, 0.09e-12)[0] < 4


@pytest.mark.parametrize("hurst", [0.3, 0.8])
def test_spectrum_is_the_power_law(specimen_of, hurst):
    # Means over rings of modes relative to the flat part: 1 below the roll-off, (q / q_r)^(-2 - 2 H) above,
    # nothing beyond the cut-off. 128 samples over 8 roll-offs: the roll-off is mode 8, the cut-off mode 24.
    surface = specimen_of(
        "self_affine", hurst=hurst, alpha=0.3, samples=128, rolloff_length=3, cutoff_length=1
    ).surface
    power = sum(np.abs(np.fft.fft2(surface.realise(seed).heights)) ** 2 for seed in range(40)) / 40
    modes = np.fft.fftfreq(128, 1 / 128)
    q = np.hypot(modes[:, None], modes)
    law = np.maximum(q / 8, 1.0) ** (-2 - 2 * hurst)
    low = (q > 0) & (q < 8)
    flat = power[low].mean()
    for ring in ((q > 8) & (q < 11), (q > 11) & (q < 17), (q > 17) & (q <= 24)):
        # A mode is exponential: its relative error is 1/sqrt(40), modes q and -q are one.
        error = np.sqrt(2 / 40) * np.sqrt(1 / ring.sum() + 1 / low.sum())
        assert error < 0.03
        assert abs((power[ring] / law[ring]).mean() / flat - 1) < 4 * error
    assert power[q > 24.001].max() < 1e-20 * flat
    assert power[0, 0] < 1e-20 * flat


def test_two_rolloff_lengths_stretch_the_surface(specimen_of):
    # 1 and 30: brushed along y. The slope variance along y is 1/900 of that along x, their sum alpha^2.
    keys = {"alpha": 0.2, "rolloff_length": [1, 30], "samples": 128}
    surface = specimen_of("self_affine", hurst=0.7, **keys).surface
    stats = [surface.realise(seed).statistics() for seed in range(40)]
    assert surface.realise(0).size == pytest.approx((8e-6, 240e-6))
    assert z_score([s.alpha_x**2 for s in stats], 2 * 0.04 * 900 / 901)[0] < 4
    assert z_score([s.alpha_y**2 for s in stats], 2 * 0.04 / 901)[0] < 4
    ratios = [s.correlation_length_y / s.correlation_length_x for s in stats]
    z, relative = z_score(ratios, 30)
    assert z < 4
    assert relative < 0.1
    # The same surface as the isotropic one but for the scale of y, and of the heights.
    same = specimen_of("self_affine", hurst=0.7, alpha=0.2, samples=128).surface.realise(3).heights
    stretched = surface.realise(3).heights
    np.testing.assert_allclose(stretched / stretched.std(), same / same.std(), atol=1e-12)


def test_shorter_waves_are_steeper(specimen_of):
    # Half the cut-off length, at the same rms height and samples, H = 0.5: alpha^2 goes as 1 / cut-off.
    alphas = []
    for cutoff in (0.1, 0.05):
        keys = {"rms_height": 0.1, "rolloff_length": 1, "cutoff_length": cutoff, "samples": 1024}
        surface = specimen_of("self_affine", hurst=0.5, **keys).surface
        alphas.append(np.mean([surface.realise(seed).statistics().alpha ** 2 for seed in range(4)]))
    assert alphas[1] / alphas[0] == pytest.approx(2, rel=0.2)


def test_seed_is_the_realisation(specimen_of):
    surface = specimen_of("self_affine", hurst=0.8, alpha=0.5, samples=64).surface
    first, again, other = surface.realise(7), surface.realise(7), surface.realise(8)
    assert first.heights.tobytes() == again.heights.tobytes()
    assert abs(np.corrcoef(first.heights.ravel(), other.heights.ravel())[0, 1]) < 0.5
    assert first.size == pytest.approx((8e-6, 8e-6))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "hurst: missing"),
        ({"hurst": 0}, "above 0 and at most 1"),
        ({"hurst": 0.8}, "alpha: missing"),
        ({"hurst": 0.8, "rms_height": 1}, "rolloff_length: missing"),
        ({"hurst": 0.8, "alpha": 1, "rms_height": 1}, "not both"),
        ({"hurst": 0.8, "alpha": 1, "size": 3}, "3 roll-off lengths wide; at least 4"),
        ({"hurst": 0.8, "alpha": 1, "cutoff_length": 0.06}, "resolve no wave below 0.0625 units"),
        ({"hurst": 0.8, "alpha": 1, "cutoff_length": 1.1}, "at most rolloff_length"),
        ({"hurst": 0.8, "alpha": 1, "samples": 32, "size": 20}, "at most rolloff_length"),
        ({"hurst": 0.8, "alpha": 1, "rolloff_length": [1, 2, 3]}, "one number, or two"),
        ({"hurst": 0.8, "alpha": 1, "correlation_length": 1}, "correlation_length = 1: unknown key"),
    ],
)
def test_bad_keys(specimen_of, keys, message):
    with pytest.raises(InputError, match=message) as caught:
        specimen_of("self_affine", **keys)
    assert "\n" not in str(caught.value)
