"""Differential dynamic programming: a core on arrays of derivatives, and the truck with one trailer as its model."""

# The methods import parts of this package, which import what methods share: whole first, whoever is asked for first.
import optim.methods  # noqa: F401
