"""How time goes on: each integrator is a sequence of kicks and drifts.

`accelerations` sums the forces, `velocity_flow` is the kick, `integrator` says what an integrator is. `leapfrog`, `taylor`,
`order4` and `gauss_radau` (called "adaptive" in scenes) are one file each, and `choice` takes the one that a scene names.
`step_to_contact` finds the step that ends with a contact.
"""
