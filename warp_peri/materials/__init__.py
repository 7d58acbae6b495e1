"""Materials that are written by those who use them."""
