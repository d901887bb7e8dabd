"""In-plane measurements as CSV: sides, scale, gaps, and the real file."""

from __future__ import annotations

import numpy as np
import pytest

from gonio.core.directions import direction
from gonio.table.checks import check
from gonio.table.table import Table
from microgeometry.errors import InputError

MEASURED = np.arange(-75, 76, 15)


def write(path, change=lambda text: text):
    """1 + sin of the angle of measurement, twice at 600 nm; no value where the source stands."""
    lines = [" Incident_angle,Measure_angle, 500nm ,600nm"]
    for incident in (15, 30, 60):
        for angle in MEASURED:
            value = 0.0 if angle == -incident else 1 + np.sin(np.radians(angle))
            lines.append(f"{incident},{angle},{value},{2 * value}")
    path.write_text(change("\n".join([*lines, ""])))
    return path


def test_sides_scale_and_gaps(tmp_path):
    """Positive angles are on the mirror side; pi f = 1 is matt white."""
    table = Table.load(write(tmp_path / "a.csv"))
    np.testing.assert_allclose(np.degrees(table.theta_i), [15, 30, 60])
    assert table.wavelengths_nm == (500.0, 600.0)
    scale = np.array([1, 2]) / np.pi
    steep = np.searchsorted(table.theta_r_edges, np.radians(45)) - 1
    for values in table.values:
        np.testing.assert_allclose(values[steep, -1], (1 + np.sqrt(0.5)) * scale)
        np.testing.assert_allclose(values[steep, 0], (1 - np.sqrt(0.5)) * scale)
    ring = np.searchsorted(table.theta_r_edges, np.radians(30)) - 1
    assert table.gaps[1, ring, 0]
    assert not table.gaps[1, ring, -1]
    sideways = np.searchsorted(table.delta_phi_edges, np.pi / 2) - 1
    assert table.gaps[:, ring, sideways].all()


def test_other_angles_for_every_light(tmp_path):
    """Every 3 degrees, and every degree about the mirror direction: what one light lacks is no dark line in it."""
    lines = ["Incident_angle,Measure_angle,500nm"]
    for incident in (20, 50):
        angles = np.union1d(np.arange(-75, 76, 3), np.arange(incident - 5, incident + 6))
        angles = angles[np.abs(angles + incident) > 10.5]  # the source stands there
        lines += [f"{incident},{angle},{2 + np.sin(np.radians(angle))}" for angle in angles]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([*lines, ""]))
    table = Table.load(path)
    for row, incident in enumerate((20, 50)):
        measured = np.arange(-74.5, 75, 0.5)
        wo = direction(np.radians(np.abs(measured)), np.where(measured >= 0, np.pi, 0.0))
        found = table.eval(direction(table.theta_i[row]), wo)[:, 0]
        known = np.abs(measured + incident) > 14
        np.testing.assert_allclose(np.pi * found[known], 2 + np.sin(np.radians(measured[known])), rtol=0.03)
        retro = np.searchsorted(table.theta_r_edges, np.radians(incident)) - 1
        assert table.gaps[row, retro, 0]


DAMAGE = {
    "columns": (
        lambda t: t.replace("Measure_angle", "angle"),
        "incident_angle, measure_angle and wavelengths",
    ),
    "no wavelength": (lambda t: t.replace("600nm", "green"), "column 'green'; a wavelength like 550nm"),
    "of 0 nm": (lambda t: t.replace("600nm", "0nm"), "column '0nm'; a wavelength"),
    "short": (lambda t: t.replace("15,-75,", "15,"), "numbers in 33 lines of 4 columns"),
    "word": (lambda t: t.replace("15,-75,", "15,steep,"), "numbers are expected"),
    "beyond": (lambda t: t.replace("60,75,", "60,95,"), "theta_r from 0 to 95 degrees; 0 to 90 is allowed"),
    "empty": (lambda t: t.splitlines()[0], "holds no samples"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damage(name, tmp_path):
    change, message = DAMAGE[name]
    with pytest.raises(InputError, match=message):
        Table.load(write(tmp_path / "a.csv", change))


def test_real_file(real_data):
    """White plastic with a gloss: matt at 1, the highlight in the mirror direction, energy kept."""
    table = Table.load(real_data / "ansys" / "test_brdf_viewer_2D_data.csv")
    np.testing.assert_allclose(np.degrees(table.theta_i), [10, 25, 40, 60, 80])
    assert table.wavelengths_nm[0] == 390.0
    assert len(table.channels) == 35
    assert check(table).passed
    for row in range(3):
        mirror = table.values[row, :, -1].mean(axis=-1)
        assert abs(np.degrees(table.theta_r[np.argmax(mirror)] - table.theta_i[row])) < 1.5
    smooth = table.eval(direction(table.theta_i[2]), direction(np.radians(np.arange(1, 31)), np.pi))
    np.testing.assert_allclose(np.pi * smooth.mean(axis=-1), 0.96, rtol=0.02)
    matt = table.values[0, np.searchsorted(table.theta_r_edges, np.radians(45)) - 1, 0]
    np.testing.assert_allclose(np.pi * matt, 0.95, atol=0.06)
