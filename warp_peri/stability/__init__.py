"""What is proven: conditions, the bound over the zone, certificates, solvability."""
