"""Differential dynamic programming: a core on arrays of derivatives, and the truck with one trailer as its model."""
