"""Virtual experiments: what a simulated camera is shown, and what is measured of it."""
