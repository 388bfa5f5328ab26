"""How time goes on: each integrator is a sequence of kicks and drifts.

`accelerations` sums the forces. `kicks_and_drifts` has the kick, the integrators "leapfrog", "order4" and "taylor", and takes the
one that a scene names; `gauss_radau` is "adaptive". `step_to_contact` finds the step that ends with a contact.
"""
