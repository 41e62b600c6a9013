"""Independent audit of paths; imports numpy and shapely only."""
