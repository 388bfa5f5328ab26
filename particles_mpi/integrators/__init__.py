"""How time goes on: each integrator is a sequence of kicks and drifts."""
