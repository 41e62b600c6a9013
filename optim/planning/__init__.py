"""Planners: trees, closed loop, hybrid search."""
