"""Hard spheres and walls: when they touch on straight paths, and how their velocities change.

The files and folders, in the order in which one reads them:

    drift            the drift of a step: loads the operator of the mode, moves all particles, counts what happened
    law              the contact of two spheres: its time on straight segments, and its impulse, with or without a loss
    rough            the contact of rough spheres: friction and spin
    walls            the contact of a sphere and a plane, and a drift with walls alone
    clearance        does anyone meet anyone? Asked of all pairs of a few spheres, by `integrators.many_steps`
    velocity_flow    how forces, drag and friction change velocities between the middle of a step and a contact in it
    closing_kick     what contacts get at the end of a step, where forces depend on the place: energies do not drift
    time_stepped/    mode `rewind`: the contacts of a drift in a few passes over all candidate pairs
    event_driven/    mode `event`: the contacts of a drift one after the other, in exact order of time
    warm_start       what lasting contacts took, which is saved with a state
    persistent/      contacts that last, where forces press particles that lose energy onto one another
"""
