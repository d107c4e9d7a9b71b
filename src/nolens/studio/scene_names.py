"""Names of the built-in scenes, for who does not load pictures."""

SCENES = {
    "chart": "Chart",
    "astronaut": "Astronaut",
    "coffee": "Coffee",
    "camera": "Cameraman",
    "point": "Point source",
    "dark": "No light",
}
"""By id, what they are called."""
