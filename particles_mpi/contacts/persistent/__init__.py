"""Contacts that last: spheres that forces press onto walls and one another come to rest there."""
