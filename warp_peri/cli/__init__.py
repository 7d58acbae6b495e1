"""The command warp-peri."""
