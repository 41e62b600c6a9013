"""Successive convexification: the convex sub-problem, its solution, and the loop around it."""

# The methods import parts of this package, which import what methods share: whole first, whoever is asked for first.
import optim.methods  # noqa: F401
