"""Geometry of convex polygons: collision, swept areas, separation, covers, distance fields."""
