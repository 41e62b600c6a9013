"""What all rooms of the package share; imports nothing of them."""
