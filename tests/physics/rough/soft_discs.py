"""A column of discs with friction that falls over, by springs and dashpots: a second program, which knows nothing of the first.

After P. A. Cundall and O. D. L. Strack, Geotechnique 29, 47 (1979): a spring and a dashpot along the normal of a contact, and
across it another pair of them, whose force is at most mu times the normal one. Stiff springs are nearer to rigid discs.
`python tests/physics/rough/soft_discs.py` makes reference/column.csv in four minutes.
"""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

RADIUS, MASS, RESTITUTION, FRICTION, GRAVITY = 0.02, 0.01, 0.4, 0.5, 9.81
STIFFNESS = 1e5, 1e6  # at the lower one the column's weight presses its lowest discs by 4e-5, 0.2 % of a radius
ACROSS = 0.5  # the spring across the normal, as a part of the one along it
STEPS_A_CONTACT = 40
MOMENTS = 0.06 * np.arange(1, 11)


def column():
    """Places (600, 2) of discs that stand crooked, on the floor y = 0 and beside the wall x = 0."""
    random = np.random.default_rng(1)
    i, j = np.meshgrid(np.arange(15), np.arange(40))
    places = RADIUS * np.stack((1.1 + 2.125 * i + 0.42 * (j % 2), 1.1 + 2.1 * j), axis=-1).reshape(-1, 2)
    places[:, 0] += random.uniform(-0.0008, 0.0008, len(places))
    return places


def contact(overlap, closing, slip, stretch, h, stiffness, mass):
    """Forces (m,) along the normals and across them, and what the springs across them are stretched by after a step h."""
    damping = -2.0 * np.log(RESTITUTION) / np.hypot(np.pi, np.log(RESTITUTION))
    touch, across = overlap > 0.0, ACROSS * stiffness
    along = np.where(touch, np.maximum(stiffness * overlap + damping * np.sqrt(stiffness * mass) * closing, 0.0), 0.0)
    stretch, dashpot = np.where(touch, stretch + slip * h, 0.0), damping * np.sqrt(across * mass)
    asked = -across * stretch - dashpot * slip * touch
    taken = np.clip(asked, -FRICTION * along, FRICTION * along)
    return along, taken, np.where(taken == asked, stretch, -(taken + dashpot * slip) / across * touch)


def fall(stiffness):
    """(mean height, largest x) at each of the MOMENTS."""
    x, n = column(), 600
    v, spin, floor, wall, seen = np.zeros((n, 2)), np.zeros(n), np.zeros(n), np.zeros(n), []
    steps = int(np.ceil(MOMENTS[0] * STEPS_A_CONTACT / (np.pi * np.sqrt(0.5 * MASS / stiffness))))
    h, skin, listed_at = MOMENTS[0] / steps, 0.5 * RADIUS, np.full((n, 2), np.inf)
    pairs, stretch = np.empty(0, np.int64), np.empty(0)
    for step in range(1, steps * len(MOMENTS) + 1):
        if not np.abs(x - listed_at).max() < 0.3 * skin:
            near = cKDTree(x).query_pairs(2.0 * RADIUS + skin, output_type="ndarray").astype(np.int64)
            before, pairs = dict(zip(pairs.tolist(), stretch.tolist(), strict=True)), np.sort(near @ [n, 1])
            stretch = np.array([before.get(pair, 0.0) for pair in pairs.tolist()])
            listed_at, (first, second) = x.copy(), np.divmod(pairs, n)
        apart, moving = x[first] - x[second], v[first] - v[second]
        distance = np.hypot(*apart.T)
        normal = apart / distance[:, None]
        side = np.stack((-normal[:, 1], normal[:, 0]), axis=1)
        slip = (moving * side).sum(axis=1) - RADIUS * (spin[first] + spin[second])
        closing = -(moving * normal).sum(axis=1)
        one, two, stretch = contact(2.0 * RADIUS - distance, closing, slip, stretch, h, stiffness, 0.5 * MASS)
        given = one[:, None] * normal + two[:, None] * side
        force = np.stack([np.bincount(first, part, n) - np.bincount(second, part, n) for part in given.T], axis=1)
        couple = -RADIUS * (np.bincount(first, two, n) + np.bincount(second, two, n))
        up, along, floor = contact(RADIUS - x[:, 1], -v[:, 1], -v[:, 0] - RADIUS * spin, floor, h, stiffness, MASS)
        right, rise, wall = contact(RADIUS - x[:, 0], -v[:, 0], v[:, 1] - RADIUS * spin, wall, h, stiffness, MASS)
        force += np.stack((right - along, up + rise - MASS * GRAVITY), axis=1)
        v += h / MASS * force
        spin += h / (0.5 * MASS * RADIUS**2) * (couple - RADIUS * (along + rise))
        x += h * v
        if step % steps == 0:
            seen.append((x[:, 1].mean(), x[:, 0].max()))
    return np.array(seen)


def main():
    """Write the figures of both stiffnesses."""
    columns = np.column_stack((MOMENTS, *map(fall, STIFFNESS)))
    np.savetxt(
        Path(__file__).parent / "reference" / "column.csv", columns, fmt="%.4f", delimiter=",", comments="",
        header="# by soft_discs.py; springs of 1e5 and of 1e6\ntime,height,front,height_stiff,front_stiff",
    )  # fmt: skip


if __name__ == "__main__":
    main()
