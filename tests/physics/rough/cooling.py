"""How a gas of rough hard spheres cools: translational and rotational temperature, constant e and beta, no limit of friction.

M. Huthmann and A. Zippelius, Phys. Rev. E 56, R6275 (1997); S. Luding, M. Huthmann, S. McNamara and A. Zippelius,
Phys. Rev. E 58, 3416 (1998). The gas stays uniform, and both velocities are taken to be Maxwellian and independent of one
another. The coefficients are derived here. Equal spheres of mass m, radius R and moment of inertia I = q m R^2 meet with the
normal k, the velocity w = v_1 - v_2 and the slip u = w_t - s of their surfaces, s = R (spin_1 + spin_2) x k. After the contact

    w_n' = -e w_n,   w_t' = w_t - 2 eta u,   s' = s + (2 eta/q) u,   eta = q (1 + beta) / (2 (1 + q)),   so that u' = -beta u.

The energy m w^2/4 + q m s^2/4 of a contact therefore changes by

    translation:  -(m/4) (1 - e^2) w_n^2 - m eta (w_t.u) + m eta^2 u^2,      rotation:  m eta (s.u) + m (eta^2/q) u^2.

Contacts meet w_n^2 = 4 T_tr/m in the mean (a faster pair meets more often), w_t^2 = 2 (d-1) T_tr/m and s^2 = 2 (d-1) T_rot/(q m);
w_t and s are independent. With N/2 contacts for each collision a particle, dn, energies (d/2) N T_tr and (D/2) N T_rot,
D = d(d-1)/2, this is

    dT_tr/dn = (4/d) (-A T_tr + B T_rot),    dT_rot/dn = (4/D) (B T_tr - C T_rot),
    A = (1 - e^2)/4 + (d-1)/2 eta (1 - eta),    B = (d-1)/2 eta^2/q,    C = (d-1)/2 (eta/q) (1 - eta/q),

and dn/dt is the Enskog collision rate. beta is the tangential restitution beta_0 of Walton and Braun: -1 is smooth, 1 perfectly
rough.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp
from scipy.linalg import expm


class Gas(NamedTuple):
    """Equal rough spheres (discs if dimension is 2) of mass 1 and diameter 1; `inertia` is q = I/(m R^2)."""

    dimension: int
    restitution: float
    tangential: float  # beta, -1 ... 1
    inertia: float
    packing: float  # part of the volume that spheres take


def coefficients(gas: Gas) -> tuple[float, float, float]:
    """A, B, C of the equations above."""
    q, across = gas.inertia, (gas.dimension - 1) / 2.0
    eta = q * (1.0 + gas.tangential) / (2.0 * (1.0 + q))
    a = (1.0 - gas.restitution**2) / 4.0 + across * eta * (1.0 - eta)
    return a, across * eta**2 / q, across * (eta / q) * (1.0 - eta / q)


def freedoms(dimension: int) -> tuple[int, int]:
    """Components of the velocity and of the spin of a sphere."""
    return dimension, dimension * (dimension - 1) // 2


def exchange(gas: Gas) -> np.ndarray:
    """The matrix (2, 2) that gives d(T_tr, T_rot)/dn for one collision a particle."""
    a, b, c = coefficients(gas)
    along, turning = freedoms(gas.dimension)
    return np.array([[-4.0 * a / along, 4.0 * b / along], [4.0 * b / turning, -4.0 * c / turning]])


def after(gas: Gas, start: tuple[float, float], collisions: np.ndarray) -> np.ndarray:
    """(T_tr, T_rot) after so many collisions a particle (n,), from the temperatures `start`; returns (n, 2)."""
    matrix = exchange(gas)
    return np.array([expm(matrix * n) @ start for n in collisions])


def lasting_ratio(gas: Gas) -> float:
    """T_rot/T_tr to which every start leads, where beta > -1: the x > 0 at which d ln T_tr = d ln T_rot.

    With k = d/D that is B x^2 + (k C - A) x - k B = 0.
    """
    a, b, c = coefficients(gas)
    along, turning = freedoms(gas.dimension)
    k = along / turning
    half = (k * c - a) / (2.0 * b)
    root = np.hypot(half, np.sqrt(k))
    return float(k / (root + half) if half > 0.0 else root - half)


def contact_value(gas: Gas) -> float:
    """Pair correlation at contact: Carnahan and Starling (1969) for spheres, Henderson (1975) for discs."""
    p = gas.packing
    return (1.0 - p / 2.0) / (1.0 - p) ** 3 if gas.dimension == 3 else (1.0 - 7.0 * p / 16.0) / (1.0 - p) ** 2


def collision_rate(gas: Gas, temperature: float) -> float:
    """Collisions of a particle in a unit of time, after Enskog: 4 sqrt(pi T) n g for spheres, 2 sqrt(pi T) n g for discs."""
    volume, factor = (np.pi / 6.0, 4.0) if gas.dimension == 3 else (np.pi / 4.0, 2.0)
    return float(factor * np.sqrt(np.pi * temperature) * gas.packing / volume * contact_value(gas))


def cooled(gas: Gas, start: tuple[float, float], times: np.ndarray) -> np.ndarray:
    """(T_tr, T_rot) at these times (n,), which increase from 0 on; returns (n, 2)."""
    matrix = exchange(gas)
    answer = solve_ivp(
        lambda _, t: collision_rate(gas, max(t[0], 0.0)) * (matrix @ t),
        *((0.0, times[-1]), start),
        t_eval=times, rtol=1e-10, atol=1e-14, method="LSODA",
    )  # fmt: skip
    return answer.y.T


@njit
def collide_at_random(v, spin, restitution, eta, inertia, count):
    """Contacts between randomly chosen partners with random normals, each as often as it approaches fast; in place.

    v, spin (n, 3): velocities and spins of spheres of mass 1 and radius 1/2. Stops behind the sweep, of n trials, in which the
    number of contacts reached `count`; returns that number.
    """
    n, done = len(v), 0
    k, u = np.empty(3), np.empty(3)
    while done < count:
        fastest = 0.0
        for i in range(n):
            fastest = max(fastest, v[i, 0] ** 2 + v[i, 1] ** 2 + v[i, 2] ** 2)
        fastest = 2.0 * np.sqrt(fastest)
        for _ in range(n):
            i, j = np.random.randint(n), np.random.randint(n)  # noqa: NPY002 - what numba has
            k[2] = 2.0 * np.random.random() - 1.0  # noqa: NPY002
            turn = 2.0 * np.pi * np.random.random()  # noqa: NPY002
            k[0], k[1] = np.sqrt(1.0 - k[2] ** 2) * np.cos(turn), np.sqrt(1.0 - k[2] ** 2) * np.sin(turn)
            normal = 0.0
            for c in range(3):
                normal += (v[i, c] - v[j, c]) * k[c]
            if i == j or np.random.random() * fastest >= -normal:  # noqa: NPY002
                continue
            for c in range(3):
                p, q = (c + 1) % 3, (c + 2) % 3
                rim = (spin[i, p] + spin[j, p]) * k[q] - (spin[i, q] + spin[j, q]) * k[p]
                u[c] = v[i, c] - v[j, c] - normal * k[c] - 0.5 * rim
            for c in range(3):
                push = -0.5 * (1.0 + restitution) * normal * k[c] - eta * u[c]
                v[i, c] += push
                v[j, c] -= push
            for c in range(3):
                p, q = (c + 1) % 3, (c + 2) % 3
                turned = -eta * (k[p] * u[q] - k[q] * u[p]) / (0.5 * inertia)
                spin[i, c] -= turned
                spin[j, c] -= turned
            done += 1
    return done


def simulated(gas: Gas, particles: int, collisions: int, seed: int) -> np.ndarray:
    """The same gas by the method of random pairs of G. Bird, which assumes nothing about the distribution of velocities.

    Follows `particles` velocities and spins from T_tr = 1 and T_rot = 0 on, in 3 dimensions. Returns (T_tr, T_rot) after 1, 2 ...
    `collisions` collisions a particle, (collisions, 2).
    """
    seed_numba(seed)
    v, spin = np.random.default_rng(seed).standard_normal((particles, 3)), np.zeros((particles, 3))
    v -= v.mean(axis=0)
    q, done, rows = gas.inertia, 0, []
    eta = q * (1.0 + gas.tangential) / (2.0 * (1.0 + q))
    for n in range(1, collisions + 1):
        done += collide_at_random(v, spin, gas.restitution, eta, q, n * particles // 2 - done)
        rows.append(((v**2).mean(), q * 0.25 * (spin**2).mean()))
    return np.array(rows)


@njit
def seed_numba(seed):
    """Of the random numbers that compiled functions draw."""
    np.random.seed(seed)  # noqa: NPY002
