"""Planners that make the recorded paths of the corpus: one protocol, three ways of searching."""
