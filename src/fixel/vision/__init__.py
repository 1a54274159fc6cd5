"""Computer vision: cameras, markers, tracking of parts, and rendering of simulations."""
