"""Particles that repel one another within a distance `reach`: m_i dv_i/dt = sum_j h_i h_j (reach - r) n, h: hardness of each."""

from math import sqrt

import numpy as np

from particles_mpi.effects import Column, EffectOptions, Force, Needs, kernel


class Options(EffectOptions):
    """`reach`: the distance from which on there is no force."""

    reach: float


class Effect(Force):
    """All pairs are looked at, as in a direct sum: for a few thousand particles."""

    formula = "m_i dv_i/dt = sum_j h_i h_j (reach - r) n"
    needs = Needs(columns={"hardness": Column(least=0.0)}, divides_by_mass=True)
    collective = True  # every rank takes part in `blocks`

    def __init__(self, options, scene):
        self.reach = options.reach

    def bind(self, context):
        self.ranks, self.ids, self.length = context.ranks, context.ids, context.length

    def blocks(self, p):
        """The particles of all ranks in the order of ids, a part at a time: so sums have the same bits on any number of ranks."""
        from particles_mpi.parallel.exchange import blocks  # here, since it loads MPI, which reading a scene does not need

        return blocks(self.ranks, {"id": p.id, "position": p.position, "hardness": p["hardness"]}, self.ids)

    def add(self, particles, acceleration):
        scale, own = particles["hardness"] * particles.inverse_mass, (particles.id, particles.position)
        for block in self.blocks(particles):
            others = block["id"], block["position"], block["hardness"]
            push(*own, *others, self.reach, self.length, scale, acceleration, np.empty((len(own[0]), 0)))

    def potential(self, particles):
        """Half of the energy of each pair."""
        energy, none = np.zeros((len(particles), 1)), np.zeros_like(particles.position)
        for block in self.blocks(particles):
            others = block["id"], block["position"], block["hardness"]
            push(particles.id, particles.position, *others, self.reach, self.length, particles["hardness"], none, energy)
        return energy[:, 0]


@kernel
def push(ids, x, other_ids, other_x, hardness, reach, length, scale, a, energy):
    """Adds scale_i h_j (reach - r) n to a (n, d), and a quarter of scale_i h_j (reach - r)^2 to energy (n, 1 or 0)."""
    d = x.shape[1]
    r = np.empty(d)
    for i in range(len(ids)):
        for j in range(len(other_ids)):
            square = 0.0
            for k in range(d):
                r[k] = x[i, k] - other_x[j, k]
                if length[k] > 0.0:  # the nearest image in a periodic box
                    r[k] -= length[k] * np.rint(r[k] / length[k])
                square += r[k] * r[k]
            if other_ids[j] != ids[i] and 0.0 < square < reach * reach:
                gap = reach - sqrt(square)
                for k in range(d):
                    a[i, k] += scale[i] * hardness[j] * gap * r[k] / sqrt(square)
                for k in range(energy.shape[1]):
                    energy[i, k] += 0.25 * scale[i] * hardness[j] * gap * gap
