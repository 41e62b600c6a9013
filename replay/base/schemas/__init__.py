"""Documents that the program reads and writes, each as a msgspec struct: plain data, no numpy, no rules."""
