"""Point spread functions from what a camera measured."""
