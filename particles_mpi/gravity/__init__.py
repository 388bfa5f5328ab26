"""Mutual attraction: who pulls whom, and how hard."""
