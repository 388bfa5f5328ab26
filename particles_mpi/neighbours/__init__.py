"""Which particles can touch within a drift: linked cells, and candidate pairs that are kept while nothing moved too far."""
