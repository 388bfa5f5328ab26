"""Straight paths and kicks: the kernels that every step is made of. Arrays only."""

from __future__ import annotations

from particles_mpi.kernels.jit import kernel, lean, lean_inner


@kernel
def kick(v, a, h):
    """v += a h, in place on v (n, d)."""
    for i in range(v.shape[0]):
        for k in range(v.shape[1]):
            v[i, k] += a[i, k] * h


@kernel
def kick_with_drag(v, a, decay, push):
    """v = v decay + a push, in place on v (n, d)."""
    for i in range(v.shape[0]):
        for k in range(v.shape[1]):
            v[i, k] = v[i, k] * decay[i] + a[i, k] * push[i]


@kernel
def free_drift(x, v, h):
    """x += v h, in place on x (n, d)."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            x[i, k] += v[i, k] * h


@lean_inner
def move_to(axes, x, v, s, i, t):
    """Bring row i along its leg to time t, where a new leg begins."""
    for k in range(len(axes)):
        x[i, k] += v[i, k] * (t - s[i])
    s[i] = t


@lean
def end_legs(axes, x, v, s, h):
    """From the start of the last leg to the end of the drift: x += v (h - s), in place."""
    for i in range(len(x)):
        for k in range(len(axes)):
            x[i, k] += v[i, k] * (h - s[i])
