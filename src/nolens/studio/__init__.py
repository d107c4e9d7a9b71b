"""The studio: a page in the browser on which a person sees through a lensless camera.

The server never loads the numerics. What computes runs in two processes beside it, one for the
live view and one for jobs; either may die, and the page stays.
"""
