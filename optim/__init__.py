"""Mathematics of driven paths: arrays in, arrays out."""
