"""How time goes on: each integrator is a sequence of kicks and drifts.

`kicks_and_drifts` has the sum of forces, the kick, the integrators "leapfrog", "order4" and "taylor", and takes the one that a
scene names; `gauss_radau` is "adaptive", whose substeps are in `collocation`, with the numbers of `radau_tables`, and `shaking`
measures the round-off of forces for it. `many_steps` computes many steps in one loop where it can, by the kernels of
`compiled_steps` and `step_parts`: they follow these integrators line by line, and a test holds both to the same bits; where
spheres collide, it does so as long as nobody meets anybody. `length_search` finds the length of a step that ends with a contact.
"""
