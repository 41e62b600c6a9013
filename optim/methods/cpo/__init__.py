"""Coordinate points optimisation."""
