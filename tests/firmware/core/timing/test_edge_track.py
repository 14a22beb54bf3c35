"""The filter of phase, rate and ramp, each call by itself: against the exact response of a low-pass to a ramp, matrices
by NumPy, and the likeliest state by SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares

from hil_sim import clib

CHIP, CONVERSION, LAG = 16422.0, 216.0, 267.0
EDGE_VARIANCE = 70.0
"""Variance of an edge besides noise, ticks squared."""
FACTOR = np.array([[30.0, 0.0, 0.0], [0.04, 0.03, 0.0], [-200.0, 50.0, 300.0]])
COVARIANCE = FACTOR @ FACTOR.T
"""That of time, rate and rise, each correlated with each."""


@pytest.fixture(scope="module")
def core():
    return clib.load("libgf_core.so", ("core/timing/edge_fit.h", "core/timing/edge_track.h"))


def contrast(early, time):
    """Return the late conversions' mean minus the early ones', ticks of the ramp, the last one a time after its foot.

    Shape as that of time.
    """
    since = np.clip(np.asarray(time)[..., None] - CONVERSION * np.arange(7, -1, -1), 0.0, None)
    height = since - LAG * (1.0 - np.exp(-since / LAG))
    return height[..., early:].mean(axis=-1) - height[..., :early].mean(axis=-1)


def new_track(core, state=(0.0, 0.0, 4000.0), covariance=COVARIANCE):
    track = core[0].new("edge_track_t *", [*state])
    of(core, track)[:] = covariance
    track.rise_known = True
    return track


def of(core, track):
    return np.frombuffer(core[0].buffer(track.covariance), dtype=np.float32).reshape(3, 3)


def values(track):
    return np.array([track.time_ticks, track.rate, track.rise_ticks])


def looks_of(core, shares, variances=(1.0, 1.0), chips=(0.0, 0.0)):
    looks = zip(np.broadcast_to(shares, 2), np.broadcast_to(variances, 2), chips, strict=True)
    return core[0].new("edge_look_t[2]", [[float(value) for value in look] for look in looks])


def burst_of(core, early):
    return core[0].new("edge_burst_t *", [early, CONVERSION, LAG])


def test_a_search_is_the_first_state(core):
    """A later edge is a shorter time after it, and a slip of the edge makes the time go down."""
    ffi, lib = core
    fit, track = ffi.new("edge_fit_t *", [-2500.0, 1.5, 4321.0]), ffi.new("edge_track_t *")
    of(core, fit)[:] = COVARIANCE
    ffi.memmove(track, bytes([0x45]) * ffi.sizeof(track[0]), ffi.sizeof(track[0]))
    lib.edge_track_start(track, fit, 986.0)
    assert [*values(track), track.rise_known] == [986.0, 0.0, 4321.0, True]
    turn = np.diag([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(of(core, track), turn @ COVARIANCE @ turn + np.diag([EDGE_VARIANCE, 0, 0]), rtol=1e-6)


def test_a_known_phase_is_the_first_state(core):
    ffi, lib = core
    track = ffi.new("edge_track_t *")
    ffi.memmove(track, bytes([0x45]) * ffi.sizeof(track[0]), ffi.sizeof(track[0]))
    lib.edge_track_known(track, 286.0, 40.0, 0.001)
    assert [track.time_ticks, track.rate, track.rise_known] == [286.0, 0.0, False]
    expected = np.diag([40.0**2 + EDGE_VARIANCE, 0.001**2, 0.0])
    np.testing.assert_allclose(of(core, track), expected, rtol=1e-6)


@pytest.mark.parametrize("chips", [0.0, 1.0, 341.5, 30_000.0])
def test_phase_and_rate_run_on_and_the_rate_walks(core, chips):
    """A rate that walks by 0.05 ppm in a second."""
    track = new_track(core, (286.0, 0.125, 4000.0))
    ahead = core[1].edge_track_variance(track, chips)
    core[1].edge_track_move(track, chips)
    assert values(track) == pytest.approx([286.0 + 0.125 * chips, 0.125, 4000.0])
    run = np.eye(3)
    run[0, 1] = chips
    expected = run @ COVARIANCE @ run.T
    expected[1, 1] += (0.05e-6 * CHIP) ** 2 / (168e6 / CHIP) * chips
    np.testing.assert_allclose(of(core, track), expected, rtol=2e-6 + 2e-8 * chips / 3)
    assert ahead == pytest.approx(expected[0, 0], rel=1e-5)


@pytest.mark.parametrize("early", [1, 4, 7])
@pytest.mark.parametrize("time", [150.0, 286.0, 986.0, 1500.0, 2500.0])
@pytest.mark.parametrize("shares", [(0.2, 0.2), (0.25, 0.05)])
def test_the_first_looks_tell_the_rise(core, early, time, shares):
    """That with which the time would be right; the low-pass's short exponential errs by up to 0.011 of its lag, by
    0.0015 near to the foot."""
    ffi, lib = core
    track = ffi.new("edge_track_t *")
    lib.edge_track_known(track, time, 40.0, 0.001)
    height, share = contrast(early, time), np.mean(shares)
    lib.edge_track_rise(track, burst_of(core, early), looks_of(core, shares))
    rise = max(height / share, 300.0)
    error = 0.0015 if time < LAG else 0.011
    assert track.rise_ticks == pytest.approx(rise, abs=error * LAG / share)
    assert of(core, track)[2, 2] == pytest.approx(track.rise_ticks**2)
    assert track.rise_known
    before = bytes(ffi.buffer(track))
    lib.edge_track_rise(track, burst_of(core, early), looks_of(core, 0.9))
    assert bytes(ffi.buffer(track)) == before


@pytest.mark.parametrize(
    ("time", "share", "rise"),
    [
        (986.0, -0.5, 20000.0),
        (986.0, 0.0, 20000.0),
        (986.0, 0.9 / 20000, 20000.0),
        (986.0, 1e3, 300.0),
        (-50.0, 0.001, 300.0),
        (-50.0, 0.0, 20000.0),
    ],
)
def test_a_rise_that_makes_no_sense_is_the_nearest_that_does(core, time, share, rise):
    track = core[0].new("edge_track_t *")
    core[1].edge_track_known(track, time, 40.0, 0.001)
    core[1].edge_track_rise(track, burst_of(core, 4), looks_of(core, share))
    assert track.rise_ticks == rise


@pytest.mark.parametrize(("limit", "expected"), [(300.0, 0.98), (300.0, 1.02), (300.0, 1.08), (20000.0, 0.98)])
def test_a_rise_near_its_limits_is_taken(core, limit, expected):
    """Within them as it is told, beyond them the limit."""
    track = core[0].new("edge_track_t *")
    core[1].edge_track_known(track, 150.0, 40.0, 0.001)
    share = contrast(7, 150.0) / (expected * limit)
    core[1].edge_track_rise(track, burst_of(core, 7), looks_of(core, share))
    assert track.rise_ticks == pytest.approx(max(expected * limit, 300.0), rel=0.011)


@pytest.mark.parametrize(("time", "rise"), [(286.0, 500.0), (986.0, 4000.0), (-20.0, 4000.0)])
@pytest.mark.parametrize("variances", [(0.5, 0.5), (0.9, 0.1), (1e-6, 3e-6), (4e-4, 1e-4)])
def test_blind_is_less_than_two_deviations_and_three_less_than_expected(core, time, rise, variances):
    """Both sides of either limit; the deviation is that of the mean of two looks."""
    lib, track, burst = core[1], new_track(core, (time, 0.0, rise)), burst_of(core, 4)
    deviation, expected = np.sqrt(sum(variances)) / 2.0, contrast(4, time) / rise
    limit = min(2.0 * deviation, expected - 3.0 * deviation)
    for off in (-0.03, 0.03):
        share = limit + off * deviation
        for apart in (0.0, 0.4, -0.4):
            looks = looks_of(core, (share + apart, share - apart), variances)
            assert lib.edge_track_blind(track, burst, looks) == (off < 0)


def test_at_its_limits_nothing_is_blind(core):
    """Shares of exactly two deviations, and of three less than the 0 that is expected before the edge."""
    lib, burst = core[1], burst_of(core, 4)
    assert not lib.edge_track_blind(new_track(core, (1500.0, 0.0, 300.0)), burst, looks_of(core, 1.0, 0.5))
    assert lib.edge_track_blind(new_track(core, (1500.0, 0.0, 300.0)), burst, looks_of(core, 0.99, 0.5))
    assert not lib.edge_track_blind(new_track(core, (-1500.0, 0.0, 300.0)), burst, looks_of(core, -1.5, 0.5))
    assert lib.edge_track_blind(new_track(core, (-1500.0, 0.0, 300.0)), burst, looks_of(core, -1.51, 0.5))


def likeliest(prior, covariance, early, shares, variances, chips, start):
    """Return the likeliest state, its covariance, and its chi squared.

    A look has the variance of its noise and that of the edge, seen with the slope that the ramp has where it is.
    """
    prior, shares, variances, chips = map(np.asarray, (prior, shares, variances, chips))
    root = np.linalg.inv(np.linalg.cholesky(covariance))

    def share(x):
        return contrast(early, x[0] + chips * x[1]) / x[2]

    def residuals(x, noise):
        return np.concatenate([root @ (x - prior), (shares - share(x)) / noise])

    x, last = np.array(start), np.inf
    while np.abs(x - last).max() > 1e-3:
        slope = share(x + np.array([0.5, 0, 0])) - share(x - np.array([0.5, 0, 0]))
        noise = np.sqrt(variances + EDGE_VARIANCE * slope**2)
        found = least_squares(residuals, x, args=(noise,), x_scale=np.sqrt(np.diag(covariance)), method="lm")
        last, x = x, found.x
    return x, np.linalg.inv(found.jac.T @ found.jac), 2.0 * found.cost


HALVES = (-256.0, 256.0)
PRIORS = [
    (4, (986.0, 0.0, 4000.0)),
    (4, (700.0, 0.05, 1500.0)),
    (7, (286.0, 0.0, 5000.0)),
    (7, (200.0, -0.05, 1200.0)),
    (1, (400.0, 0.1, 3000.0)),
]


@pytest.mark.parametrize(("early", "prior"), PRIORS)
@pytest.mark.parametrize("deviations", [(1e-5, 1e-5), (0.02, 0.02), (0.002, 0.01)])
def test_two_looks_make_the_likeliest_state(core, early, prior, deviations):
    """By what was known and what is seen; the short exponential's error is that of two ticks."""
    rng = np.random.default_rng(1)
    for _ in range(4):
        truth = prior + 0.7 * FACTOR @ rng.normal(size=3)
        seen = contrast(early, truth[0] + np.array(HALVES) * truth[1]) / truth[2]
        shares, variances = seen + deviations * rng.normal(size=2), np.square(deviations)
        track = new_track(core, prior)
        core[1].edge_track_update(track, burst_of(core, early), looks_of(core, shares, variances, HALVES))
        state, covariance, misfit = likeliest(prior, COVARIANCE, early, shares, variances, HALVES, truth)
        size = np.sqrt(np.diag(covariance))
        assert (np.abs(values(track) - state) < [2.0, 0.006, 20.0]).all()
        assert (np.abs(values(track) - state) < 0.2 * size).all()
        np.testing.assert_allclose(of(core, track) / np.outer(size, size), covariance / np.outer(size, size), atol=0.02)
        assert misfit < 16.0


