"""Fit of a drivable path to poses."""
