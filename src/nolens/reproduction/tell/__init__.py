"""What the figures say beside the paper's: rows, captions and pictures, from what was found."""
