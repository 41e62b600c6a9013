"""Modules that all rooms of the package share; they import none of the rooms."""
