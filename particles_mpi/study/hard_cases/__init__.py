"""Hard cases: what naive programs do with them, what must hold here, and what is measured.

catalogue  what a case is, all cases, how one is run; `study hard-cases`, which prints the table
contacts   friction and drag where explicit rules fail; single contacts: where and when they happen, and what they give
crowds     many contacts at once
resting    contacts that last, and a ball that never stops
rough      friction and spins: what stands and what does not, fast spins, mu = 0 and 1e6, very unlike masses
orbits     close encounters, orbits far from the origin, very many orbits
extremes   numbers at the ends of what a float64 holds; particles where ranks meet, and ranks without particles
"""
