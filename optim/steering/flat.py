"""The flat space of the trailer's axle: what a curve of the trailer asks of the truck.

    (x, y, theta, kappa, sigma)   centre of the trailer's axle [m], trailer heading [rad], curvature [1/m] and
                                  sharpness dkappa/ds_f [1/m^2] by the signed arc length s_f along the heading
    q = 1 + (l_t kappa)^2         ds/ds_f = sqrt(q), s the arc length of the truck's rear axle
    T = tan(phi) = l (kappa + l_t sigma / q) / sqrt(q)
    dphi/ds = (dT/ds_f) / (sqrt(q) (1 + T^2))

l is the wheelbase and l_t the distance from the hitch to the trailer's axle. The *load* at a point of a curve is
the largest of |kappa|, |T| and |dphi/ds| relative to its limit: a curve can be driven where its load is at most 1.

In kernels the limits are one tuple `lim`: l, l_t, largest |kappa|, largest |T|, largest |dphi/ds|, and the curvature
that long turns are held at. The load of a curve that is described backwards (curvature -kappa, sharpness sigma, in
the order of -s_f) is that with -l_t.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from optim.model.flat_map import require_flat
from optim.model.vehicle import Vehicle
from optim.numerics.kernel import kernel

TOLERANCE = 1e-6
"""Relative excess of a limit that still counts as within it: a recorded state at its limit is a state [-]."""

CurveLimits = tuple[float, float, float, float, float, float]
"""l [m], l_t [m], largest |kappa| [1/m], largest |T| [-], largest |dphi/ds| [rad/m], curvature of long turns [1/m]."""
TWO_PI = 2.0 * math.pi
# Gauss-Legendre on [0, 1]: four nodes to search with (1e-6 m on a ramp), then nine to solve with (1e-13 m)
GAUSS_X = (
    0.06943184420297371, 0.33000947820757187, 0.66999052179242813, 0.93056815579702629,
    0.01591988024618696, 0.08198444633668210, 0.19331428364970480, 0.33787328829809554, 0.5,
    0.66212671170190446, 0.80668571635029520, 0.91801555366331790, 0.98408011975381304,
)  # fmt: skip
GAUSS_W = (
    0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693,
    0.04063719418078720, 0.09032408034742870, 0.13030534820146773, 0.15617353852000142, 0.16511967750062988,
    0.15617353852000142, 0.13030534820146773, 0.09032408034742870, 0.04063719418078720,
)  # fmt: skip


class Flat(NamedTuple):
    """A full state of truck and trailer in the flat space of the trailer's axle."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # trailer heading [rad]
    kappa: float  # curvature of the trailer's path [1/m]
    sigma: float = 0.0  # dkappa/ds_f [1/m^2]


@lru_cache(maxsize=16)
def curve_limits(vehicle: Vehicle) -> CurveLimits:
    """The vehicle's l, l_t, limits and hold curvature as kernels take them; cached, since it is needed often.

    Raises ValueError for a hitch that is not over the rear axle: such a vehicle is not flat.
    """
    require_flat(vehicle)
    l, l_t, _ = vehicle.kinematics
    bounds = vehicle.max_kappa, math.tan(vehicle.max_steer), vehicle.max_steer_rate
    return l, l_t, *bounds, hold_curvature((l, l_t, *bounds, 0.0))


@kernel(error_model="numpy")
def load(kappa, sigma, curl, lim):
    """Load at a point: largest of |kappa|, |tan(phi)|, |dphi/ds| by its limit; curl = dsigma/ds_f [1/m^3]."""
    u = lim[1] * kappa
    p = 1.0 / (1.0 + u * u)
    root = math.sqrt(p)
    du = lim[1] * sigma * p
    steer = lim[0] * root * (kappa + du)
    rate = lim[0] * p * (sigma + lim[1] * curl * p - u * (2.0 * du * du + (kappa + du) * lim[1] * sigma * p))
    # the truck's share of the change: dphi = dT / (1 + T^2)
    rate = rate / (1.0 + steer * steer)
    # 0 * rate: what is not a number must not get lost in the maximum
    return max(abs(kappa) / lim[2], abs(steer) / lim[3], abs(rate) / lim[4]) + 0.0 * rate


