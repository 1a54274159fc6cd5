"""Published work repeated, and benchmarks on recorded pushes."""
