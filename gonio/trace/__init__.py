"""Transport through a specimen, tallies, and the measurement that drives them."""
