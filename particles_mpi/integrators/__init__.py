"""Time integrators: each advances the particles by one step, as a sequence of kicks and drifts.

- `kicks_and_drifts`: the sum of forces, the kick, the integrators "leapfrog", "order4" and "taylor", and the choice of a scene's
- `gauss_radau`: the integrator "adaptive"; `collocation`: its substeps; `radau_tables`: their coefficients; `shaking`: measures
  the round-off of forces
- `many_steps`: computes many steps in one compiled loop where that is possible; `compiled_steps`, `step_parts`: the kernels of
  that loop, which follow the integrators line by line, so that they give the same bits (a test compares them)
- `length_search`: finds the length of a step that ends with a contact
"""