def off_by(core, early, prior, by, deviation):
    """Update with looks of a state that is off by `by`; return the state and covariance, and the likeliest if both
    count."""
    truth = np.add(prior, by)
    shares = contrast(early, truth[0] + np.array(HALVES) * truth[1]) / truth[2]
    track = new_track(core, prior)
    core[1].edge_track_update(track, burst_of(core, early), looks_of(core, shares, deviation**2, HALVES))
    both = likeliest(prior, COVARIANCE, early, shares, np.full(2, deviation**2), HALVES, prior)
    return values(track), of(core, track).copy(), both, shares


@pytest.mark.parametrize(
    ("by", "deviation"), [((-500.0, 0.0, 0.0), 0.02), ((900.0, 0.0, 0.0), 1e-3), ((-300.0, 0.3, 0.0), 5e-3)]
)
def test_looks_fit_up_to_a_chi_squared_of_sixteen(core, by, deviation):
    """Below it the state is the likeliest; beyond it the variance of the time is what the looks tell of it."""
    prior = (986.0, 0.0, 4000.0)
    low, high = 0.0, 1.0
    for _ in range(9):
        middle = 0.5 * (low + high)
        state, covariance, (likely, told, misfit), _ = off_by(core, 4, prior, middle * np.array(by), deviation)
        fits = np.abs(covariance[0, 0] / told[0, 0] - 1.0) < 0.05
        low, high = (middle, high) if fits else (low, middle)
    print(low, misfit, state, likely, covariance[0, 0], told[0, 0])
    assert misfit == pytest.approx(16.0, rel=0.03)


