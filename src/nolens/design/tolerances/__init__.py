"""How far off a camera may be made, and what its parameters do to the sharpness of its PSF.

Everything here takes a criterion as a plain function of the parameters' values, so that what is
known of a formula is known of a camera too. `models` has the two criteria of cameras.
"""
