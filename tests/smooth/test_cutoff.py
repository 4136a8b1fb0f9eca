"""p, λ and Hz: three names of one parameter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordlog.smooth import cutoff, fit

dts = st.floats(1e-3, 1.0)


def gain(frequency, lam, dt):
    """Exact amplitude gain of the fit for uniform samples, far from the ends (Reinsch's filter)."""
    cos = np.cos(2.0 * np.pi * frequency * dt)
    return 1.0 / (1.0 + lam / dt**3 * 3.0 * (2.0 - 2.0 * cos) ** 2 / (2.0 + cos))


@given(st.floats(1e-9, 1.0 - 1e-9), dts)
def test_p_survives_both_ways_round(p, dt):
    hertz = cutoff.cutoff_from_lam(cutoff.lam_from_p(p, dt), dt)
    assert cutoff.p_from_lam(cutoff.lam_from_p(p, dt), dt) == pytest.approx(p, rel=1e-12)
    assert cutoff.p_from_lam(cutoff.lam_from_cutoff(hertz, dt), dt) == pytest.approx(p, rel=1e-12)
    assert cutoff.cutoff_from_lam(cutoff.lam_from_cutoff(hertz, dt), dt) == pytest.approx(
        hertz, rel=1e-12
    )


def test_ends_of_the_scales_meet():
    for p, lam, hertz in ((1.0, 0.0, np.inf), (0.0, np.inf, 0.0)):
        assert cutoff.lam_from_p(p, 0.02) == lam
        assert cutoff.p_from_lam(lam, 0.02) == p
        assert cutoff.cutoff_from_lam(lam, 0.02) == hertz
        assert cutoff.lam_from_cutoff(hertz, 0.02) == lam


def test_published_values():
    # dt = 0.02 s, p of csaps with time in seconds: 0.5 is 0.42 Hz, 0.99 is 1.3 Hz, 0.9999 is 4.2 Hz.
    hertz = cutoff.cutoff_from_lam(cutoff.lam_from_p([0.5, 0.99, 0.9999], 1.0), 0.02)
    np.testing.assert_allclose(hertz, [0.42, 1.33, 4.23], rtol=1e-2)
    # In units of the step index, 0.99 is the Nyquist frequency, all but.
    assert cutoff.cutoff_from_lam(cutoff.lam_from_p(0.99, 0.02), 0.02) == pytest.approx(
        25.0, rel=5e-3
    )


def test_cut_off_is_where_slow_sines_are_halved():
    dt, hertz = 0.001, 2.0
    assert gain(hertz, cutoff.lam_from_cutoff(hertz, dt), dt) == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize("hertz", [0.5, 3.0, 10.0, 24.0])
def test_gain_is_what_the_fit_does_to_a_sine(hertz):
    dt, n, lam = 0.02, 2001, float(cutoff.lam_from_cutoff(3.0, 0.02))
    time = np.arange(n) * dt
    wave = np.sin(2 * np.pi * hertz * time + 0.3)[:, None]
    middle = slice(n // 2 - 300, n // 2 + 300)
    fitted = fit(time, wave, lam=lam).position[middle, 0]
    measured = fitted @ wave[middle, 0] / (wave[middle, 0] @ wave[middle, 0])
    assert measured == pytest.approx(float(gain(hertz, lam, dt)), rel=1e-9, abs=1e-11)
