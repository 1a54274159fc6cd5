"""Parameters from experiments, and how far the experiments determine them."""
