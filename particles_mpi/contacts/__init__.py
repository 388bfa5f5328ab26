"""Hard spheres and walls: when they touch on straight paths, and how a contact changes their velocities.

The files and folders, in the order in which to read them:

    drift            the drift of a step: loads the operator of the mode, moves all particles, counts what happened
    law              the contact of two spheres: its time on straight segments, and its impulse, with or without a loss
    rough            the contact of rough spheres: friction and spin
    walls            the contact of a sphere and a plane, and a drift with walls alone
    clearance        can any contact take place in a drift? A test of all pairs of a few spheres, for `integrators.many_steps`
    velocity_flow    how forces, drag and friction change velocities between the middle of a step and a contact in it
    notes            what may be wrong with the contacts of a run, and the remarks that say so at its end
    closing_kick     completes the impulses of contacts at the end of a step, where forces depend on positions
    time_stepped/    mode `rewind`: the contacts of a drift in a few passes over all candidate pairs
    event_driven/    mode `event`: the contacts of a drift one after the other, in exact order of time
    warm_start       the impulses of lasting contacts, as they are saved with a state
    persistent/      contacts that last, where forces press particles together and contacts take energy
"""
