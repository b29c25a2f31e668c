"""The law of a contact: plain functions of numbers, compiled for the CPU (:mod:`petscjam.md.kernels`) and for a GPU.

r and u are position and velocity of disk j against i; ``inverse`` is 1/σ = 1/(Ri + Rj). ``absolute`` is 1 if overlaps
are absolute, None if they are relative to σ. A potential that is no power is called by ``call``. Units: ds, m, τe.
"""

from __future__ import annotations

import math

from petscjam.base.compiled import call
from petscjam.md.engine import BINS


def contact(rx, ry, ux, uy, near, inverse, normal, tangential, film, exponent, absolute, dU):
    """Return elastic force over distance, damping force on i, and 1 if they touch (VOT eqs. 1–5; BT eq. 9).

    The last four arguments select a branch when the function is compiled.

    Parameters
    ----------
    rx, ry : float
    ux, uy : float
        At the contact point if the law rolls.
    near, inverse : float
        1/r and 1/σ.
    normal, tangential : float
        Friction coefficients, in m/τe.
    film : (float, float, float) or None
        p, a and b: the friction is multiplied by (a u² + b)^p. None: it is linear.
    exponent : float or None
        α; None: 2. With a power the loop does not vectorise.
    absolute : float or None
    dU : int or None
        U′ for ``call``; None: a power.
    """
    overlap = 1.0 - (rx * rx + ry * ry) * near * inverse
    touch = 1.0 if overlap >= 0.0 else 0.0
    overlap *= touch
    if dU is None:
        spring = overlap if exponent is None else overlap ** (exponent - 1.0)
    else:
        unit = 1.0 if absolute is None else inverse
        spring = call(dU, overlap / unit) if overlap > 0.0 else 0.0
    along = (normal - tangential) * (ux * rx + uy * ry) * near * near
    gx = touch * (tangential * ux + along * rx)
    gy = touch * (tangential * uy + along * ry)
    if film is not None:
        factor = (film[1] * (ux * ux + uy * uy) + film[2]) ** film[0]
        gx *= factor
        gy *= factor
    if absolute is None:
        spring *= inverse
    elif dU is None:
        spring /= inverse if exponent is None else inverse ** (exponent - 1.0)
    return spring * near, gx, gy, touch


def largest(film):
    """Return the largest factor of the friction.

    Parameters
    ----------
    film : (float, float, float) or None
        As in :func:`contact`.
    """
    return 1.0 if film is None else film[2] ** film[0]


def stiffness(distance, inverse, exponent, absolute, d2U):
    """Return k of a contact at ``distance``, in units of σ: V″ in ke/ds² (VOT eq. 1).

    Parameters
    ----------
    distance, inverse : float
    exponent, absolute, d2U : float, None or int
        As in :func:`contact`; ``exponent`` is a number.
    """
    k = inverse * inverse if absolute is None else 1.0
    if d2U is not None:
        unit = 1.0 if absolute is None else inverse
        k *= call(d2U, (1.0 - distance) / unit)
    elif exponent != 2.0:
        k *= (exponent - 1.0) * (1.0 - distance) ** (exponent - 2.0)
        if absolute is not None:
            k *= inverse ** (2.0 - exponent)
    return k


def energy(overlap, inverse, exponent, absolute, U):
    """Return U of a contact, k δ^α/α of a power (VOT eq. 1), in m ds²/τe².

    Parameters
    ----------
    overlap, inverse : float
        1 − r/σ, and 1/σ.
    exponent, absolute, U : float, None or int
        As in :func:`stiffness`.
    """
    if U is not None:
        unit = 1.0 if absolute is None else inverse
        return call(U, overlap / unit)
    scale = 1.0 if absolute is None else inverse**-exponent
    return scale * overlap**exponent / exponent


def angle_bin(x, y, vx, vy):
    """Return the bin of the collision angle ϑ, which turns vij onto rij (VOT eqs. 26, 27): of rji and vji, too.

    Parameters
    ----------
    x, y, vx, vy : float
    """
    angle = math.atan2(vx * y - vy * x, vx * x + vy * y)
    return min(max(int((angle / math.pi + 1.0) * (BINS // 2)), 0), BINS - 1)


def fastest(s, m, R, normal, tangential, rolls, body, rotational_drag):
    """Return bounds of a disk for the eigenvalues of M⁻¹B, 1/τe, and M⁻¹K, 1/τe² (docs/theory.md, Largest time steps).

    Parameters
    ----------
    s : (9,)
        Σ w, Σ w cos 2φ, Σ w sin 2φ, the same with the stiffness, Σ w ρ t, Σ w ρ² over its contacts, w = 1 + zj/zi.
    m, R : float
    normal, tangential, rolls, body, rotational_drag : float
        Numbers of the law.
    """
    along = 0.5 * (normal + tangential) * s[0] + body
    along += 0.5 * abs(normal - tangential) * math.sqrt(s[1] ** 2 + s[2] ** 2)
    turning = 2.0 * rolls * tangential * s[8] + 2.0 * rotational_drag / R**2
    both = 8.0 * (rolls * tangential) ** 2 * (s[6] ** 2 + s[7] ** 2)
    relaxation = 0.5 * (along + turning + math.sqrt((along - turning) ** 2 + both)) / m
    return relaxation, 0.5 * (s[3] + math.sqrt(s[4] ** 2 + s[5] ** 2)) / m
