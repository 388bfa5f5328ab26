"""How spheres turn: orientations that follow spins. Arrays only.

An orientation is the angle in the plane, and in space a unit quaternion (w, x, y, z), which takes directions fixed in the
sphere to those in space. Exponentials by series and squaring, from sums and products alone: the same bits on any processor.
"""

from math import sqrt

from particles_mpi.kernels.jit import lean

LARGEST_ANGLE = 0.25  # radians: the largest half of a rotation angle for which the series is good to round-off
TERMS = 7


@lean
def turn(orientation, spin, h):
    """Orientations (n, 1) or (n, 4) after a time h with constant spins (n, 1) or (n, 3); in place."""
    if orientation.shape[1] == 1:
        for i in range(len(spin)):
            orientation[i, 0] += spin[i, 0] * h
        return
    for i in range(len(spin)):
        x, y, z = 0.5 * h * spin[i, 0], 0.5 * h * spin[i, 1], 0.5 * h * spin[i, 2]
        doublings, angle2 = 0, x * x + y * y + z * z
        if angle2 == 0.0:
            continue
        while angle2 > LARGEST_ANGLE * LARGEST_ANGLE and doublings < 1000:
            angle2 *= 0.25
            doublings += 1
        cosine, sine, part = 1.0, 1.0, 1.0  # sine: sin(a)/a
        for k in range(1, TERMS):
            part *= -angle2 / ((2.0 * k - 1.0) * (2.0 * k))
            cosine += part
            sine += part / (2.0 * k + 1.0)
        shrunk = sine * 0.5**doublings
        w, x, y, z = cosine, x * shrunk, y * shrunk, z * shrunk
        for _ in range(doublings):
            w, x, y, z = w * w - (x * x + y * y + z * z), 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
        a, b, c, d = orientation[i, 0], orientation[i, 1], orientation[i, 2], orientation[i, 3]
        e, f = w * a - (x * b + y * c + z * d), w * b + x * a + (y * d - z * c)
        g, k = w * c + y * a + (z * b - x * d), w * d + z * a + (x * c - y * b)
        size = sqrt(e * e + f * f + g * g + k * k)
        orientation[i, 0], orientation[i, 1], orientation[i, 2], orientation[i, 3] = e / size, f / size, g / size, k / size
