"""The cheapest setting of a scene that reaches a tolerance."""
