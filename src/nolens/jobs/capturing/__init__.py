"""Taking frames with a camera: one, many, averaged, bracketed, or over a long time."""
