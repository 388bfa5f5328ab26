"""How a scene scales over ranks, measured and modelled."""
