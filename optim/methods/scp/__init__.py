"""Successive convex programming."""
