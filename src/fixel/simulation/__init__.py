"""How it moves: motion models, steppers, solvers, and the loop that joins them."""
