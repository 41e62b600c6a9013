"""Successive convexification: the convex sub-problem, its solution, and the loop around it."""
