"""The compiled energies against singular values and finite differences."""

import numpy as np
import pytest

from gensp.compiled.energies import ENERGIES, energy_slopes, energy_value

PLACES = [(80.0, 0.9), (3.0, 0.05), (2000.0, 0.4)]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("energy", ENERGIES)
def test_slopes_far_from_isometry_against_finite_differences(energy, place):
    """Also beyond where exp of the distortion has no number."""
    kind, (d, j) = ENERGIES[energy], place
    h, k = 1e-6 * d, 1e-6 * j
    fd, fj, fdd, fdj, fjj = energy_slopes(kind, d, j)
    values = [energy_value(kind, d + s, j) for s in (h, -h)]
    assert (values[0] - values[1]) / (2 * h) == pytest.approx(fd, rel=1e-6)
    values = [energy_value(kind, d, j + s) for s in (k, -k)]
    assert (values[0] - values[1]) / (2 * k) == pytest.approx(fj, rel=1e-6)
    ahead, behind = (energy_slopes(kind, d + s, j) for s in (h, -h))
    scale = 1e-9 * abs(fd) / h
    assert (ahead[0] - behind[0]) / (2 * h) == pytest.approx(fdd, rel=1e-5, abs=scale)
    assert (ahead[1] - behind[1]) / (2 * h) == pytest.approx(fdj, rel=1e-5)
    ahead, behind = (energy_slopes(kind, d, j + s) for s in (k, -k))
    assert (ahead[1] - behind[1]) / (2 * k) == pytest.approx(fjj, rel=1e-5)


def test_energies_are_what_their_formulas_say_of_singular_values(rng):
    for a, b in rng.uniform(0.5, 2, (5, 2)):
        d, j = a * a + b * b, a * b
        inverse = a**-2 + b**-2
        bent = 0.25 * (a / b + b / a) + 0.25 * (j + 1 / j)
        expected = {
            "dirichlet": d + inverse,
            "stretch": 0.5 * inverse + 1e-4 * (a**6 + b**6),
            "amips": np.exp(5 * bent),
        }
        for name, value in expected.items():
            assert energy_value(ENERGIES[name], d, j) == pytest.approx(value, rel=1e-12)


def test_no_energy_overflows_on_a_thin_limb():
    """Area shrunk a million times, or a triangle drawn out a thousand times: dear, but finite."""
    for energy in ENERGIES.values():
        for d, j in ((2e-6, 1e-6), (1e6, 1.0)):
            assert np.isfinite(energy_value(energy, d, j))
            assert np.isfinite(energy_slopes(energy, d, j)).all()
        assert energy_value(energy, 2.0, 0.0) == np.inf