@kernel(error_model="numpy")
def effort(flat, length, lim):
    """Integrals of phi^2, (dphi/ds)^2 over equally spaced samples (n, 5) of a truck's distance, phi linear between."""
    l, l_t = lim[0], lim[1]
    step = length / (flat.shape[0] - 1)
    steer, rate, before = 0.0, 0.0, 0.0
    for i in range(flat.shape[0]):
        u = l_t * flat[i, 3]
        q = 1.0 + u * u
        phi = math.atan(l * (flat[i, 3] + l_t * flat[i, 4] / q) / math.sqrt(q))
        if i > 0:
            steer += step * (phi * phi + phi * before + before * before) / 3.0
            rate += (phi - before) ** 2 / step
        before = phi
    return steer, rate


@kernel(error_model="numpy")
def hermite(k0, s0, k1, s1, length):
    """Quadratic and cubic coefficient of the cubic from (k0, slope s0) to (k1, slope s1) over length."""
    step = (k1 - k0) / length
    return (3.0 * step - 2.0 * s0 - s1) / length, (s0 + s1 - 2.0 * step) / (length * length)


@kernel(error_model="numpy")
def peak(before, value, after):
    """Top of the parabola through three equally spaced values, the middle one being the largest."""
    bend = 2.0 * value - before - after
    if bend <= 0.0:
        return value
    return value + (after - before) ** 2 / (8.0 * bend)


@kernel(error_model="numpy")
def ramp_load(k0, s0, k1, length, count, stop, lim):
    """Largest load on a cubic ramp from (k0, s0) to (k1, 0), from count + 1 samples and the parabolas through them.

    The end is looked at first; returns at the first sample above `stop`. The count is a float: a kernel is
    compiled again for every literal int.
    """
    c2, c3 = hermite(k0, s0, k1, 0.0, length)
    worst, before, value = 0.0, 0.0, 0.0
    for i in range(-1, int(count) + 1):
        s = length * (i / count if i >= 0 else 1.0)
        kappa, sigma = k0 + s * (s0 + s * (c2 + s * c3)), s0 + s * (2.0 * c2 + 3.0 * s * c3)
        after = load(kappa, sigma, 2.0 * c2 + 6.0 * c3 * s, lim)
        if not after <= stop:
            return after if after > stop else np.inf
        worst = max(worst, after)
        if i >= 2 and value >= before and value >= after:
            worst = max(worst, peak(before, value, after))
        before, value = value, after
    return worst


@kernel(error_model="numpy")
def largest_curl(kappa, lim):
    """Largest |dsigma/ds_f| that the steering rate allows where sigma = 0 [1/m^3]."""
    q = 1.0 + (lim[1] * kappa) ** 2
    return lim[4] * q * q * (1.0 + (lim[0] * kappa) ** 2 / q) / (lim[0] * abs(lim[1]))


@kernel(error_model="numpy")
def shortest_ramp(k0, s0, k1, precision, lim):
    """Shortest length of a ramp from (k0, s0) to (k1, 0) within the limits, at most by the factor `precision` too long.

    The load of a ramp that starts with s0 = 0 falls with its length; with s0 != 0 a long ramp overshoots, and
    this is the shortest of the first interval of lengths that can be driven. Returns inf where there is none.
    """
    length = 0.01 * abs(lim[1])
    curl0, curl1 = largest_curl(k0, lim), largest_curl(k1, lim)
    if s0 == 0.0:  # the rate at both ends in closed form
        length = max(length, math.sqrt(6.0 * abs(k1 - k0) / min(curl0, curl1)))
    else:
        length = max(length, abs(s0) / max(curl0, curl1))
    longest = 4.0 * abs(lim[1]) + 4.0 * math.sqrt(lim[2] / largest_curl(0.0, lim))
    low, high = 0.0, np.inf
    while length < longest:
        if ramp_load(k0, s0, k1, length, 12.0, 1.0 + 1e-9, lim) > 1.0 + 1e-9:
            low = length
        else:
            high = length
        if high < precision * low or low == 0.0:
            return high
        length = 1.25 * low if high == np.inf else math.sqrt(low * high)
    return high


@kernel(error_model="numpy")
def hold_curvature(lim):
    """The peak that long turns are held at: of those within the limits, the one that turns 3 rad shortest [1/m]."""
    best, shortest = 0.0, np.inf
    for i in range(20):
        kp = lim[2] * (0.998 - 0.045 * i)  # a little below the limit: solving for the tangent moves it
        ramps = 0.0
        for k in range(2):
            ramps += shortest_ramp(kp * k, 0.0, kp * (1 - k), 1.06, lim)
        length = 0.5 * ramps + 3.0 / kp
        if length < shortest:
            best, shortest = kp, length
    return best
