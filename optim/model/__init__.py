"""Model: vehicle, path, scene, problem, objective, metrics, results."""