@pytest.mark.parametrize(
    ("early", "at", "by"),
    [
        (1, 986.0, (-600.0, 0.0, 0.0)),
        (4, 986.0, (-600.0, 0.0, 0.0)),
        (7, 986.0, (-600.0, 0.0, 0.0)),
        (1, 986.0, (400.0, 0.0, 0.0)),
        (4, 986.0, (500.0, 0.0, 0.0)),
        (7, 286.0, (450.0, 0.0, 0.0)),
        (4, 986.0, (500.0, 0.5, 0.0)),
        (4, 986.0, (-400.0, -0.3, 0.0)),
        (4, 986.0, (-1500.0, 0.0, 0.0)),
        (7, 286.0, (-600.0, 0.0, 0.0)),
        (4, -600.0, (1400.0, 0.0, 0.0)),
        (7, 4000.0, (-3700.0, 0.0, 0.0)),
    ],
)
def test_looks_that_do_not_fit_are_the_time(core, early, at, by):
    """The time at which the ramp would have been seen like that is off by as much as is then thought possible."""
    prior = np.array((at, 0.0, 4000.0))
    state, covariance, (_, _, misfit), shares = off_by(core, early, prior, by, 1e-3)
    assert misfit > 16.5
    height, end = np.mean(shares) * prior[2], 8.0 * CONVERSION
    seen = contrast(early, end) > height > 0.0
    time = brentq(lambda t: contrast(early, t) - height, 0.0, end) if seen else 0.0
    wider = COVARIANCE + np.diag([(time - at) ** 2, 0.0, 0.0])
    likely, told, _ = likeliest(prior, wider, early, shares, (1e-6, 1e-6), HALVES, (time, *prior[1:]))
    size = np.sqrt(np.diag(told))
    assert (np.abs(state - likely) < [6.0, 0.002, 12.0]).all()
    np.testing.assert_allclose(covariance / np.outer(size, size), told / np.outer(size, size), atol=0.08)


@pytest.mark.parametrize(
    ("early", "at", "truth"),
    [
        (4, 150.0, 1100.0),
        (1, 100.0, 900.0),
        (7, 20.0, 500.0),
        (4, 1700.0, 600.0),
        (1, 1800.0, 500.0),
        (7, 1200.0, 200.0),
    ],
)
def test_a_time_that_was_hardly_known_is_found(core, early, at, truth):
    """Where the contrast is nearly flat a step by its slope alone would lead nowhere."""
    wide = np.diag([1000.0**2, 1e-6, 50.0**2])
    share = float(contrast(early, truth)) / 4000.0
    track = new_track(core, (at, 0.0, 4000.0), wide)
    core[1].edge_track_update(track, burst_of(core, early), looks_of(core, share, 1e-6, HALVES))
    likely, _, misfit = likeliest(
        (at, 0.0, 4000.0), wide, early, np.full(2, share), np.full(2, 1e-6), HALVES, (truth, 0.0, 4000.0)
    )
    assert misfit < 15.0
    assert track.time_ticks == pytest.approx(likely[0], abs=4.0)


@pytest.mark.parametrize("rise", [200.0, 285.0, 315.0, 400.0])
def test_a_rise_stays_at_its_least_or_above(core, rise):
    share = float(contrast(4, 986.0)) / rise
    track = new_track(core, (986.0, 0.0, 450.0), np.diag([1.0, 1e-8, 3000.0**2]))
    core[1].edge_track_update(track, burst_of(core, 4), looks_of(core, share, 1e-6, HALVES))
    assert track.rise_ticks == (300.0 if rise < 300.0 else pytest.approx(rise, rel=0.01))
